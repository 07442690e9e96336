"""Renderers of pages: terminal, HTML with uPlot for time series, and Matplotlib for all other charts."""
