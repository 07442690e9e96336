"""Read and validate files written by users."""
