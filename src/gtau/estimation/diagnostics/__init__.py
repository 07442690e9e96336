"""Checks of logs, descriptions and fits, and verdicts on the estimates."""
