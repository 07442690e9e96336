"""Renderers of pages, one for each medium: terminal, HTML, notebooks, figures."""
