# SPDX-License-Identifier: Apache-2.0
"""`fjr sweep`, `fjr tune` and `fjr compare`: studies by simulation, without nodes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from fjr_design.studies.comparison import command as comparison
from fjr_msgs_py.console.interrupt import stoppable
from fjr_msgs_py.console.result import Result
from fjr_msgs_py.scenarios import library


def sweep(scenario: str | None, runs: int | None, **given: Any) -> Result:
    """Run a Monte-Carlo study; runs: None keeps the number of the study. given: see _options."""
    monte_carlo = _monte_carlo()
    with stoppable() as stop:
        found: Result = monte_carlo.sweep(scenario, _options(runs=runs, **given), stop)
        return found


def tune(
    scenario: str | None, law: str | None, draws: int | None, candidates: int | None, fresh: int | None, **given: Any
) -> Result:
    """Tune gains for stated uncertainties; None keeps the number of the study. given: see _options."""
    tuning = import_module("fjr_design.studies.tuning.command")  # loads pyarrow, as a sweep
    size = _without_none(draws=draws, candidates=candidates, fresh=fresh)
    with stoppable() as stop:
        found: Result = tuning.tune(scenario, _options(**given), law, size, stop)
        return found


def _monte_carlo() -> Any:
    """Return the module of a sweep; it loads pyarrow, which other commands do not need."""
    return import_module("fjr_design.studies.monte_carlo.command")


def _options(
    assignments: Sequence[str], cores: int, scheduler: str | None, output: Path, **numbers: float | None
) -> Any:
    """Return the Options of a study of drawn plants; numbers: of the study, None keeps its own."""
    overrides = library.parse_assignments(assignments)
    return _monte_carlo().Options(cores, scheduler, output, overrides, _without_none(**numbers))


def _without_none(**numbers: float | None) -> dict[str, float]:
    return {name: value for name, value in numbers.items() if value is not None}


def compare(suite: str, output: Path, cores: int | None, document: Path | None, readme: Path | None) -> Result:
    """Compare control laws; document: page to which the table is written; readme: deprecated name of document."""
    if readme is not None:
        print("fjr: --readme is deprecated; use --document", file=sys.stderr)
    with stoppable() as stop:
        return comparison.compare(suite, output, cores, document or readme, stop)
