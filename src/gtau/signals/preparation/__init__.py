"""Preparation: bandwidth, filters and decimation; positions become velocities and accelerations."""
