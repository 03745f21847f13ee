# SPDX-License-Identifier: Apache-2.0
"""Build the pages and the API reference with Sphinx; a warning is an error. Source the workspace first.

. ros2_ws/install/setup.sh && .venv/bin/python tools/docs/build_docs.py [FOLDER [BUILDER]]

A folder that is used again keeps what Sphinx read: only changed pages and modules are read again. BUILDER `dummy` reads
and resolves every reference but writes no page.
"""

from __future__ import annotations

import gc
import importlib
import os
import pkgutil
import re
import shutil
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from sphinx.cmd.build import main as sphinx

ROOT = Path(__file__).resolve().parents[2]
LINKED = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs", "examples", "ros2_ws", "bench", "tests", "tools")
"""Pages and their link targets, laid out as in the repository."""
PACKAGES = (
    "fjr_core",
    "fjr_msgs_py",
    "fjr_plant",
    "fjr_controller",
    "fjr_monitor.diagnosis",
    "fjr_design",
    "fjr_identification",
    "fjr_proofs",
    "fjr_engines",
)
CONTENTS = """fjr
===

.. toctree::
   :maxdepth: 1

   {pages}

.. toctree::
   :caption: API
   :maxdepth: 1

   {packages}
"""


def main(arguments: Sequence[str]) -> int:
    """Write the sources of the API reference, link the pages, build; return Sphinx's exit code."""
    folder = Path(arguments[0]).resolve() if arguments else ROOT / "build" / "docs"
    builder = arguments[1] if len(arguments) > 1 else "html"
    source, cache = folder / "source", folder / "cache"
    lay_out(source)
    gc.set_threshold(100_000, 20, 20)  # Sphinx keeps what it makes; the default takes a fifth of its time
    # -a: a reference of an unchanged page may point to what is gone
    options = ["-a", "-W", "--keep-going", "-q", "-b", builder, "-c", str(ROOT / "docs"), "-d", str(cache)]
    code = sphinx([*options, str(source), str(folder / builder)])
    if code != 0:
        shutil.rmtree(cache, ignore_errors=True)  # what is read from it gives no warning
    elif builder == "html":
        print(f"open {folder / 'html' / 'index.html'}")
    return code


def lay_out(source: Path) -> None:
    """Create the source folder of Sphinx; a file that stays the same keeps its time."""
    api = source / "api"
    api.mkdir(parents=True, exist_ok=True)
    for name in LINKED:
        (source / name).unlink(missing_ok=True)
        (source / name).symlink_to(ROOT / name)
    texts = {api / f"{name}.rst": text for package in PACKAGES for name, text in api_pages(package)}
    for gone in set(api.iterdir()) - set(texts):
        gone.unlink()
    pages = "\n   ".join(["README", "docs/README", *pages_in_order()])
    packages = "\n   ".join(f"api/{package}" for package in PACKAGES)
    texts[source / "index.rst"] = CONTENTS.format(pages=pages, packages=packages)
    for file, text in texts.items():
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def pages_in_order() -> list[str]:
    """Return the pages in the order of docs/README.md."""
    targets = re.findall(r"\]\(([^)]+)\.md\)", (ROOT / "docs" / "README.md").read_text(encoding="utf-8"))
    names = (os.path.normpath(f"docs/{target}") for target in targets)
    return [name for name in dict.fromkeys(names) if name != "README"]


def api_pages(package: str) -> Iterator[tuple[str, str]]:
    """Yield name and text of the page of a package, with its public names, and of the page of each module."""
    modules = sorted(module_names(package))
    lines = heading(package)
    public = list(public_names(package))
    if public:
        lines += ["Public names:", "", ".. autosummary::", "", *(f"   {name}" for name in public), ""]
    lines += [f".. automodule:: {package}", "   :no-members:", ""]
    lines += [".. toctree::", "   :maxdepth: 1", "", *(f"   {module}" for module in modules)]
    yield package, "\n".join(lines) + "\n"
    for module in modules:
        yield module, "\n".join([*heading(module), f".. automodule:: {module}"]) + "\n"


def heading(name: str) -> list[str]:
    """Return a title."""
    title = name.replace("_", r"\_")
    return [title, "=" * len(title), ""]


def module_names(package: str) -> Iterator[str]:
    """Yield all non-empty modules of a package."""
    path = importlib.import_module(package).__path__
    for found in pkgutil.walk_packages(path, f"{package}."):
        if not found.ispkg:
            yield found.name


def public_names(package: str) -> Iterator[str]:
    """Yield the qualified name of each name in `__all__` of a package."""
    module = importlib.import_module(package)
    for name in getattr(module, "__all__", ()):
        home = getattr(getattr(module, name), "__module__", None)
        is_ours = home is not None and home.startswith("fjr_")
        yield f"{home if is_ours else package}.{name}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
