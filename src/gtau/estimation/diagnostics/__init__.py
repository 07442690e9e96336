"""Hypotheses about what is wrong, and verdicts."""
