"""Watch whether a robot is still the one that was identified."""
