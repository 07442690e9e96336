"""Exports of identified models to controllers, simulators and papers: one module per kind, listed in the registry."""
