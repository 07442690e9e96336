"""Watching a robot: whether it is still the one that was identified."""
