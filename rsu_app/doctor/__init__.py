"""What keeps a box from serving its road, and what mends it: read at the edge, judged by pure functions."""
