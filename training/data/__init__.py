"""Drives with known friction on a shelf: named by their content, described, never changed."""
