# SPDX-License-Identifier: Apache-2.0
"""Run all benchmarks, print the table, write runs/bench.json; exit 1 if a bound is missed."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import casadi
import mujoco
import numpy
import pinocchio
from tqdm import tqdm

from bench import (
    build,
    campaign,
    campaign_memory,
    certificate,
    closed_loop,
    gaps,
    identification_peers,
    identification_time,
    lock_step,
    memory,
    on_time,
    pauses,
    peers,
    periods,
    proof,
    report_memory,
    round_trip,
    start_up,
    starts,
)
from bench.arm import arm7
from bench.figures import Figure, page, table

RESULTS = Path(__file__).resolve().parents[1] / "runs" / "bench.json"
LONG = ("starts", "memory", "sweep-memory", "report-memory")
USUAL = (
    *("law", "dynamics", "step", "loop", "virtual-machine", "build", "start", "node", "command", "round-trip"),
    *("on-time", "gaps", "pauses", "certificate", "periods", "lock-step", "campaign", "proof", "identification"),
    "identification-time",
)
NAMES = (*USUAL, *LONG)

Measurement = Callable[[], list[Figure]]


def main() -> int:
    """Run the selected benchmarks; return the exit code."""
    arguments = parser().parse_args()
    all_of_them = measurements(arguments.quick)
    figures = measured({name: run for name, run in all_of_them.items() if name in (arguments.only or USUAL)})
    print(f"{processor()}, {os.cpu_count()} cores\n\n{table(figures)}")
    document = write(figures, arguments.output)
    if arguments.document:
        arguments.document.write_text(page(document), encoding="utf-8")
    missed = [figure.name for figure in figures if not figure.holds]
    print(f"\n{arguments.output}" + (f"\nmissed: {', '.join(missed)}" if missed else ""))
    return 1 if missed else 0


def measured(wanted: dict[str, Measurement]) -> list[Figure]:
    """Return the figures of all benchmarks; show a progress bar on a terminal, plain lines elsewhere."""
    figures: list[Figure] = []
    terminal = sys.stderr.isatty()
    with tqdm(total=len(wanted), disable=not terminal, bar_format="{desc:16} |{bar}| {n}/{total} {elapsed}") as bar:
        for name, run in wanted.items():
            if not terminal:
                print(f"bench: {name}", file=sys.stderr, flush=True)
            bar.set_description(name)
            figures += run()
            bar.update()
    return figures


def measurements(quick: bool = False) -> dict[str, Measurement]:
    """Return all benchmarks by name; quick: run nodes for a few seconds only."""
    arm = arm7()
    runs: tuple[Measurement, ...] = (
        lambda: peers.law_over_rnea(arm),
        lambda: peers.forward_dynamics_over_aba(arm),
        lambda: peers.step_over_mujoco(arm),
        lambda: closed_loop.times_real_time(arm),
        peers.virtual_machine_over_c,
        build.arms,
        start_up.library,
        start_up.node,
        start_up.command,
        lambda: round_trip.over_echo(arm, *((3,) if quick else ())),
        lambda: on_time.answered(*((5.0,) if quick else ())),
        lambda: gaps.longest(quick),
        lambda: pauses.recovered(*((3, 1) if quick else ())),
        lambda: certificate.with_and_without(arm, *((3,) if quick else ())),
        lambda: periods.late(*((10.0,) if quick else ())),
        lambda: lock_step.over_ping_pong(*((2, 3.0) if quick else ())),
        lambda: campaign.against_peers(*((500, 2) if quick else ())),
        lambda: proof.over_joint_range_and_tube(arm, *((20,) if quick else ())),
        lambda: identification_peers.against_mujoco(arm, *((2, 0) if quick else ())),
        lambda: identification_time.of_a_minute(*((5.0,) if quick else ())),
        lambda: starts.arm7(quick),
        lambda: memory.flat(*((0.5,) if quick else ())),
        lambda: campaign_memory.bounded(*((20_000,) if quick else ())),
        lambda: report_memory.bounded(*((1.0,) if quick else ())),
    )
    return dict(zip(NAMES, runs, strict=True))


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    made = argparse.ArgumentParser(prog="bench", description="Measure against peers, in turns, and check the bounds.")
    made.add_argument(
        "--only",
        nargs="+",
        choices=NAMES,
        metavar="NAME",
        help=f"some of {', '.join(NAMES)} (default: all but {', '.join(LONG)})",
    )
    made.add_argument("--quick", action="store_true", help="run nodes for a few seconds only; bounds do not apply")
    made.add_argument("--document", type=Path, help="where the table of all figures of this day goes (Markdown)")
    made.add_argument("--output", type=Path, default=RESULTS, help=f"where the JSON goes (default: {RESULTS})")
    return made


def processor() -> str:
    """Return the processor model."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.machine()


def write(figures: list[Figure], path: Path) -> dict[str, Any]:
    """Write the figures with machine and date, and keep the other figures of this day and machine; return all."""
    machine = {"processor": processor(), "cores": os.cpu_count(), "python": platform.python_version()}
    versions = {module.__name__: module.__version__ for module in (casadi, mujoco, numpy, pinocchio)}
    document: dict[str, Any] = {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "machine": machine,
        "versions": versions,
    }
    before = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    same = before.get("machine") == machine and before.get("date", "")[:10] == document["date"][:10]
    found = {each["name"]: each for each in (before["figures"] if same else [])}
    document["figures"] = list((found | {figure.name: figure.as_json() for figure in figures}).values())
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return document


if __name__ == "__main__":
    sys.exit(main())
