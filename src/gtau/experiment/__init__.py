"""Exciting trajectories, designed for what is to be identified."""
