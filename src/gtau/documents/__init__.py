"""Read, check and refuse files that people write."""
