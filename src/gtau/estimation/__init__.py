"""Estimation: from triangular factors to base parameters, drive gains, their statistics and one result."""
