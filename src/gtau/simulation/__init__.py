"""Simulated logs of robots with known parameters."""
