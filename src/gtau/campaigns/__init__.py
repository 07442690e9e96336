"""Campaigns: motion after motion, each decided by what limits the worst gain, until the gains can be trusted."""
