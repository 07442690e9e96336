"""A batched interpreter of CasADi functions."""
