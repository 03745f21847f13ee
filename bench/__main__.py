# SPDX-License-Identifier: Apache-2.0
"""Run all benchmarks, print the table, write runs/bench.json; exit 1 if a bound is missed."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

import casadi
import mujoco
import numpy
import pinocchio

from bench import build, disturbances, identification_peers, memory, peers, proof, real_time, starts, sweep
from bench.figures import ROOT, Figure, page, table
from fjr_msgs_py.console.provenance import machine

RESULTS = ROOT / "runs" / "bench.json"


class Bench(NamedTuple):
    """What measures, its arguments in a quick run, and whether it is left out unless it is named."""

    measure: Callable[..., list[Figure]]
    quick: Mapping[str, Any] = {}
    long: bool = False


BENCHES = {
    "law": Bench(peers.law_over_rnea),
    "dynamics": Bench(peers.forward_dynamics_over_aba),
    "step": Bench(peers.step_over_mujoco),
    "loop": Bench(peers.times_real_time),
    "virtual-machine": Bench(peers.virtual_machine_over_c),
    "build": Bench(build.arms),
    "start": Bench(starts.law),
    "node": Bench(starts.node),
    "command": Bench(starts.command),
    "round-trip": Bench(real_time.over_echo, {"rounds": 3}),
    "on-time": Bench(real_time.answered, {"seconds": 5.0}),
    "mujoco": Bench(real_time.on_mujoco, {"seconds": 5.0}),
    "gaps": Bench(disturbances.longest_gaps, {"repeats": 1}),
    "pauses": Bench(disturbances.recovered, {"pauses": 3, "kills": 1}),
    "certificate": Bench(real_time.with_certificate, {"rounds": 3}),
    "lock-step": Bench(real_time.over_ping_pong, {"repeats": 2, "seconds": 3.0}),
    "sweep": Bench(sweep.against_peers, {"runs": 500, "rounds": 2}),
    "proof": Bench(proof.over_joint_range_and_tube, {"most_boxes": 20}),
    "identification": Bench(identification_peers.against_mujoco, {"records": 2, "of_seven": 0}),
    "identification-time": Bench(identification_peers.of_a_minute, {"duration": 5.0}),
    "starts": Bench(starts.arm7, {"most": 2}, long=True),
    "memory": Bench(memory.of_nodes, {"minutes": 0.5}, long=True),
    "sweep-memory": Bench(memory.of_sweep, {"many": 20_000}, long=True),
    "report-memory": Bench(memory.of_reports, {"minutes": 1.0}, long=True),
    "excitation": Bench(identification_peers.of_designed_motion, {"duration": 5.0}, long=True),
}


def main() -> int:
    """Run the selected benchmarks; return the exit code."""
    arguments = parser().parse_args()
    usual = [name for name, bench in BENCHES.items() if not bench.long]
    figures = measured(arguments.only or usual, arguments.quick)
    print(f"{machine()}\n\n{table(figures)}")
    document = write(figures, arguments.output)
    if arguments.document:
        arguments.document.write_text(page(document), encoding="utf-8")
    missed = [figure.name for figure in figures if not figure.holds]
    print(f"\n{arguments.output}" + (f"\nmissed: {', '.join(missed)}" if missed else ""))
    return 1 if missed else 0


def measured(wanted: Sequence[str], quick: bool) -> list[Figure]:
    """Return the figures of these benchmarks; say which one runs."""
    figures: list[Figure] = []
    for count, name in enumerate(wanted, 1):
        print(f"bench: {name} ({count} of {len(wanted)})", file=sys.stderr, flush=True)
        bench = BENCHES[name]
        figures += bench.measure(**(bench.quick if quick else {}))
    return figures


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    left_out = [name for name, bench in BENCHES.items() if bench.long]
    made = argparse.ArgumentParser(prog="bench", description="Measure against peers, in turns, and check the bounds.")
    made.add_argument(
        "--only",
        nargs="+",
        choices=BENCHES,
        metavar="NAME",
        help=f"some of {', '.join(BENCHES)} (default: all but {', '.join(left_out)})",
    )
    made.add_argument("--quick", action="store_true", help="run nodes for a few seconds only; bounds do not apply")
    made.add_argument("--document", type=Path, help="where the table of all figures of this day goes (Markdown)")
    made.add_argument("--output", type=Path, default=RESULTS, help=f"where the JSON goes (default: {RESULTS})")
    return made


def write(figures: list[Figure], path: Path) -> dict[str, Any]:
    """Write the figures with machine and date, and keep the other figures of this day and machine; return all."""
    versions = {module.__name__: module.__version__ for module in (casadi, mujoco, numpy, pinocchio)}
    document: dict[str, Any] = {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "machine": machine(),
        "versions": versions,
    }
    before = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    same = before.get("machine") == document["machine"] and before.get("date", "")[:10] == document["date"][:10]
    found = {each["name"]: each for each in (before["figures"] if same else [])}
    document["figures"] = list((found | {figure.name: figure.as_json() for figure in figures}).values())
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return document


if __name__ == "__main__":
    sys.exit(main())
