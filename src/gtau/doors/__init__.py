"""Doors for those who do not type commands: a page on one's own machine, and tools for agents."""
