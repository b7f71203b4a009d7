"""The soak of the live client: a car of its own, the air it talks through, and what is watched of it."""
