"""The commands of `roadgrip-rsu`."""
