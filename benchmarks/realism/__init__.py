"""Robots, and ways in which their logs depart from the model, for benchmarks/calibration.py."""
