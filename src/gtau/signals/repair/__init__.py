"""Clock and repair: the instants of samples, faults, and a uniform grid."""
