"""From data sets to a challenger, with everything that is on record about it."""
