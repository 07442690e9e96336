"""Where work is done: executors, and the cache of reduced runs."""
