"""CAN: logs, live buses and DBC descriptions, behind one door; python-can and cantools are imported nowhere else."""
