# SPDX-License-Identifier: Apache-2.0
"""`fjr contraction`, `fjr sweep`, `fjr tune` and `fjr compare`: studies by simulation, without nodes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from fjr_bringup.interrupt import stoppable
from fjr_bringup.result import Result
from fjr_bringup.scenarios import library
from fjr_bringup.studies.comparison import command as comparison
from fjr_bringup.studies.contraction import run as contraction_study


def contraction(
    scenario: str | None,
    assignments: Sequence[str],
    run_folder: Path | None,
    duration: float,
    starts: int,
    spread: float,
    seed: int,
    output: Path,
) -> Result:
    """Simulate solutions of the virtual system along a run and draw how they converge."""
    loaded = library.load(scenario, assignments)
    wish = contraction_study.Options(duration, starts, spread, seed)
    with stoppable() as stop:
        return contraction_study.run_and_draw(loaded, wish, run_folder, output / "contraction", stop)


def sweep(
    scenario: str | None,
    assignments: Sequence[str],
    runs: int | None,
    seed: int | None,
    duration: float | None,
    cores: int,
    scheduler: str | None,
    output: Path,
) -> Result:
    """Run a Monte-Carlo study; None keeps the number of the study."""
    # loads pyarrow, which other commands do not need
    monte_carlo = import_module("fjr_bringup.studies.monte_carlo.command")
    numbers = _given(runs=runs, seed=seed, duration=duration)
    wish = monte_carlo.Options(cores, scheduler, output, library.parse_assignments(assignments), numbers)
    with stoppable() as stop:
        found: Result = monte_carlo.sweep(scenario, wish, stop)
        return found


def tune(
    scenario: str | None,
    assignments: Sequence[str],
    law: str | None,
    draws: int | None,
    candidates: int | None,
    fresh: int | None,
    seed: int | None,
    duration: float | None,
    cores: int,
    scheduler: str | None,
    output: Path,
) -> Result:
    """Tune gains for stated uncertainties; None keeps the number of the study."""
    tuning = import_module("fjr_bringup.studies.tuning.command")  # loads pyarrow, as a sweep
    monte_carlo = import_module("fjr_bringup.studies.monte_carlo.command")
    of_sweep, size = _given(seed=seed, duration=duration), _given(draws=draws, candidates=candidates, fresh=fresh)
    wish = monte_carlo.Options(cores, scheduler, output, library.parse_assignments(assignments), of_sweep)
    with stoppable() as stop:
        found: Result = tuning.tune(scenario, wish, law, size, stop)
        return found


def _given(**numbers: float | None) -> dict[str, float]:
    return {name: value for name, value in numbers.items() if value is not None}


def compare(suite: str, output: Path, cores: int | None, document: Path | None, readme: Path | None) -> Result:
    """Compare control laws; document: page to which the table is written; readme: deprecated name of document."""
    if readme is not None:
        print("fjr: --readme is deprecated; use --document", file=sys.stderr)
    with stoppable() as stop:
        return comparison.compare(suite, output, cores, document or readme, stop)
