"""Identified models for controllers, simulators, papers and colleagues: one file a kind, listed in the registry."""
