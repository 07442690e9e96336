"""Readers of robot files, one format each."""
