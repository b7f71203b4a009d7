"""The vehicle: a drive through a curve in, a kinematic summary out."""
