"""Where on the map a drive took place, with and without satellites."""
