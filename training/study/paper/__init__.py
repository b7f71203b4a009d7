"""What the paper reports, made again: one chapter a module."""
