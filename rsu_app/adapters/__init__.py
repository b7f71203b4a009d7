"""Where the road side unit touches the world; each package is the one door to its heavy dependency."""
