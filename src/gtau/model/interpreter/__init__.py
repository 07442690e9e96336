"""The batched interpreter of CasADi functions."""
