"""Demonstration, and case study of the paper."""
