"""Exports of identified models to controllers, simulators and papers: one module per kind, found by its constant."""
