"""How the documentation is built: Sphinx, MyST Markdown, numpydoc."""

from anisomap import __version__

project = "anisomap"
author = "The anisomap developers"
copyright = "2026, the anisomap developers"
release = __version__

extensions = ["myst_parser", "numpydoc", "sphinx.ext.autodoc"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "*-table.md"]  # tables are parts of other pages
myst_enable_extensions = ["deflist", "dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3


autosummary_generate = False
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_theme = "furo"
html_title = "anisomap"
html_static_path = []
