"""Hypotheses about what the model lacks, one file each."""
