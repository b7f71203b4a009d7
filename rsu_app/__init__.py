"""The road side unit: many summaries in, one friction interval and one speed advisory out."""
