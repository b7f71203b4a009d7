"""The decisions of the road side unit: pure functions and one pure data structure. No I/O, no clock, no log."""
