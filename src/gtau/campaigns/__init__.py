"""Campaigns: rounds of motions, designed to reduce what limits the worst gain, until the gains can be trusted."""
