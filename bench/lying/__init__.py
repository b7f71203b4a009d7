"""Liars who know the model: what they make up, what the unit makes of it, and how far that moves what it says."""
