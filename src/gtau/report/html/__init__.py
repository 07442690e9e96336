"""Self-contained HTML pages: markup, charts and drawings without any dependency but the vendored uPlot."""
