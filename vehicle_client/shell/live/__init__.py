"""The process that runs in a car: sensors in, passages out, advice to the driver; `client.py` is the loop."""
