"""Many logs, many machines: factors from Dask workers and from a cache, and fleets of robots."""
