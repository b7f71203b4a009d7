"""Beyond the paper: roads the model has never seen, vehicles that lie or hardly tell, and friction that changes."""
