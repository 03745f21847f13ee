# SPDX-License-Identifier: Apache-2.0
"""How Sphinx builds the pages and the API reference (`make docs`, tools/docs/build_docs.py)."""

from docstring_text import as_rst
from sphinx.application import Sphinx

project = "fjr"
author = copyright = "The fjr authors"
html_title = "Tracking control of robots with flexible joints"
html_theme = "alabaster"
html_theme_options = {"page_width": "1100px", "body_max_width": "none", "fixed_sidebar": True}
html_show_copyright = False
html_sidebars = {"_modules/**": ["about.html", "searchfield.html"]}  # source code, without the list of all pages

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.mathjax"]
extensions += ["sphinx.ext.viewcode"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4  # as GitHub has them
exclude_patterns = ["examples/*.md"]

autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "undoc-members": True, "show-inheritance": True}
autodoc_type_aliases = {"Array": "Array", "ArrayLike": "ArrayLike", "NDArray": "NDArray"}
python_maximum_signature_line_length = 100
autosummary_generate = False


def setup(app: Sphinx) -> None:
    """Docstrings of the workspace are plain text with `code`; Sphinx wants reStructuredText."""
    app.connect("autodoc-process-docstring", lambda *event: event[-1].__setitem__(slice(None), as_rst(event[-1])))
