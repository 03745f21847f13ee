# SPDX-License-Identifier: Apache-2.0
"""Run arm7 against walls at random places of its motion and print a table: `python -m tests.engines [--walls 20]`.

The workspace must be sourced. A wall takes some seconds.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tools"), str(ROOT)]

import numpy as np  # noqa: E402

from bench.figures import markdown  # noqa: E402
from engines.walls import Met, met, random_walls  # noqa: E402

HEAD = ("first touch [s]", "stopped", "verdict external torque", "joints", "right", "force [N]", "simulator's [N]")


def main(words: list[str]) -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.engines", description="Walls in the way of arm7.")
    parser.add_argument("--walls", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    given, seen = parser.parse_args(words), []
    for wall in random_walls(given.walls, given.seed):
        with tempfile.TemporaryDirectory() as folder:
            seen.append(met(wall, Path(folder)))
        print(".", end="", file=sys.stderr, flush=True)
    print(*markdown(HEAD, map(row, seen)), sep="\n")
    right = sum(each.external and each.right for each in seen)
    apart = float(np.median([abs(each.force / each.own_force - 1) if each.own_force else 1.0 for each in seen]))
    print(f"\nverdict and joints right: {right} of {len(seen)}; efforts beyond a limit: {sum(e.beyond for e in seen)}")
    print(f"runs with values that are not finite: {sum(not e.finite for e in seen)}; force apart, median: {apart:.1%}")
    return 0


def row(seen: Met) -> list[str]:
    """Return the cells of a run."""
    stopped, external, right = ("yes" if each else "no" for each in (seen.stopped, seen.external, seen.right))
    forces = [f"{seen.force:.0f}", f"{seen.own_force:.0f}"]
    return [f"{seen.begins_s:.2f}", stopped, external, seen.joints, right, *forces]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
