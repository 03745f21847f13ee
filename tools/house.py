# SPDX-License-Identifier: Apache-2.0
"""Print the size of the house: python tools/house.py. Lines are a proxy for what a reader has to hold.

`--walks` adds the lines of the modules that a few acts import, each in a process of its own (source setup.sh first).
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from statistics import median

ROOT = Path(__file__).resolve().parents[1]
SCENARIOS = ROOT / "ros2_ws" / "src" / "fjr_bringup" / "scenarios"
OF_SCENARIOS = "from fjr_core.config.scenario import load_scenario, read_scenario; "
WALKS = {
    "read paper_k31": f"{OF_SCENARIOS} read_scenario({str(SCENARIOS / 'paper_k31.yaml')!r})",
    "read and build paper_k31": f"{OF_SCENARIOS} load_scenario({str(SCENARIOS / 'paper_k31.yaml')!r})",
    "read and build arm7": f"{OF_SCENARIOS} load_scenario({str(SCENARIOS / 'arm7.yaml')!r})",
    "plant node": "import fjr_plant.plant_node",
    "controller node": "import fjr_controller.controller_node",
}
"""Acts by name, as statements of Python."""
REACHED = """
import sys
files = {module.__file__ for name, module in sys.modules.items() if name.startswith("fjr_") and module.__file__}
print(sum(len(open(file, encoding="utf-8").readlines()) for file in files if file.endswith(".py")), len(files))
"""
HEADINGS = ("folder", "modules", "lines", "lines a module", "functions", "median function")


def main() -> int | str:
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
    for name, act in WALKS.items() if "--walks" in sys.argv else ():
        ran = subprocess.run([sys.executable, "-c", act + REACHED], capture_output=True, text=True, check=False)
        if ran.returncode:
            return f"'{name}' failed: {ran.stderr.splitlines()[-1]}; expected . ros2_ws/install/setup.sh before it"
        print("{}: {:,} lines in {} modules".format(name, *map(int, ran.stdout.split())))
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
