"""Hypotheses about model and data errors, and verdicts on the estimates."""
