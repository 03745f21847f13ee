# SPDX-License-Identifier: Apache-2.0
"""How Sphinx builds the pages and the API reference (`make docs`, tools/docs/build_docs.py)."""

from typing import Any

from docstring_text import as_rst
from sphinx.application import Sphinx
from sphinx.domains.python import PythonDomain

project = "fjr"
author = copyright = "The fjr authors"
html_title = "Tracking control of robots with flexible joints"
html_theme = "alabaster"
html_theme_options = {"page_width": "1100px", "body_max_width": "none", "fixed_sidebar": True}
html_show_copyright = False
# Source code and the pages of modules come without the list of all pages, which takes a fifth of the build.
html_sidebars = {"_modules/**": ["about.html", "searchfield.html"]}
html_sidebars["api/*.*"] = ["about.html", "searchfield.html", "relations.html"]

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
autodoc_mock_imports = ["pydrake"]  # too large to be installed for the pages


class Names(PythonDomain):
    """Names of Python; one that no module of its page defines is searched in all modules once."""

    def find_obj(
        self, env: Any, modname: str, classname: str, name: str, type: str | None, searchmode: int = 0
    ) -> list[Any]:
        """Return the names and entries of the objects that a reference may mean."""
        near = (f"{modname}.{classname}.{name}", f"{modname}.{name}", name)
        if searchmode == 0 or any(each in self.objects for each in near):
            return super().find_obj(env, modname, classname, name, type, searchmode)
        kept = self.__dict__.setdefault("_searched", {})
        if (name, type) not in kept:
            kept[name, type] = super().find_obj(env, modname, classname, name, type, searchmode)
        return list(kept[name, type])


def setup(app: Sphinx) -> None:
    """Docstrings of the workspace are plain text with `code`; Sphinx wants reStructuredText."""
    app.add_domain(Names, override=True)
    app.connect("autodoc-process-docstring", lambda *event: event[-1].__setitem__(slice(None), as_rst(event[-1])))
