"""The robot description, and readers of robot files."""
