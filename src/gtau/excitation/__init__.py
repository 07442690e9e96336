"""The design of exciting trajectories."""
