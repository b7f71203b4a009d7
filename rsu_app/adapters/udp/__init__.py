"""UDP: frames as a V2X radio delivers them."""
