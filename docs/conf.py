"""Sphinx's settings: `make docs` builds the site with them, without network."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

from gtau import _SHOWN, __version__, _html  # noqa: E402

for _name, _module in _SHOWN.items():  # the gallery shows what IPython shows
    getattr(import_module(_module), _name)._repr_html_ = _html

project = "gtau"
author = "The gtau developers"
project_copyright = "The gtau developers, BSD 3-Clause"
release = version = __version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "site_hooks",
]
exclude_patterns = ["gallery/**/*.py", "gallery/**/*.ipynb", "gallery/README.rst"]
templates_path = ["_templates"]
nitpicky = True
smartquotes = False  # they make a dash of --method
highlight_language = "text"  # of indented blocks: commands, C and YAML

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 4
myst_links_external_new_tab = False

autosummary_generate = True
autodoc_typehints = "none"  # the docstrings name types with shapes and units
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True

html_theme = "pydata_sphinx_theme"
html_title = "gtau"
html_static_path = ["_static"]
html_css_files = ["gtau.css"]
html_search_scorer = str(DOCS / "search_scorer.js")
html_math_renderer = "mathml"
html_show_sourcelink = False
html_copy_source = True  # llms.txt lists the pages as they are written
html_sourcelink_suffix = ""
html_theme_options = {
    "logo": {"text": "gtau"},
    "navbar_persistent": ["search-button"],
    "navbar_end": ["theme-switcher"],
    "secondary_sidebar_items": ["page-toc"],
    "header_links_before_dropdown": 6,
    "show_prev_next": False,
    "navigation_with_keys": False,
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_context = {"default_mode": "auto"}
copybutton_prompt_text = "$ "
copybutton_exclude = ".linenos, .gp, .go"

sphinx_gallery_conf = {
    "examples_dirs": "../examples/gallery",
    "gallery_dirs": "gallery",
    "filename_pattern": os.sep + "plot_",
    "plot_gallery": os.environ.get("GTAU_GALLERY", "run") == "run",  # CI builds the pages without running the scripts
    "abort_on_example_error": True,
    "min_reported_time": 0,
    "show_memory": False,
    "show_signature": False,
    "remove_config_comments": True,
    "within_subsection_order": "FileNameSortKey",
    "default_thumb_file": str(DOCS / "images" / "demo-gains.png"),
    "download_all_examples": True,
    "image_scrapers": ("site_hooks.draw_figures", "matplotlib"),  # pyplot's figures are pyplot's until it draws them
    "capture_repr": ("_repr_html_",),
    "reset_modules": ("matplotlib",),
    "write_computation_times": False,
}
