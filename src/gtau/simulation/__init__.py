"""Simulation: logs of robots whose true parameters are known."""
