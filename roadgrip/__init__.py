"""The vocabulary of roadgrip: units, roads, records, features and the wire. It decides nothing and does no I/O."""
