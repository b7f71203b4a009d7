"""The laboratory: drives with known friction in, a model bundle the road side unit can trust out."""
