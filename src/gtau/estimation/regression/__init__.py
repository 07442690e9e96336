"""From runs to the linear system of eqs. (19) to (33)."""
