"""The model: the paper's equations 1 to 18, written once, symbolically, and evaluated for many samples."""
