"""How the documentation is built: Sphinx, MyST Markdown, numpydoc."""

import html
import logging
import sys
from pathlib import Path

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging as sphinx_logging
from sphinx.writers.html5 import HTML5Translator

from anisomap import __version__
from anisomap.cli.app import load_commands

sys.path.insert(0, str(Path(__file__).parent))
from notebooks import to_markdown

load_commands()

project = "anisomap"
author = "The anisomap developers"
copyright = "2026, the anisomap developers"
release = __version__

extensions = ["cyclopts.sphinx_ext", "myst_parser", "numpydoc", "sphinx.ext.autodoc"]
source_suffix = {".md": "markdown", ".ipynb": "markdown"}
exclude_patterns = ["_build", "development/*-table.md"]  # tables are included by other pages
myst_enable_extensions = ["deflist", "dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3

autosummary_generate = False
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

default_role = "py:obj"  # names in single backticks in docstrings are links

html_theme = "furo"
html_title = "anisomap"
html_static_path = ["_static"]
html_css_files = ["anisomap.css"]
html_math_renderer = "mathml"


def setup(app: Sphinx) -> None:
    """Render equations as MathML, which needs neither scripts nor a network; run notebooks."""
    app.add_html_math_renderer("mathml", (_visit_inline, None), (_visit_block, None))
    app.connect("source-read", _run_notebook)


def _run_notebook(app: Sphinx, page: str, source: list[str]) -> None:
    if app.env.doc2path(page).suffix == ".ipynb":
        logging.getLogger("anisomap").setLevel(logging.WARNING)  # progress is not output
        folder = Path("_build", "notebooks", page)
        source[0] = to_markdown(source[0], app.srcdir / folder, f"/{folder.as_posix()}")


def _visit_inline(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(_mathml(node))
    raise nodes.SkipNode


def _visit_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    translator.body += ['<div class="math">', _mathml(node, as_block=True), "</div>\n"]
    raise nodes.SkipNode


def _mathml(node: nodes.Element, *, as_block: bool = False) -> str:
    try:
        return str(tex2mathml(node.astext(), as_block=as_block))
    except MathError as error:
        sphinx_logging.getLogger(__name__).warning("equation: %s", error, location=node)
        return html.escape(node.astext())
