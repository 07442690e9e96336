"""The demonstration and the case study of the paper."""
