# SPDX-License-Identifier: Apache-2.0
"""Print the size of the house: python tools/house.py. Lines are a proxy for what a reader has to hold."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable
from pathlib import Path
from statistics import median

ROOT = Path(__file__).resolve().parents[1]
HEADINGS = ("folder", "modules", "lines", "lines a module", "functions", "median function")


def main() -> int:
    """Print a row for each package, and for tests, bench and tools, in Markdown."""
    packages = sorted(path for path in (ROOT / "ros2_ws" / "src").iterdir() if path.is_dir())
    found = {path.name: sorted(path.rglob("*.py")) for path in packages}
    found["**packages**"] = [file for files in found.values() for file in files]
    found |= {name: sorted((ROOT / name).rglob("*.py")) for name in ("tests", "bench", "tools")}
    print("| " + " | ".join(HEADINGS) + " |")
    print("| --- " + "| ---: " * (len(HEADINGS) - 1) + "|")
    for name, files in found.items():
        print("| " + " | ".join([name, *map(str, _row(files))]) + " |")
    pages = [*ROOT.glob("docs/*.md"), *ROOT.glob("*.md")]
    print(f"\n{sum(len(page.read_text(encoding='utf-8').split()) for page in pages):,} words on {len(pages)} pages")
    return 0


def _row(files: Iterable[Path]) -> tuple[int, int, int, int, float]:
    """Return modules, lines, lines a module, functions and the median of their lines."""
    texts = [file.read_text(encoding="utf-8") for file in files]
    lines = sum(len(text.splitlines()) for text in texts)
    functions = [
        (node.end_lineno or node.lineno) - node.lineno + 1
        for text in texts
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef)
    ]
    return len(texts), lines, round(lines / max(1, len(texts))), len(functions), median(functions or [0])


if __name__ == "__main__":
    sys.exit(main())
