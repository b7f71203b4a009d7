"""The operators' loop as a play: `make mlops-demo`."""
