"""Pages, figures and the demo."""
