"""Compiled drives: a vehicle, a driver, a road surface and sensors, pure and reproducible from a seed.

`vehicle_client.simulator.run` is the door; nothing else in here is meant to be called from outside.
"""
