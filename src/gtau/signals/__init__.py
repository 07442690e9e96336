"""From log files to sampled positions, speeds, accelerations and currents: reading, checks, filters, decimation."""
