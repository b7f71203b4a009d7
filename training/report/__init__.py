"""Findings of the study for people: one page for a browser, small files for a code host."""
