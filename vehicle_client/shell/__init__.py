"""All that touches the outside: recordings, the air, the disk, the fleet."""
