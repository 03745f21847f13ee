# SPDX-License-Identifier: Apache-2.0
"""`fjr sweep`, `fjr tune` and `fjr compare`: studies by simulation, without nodes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fjr_msgs_py.console.ending import stoppable
from fjr_msgs_py.console.output import Result
from fjr_msgs_py.scenarios import library

from ..studies.sweep_file import Options


def sweep(scenario: str | None, **given: Any) -> Result:
    """Run a sweep; given: see _options."""
    from fjr_design.studies.sweep_run import sweep as run  # loads pyarrow, which other commands do not need

    with stoppable() as stop:
        return run(scenario, _options(**given), stop)


def tune(
    scenario: str | None, law: str | None, draws: int | None, candidates: int | None, fresh: int | None, **given: Any
) -> Result:
    """Tune gains for stated uncertainties; None keeps the number of the study. given: see _options."""
    from fjr_design.studies.tune_run import tune as run

    size = _without_none(draws=draws, candidates=candidates, fresh=fresh)
    with stoppable() as stop:
        return run(scenario, _options(**given), law, size, stop)


def compare(suite: str, output: Path, cores: int | None, document: Path | None, readme: Path | None) -> Result:
    """Compare control laws; document: page to which the table is written; readme: deprecated name of document."""
    from fjr_design.studies.compare_run import compare as run

    if readme is not None:
        print("fjr: --readme is deprecated; use --document", file=sys.stderr)
    with stoppable() as stop:
        return run(suite, output, cores, document or readme, stop)


def _options(
    assignments: Sequence[str], cores: int, scheduler: str | None, output: Path, **numbers: float | None
) -> Options:
    """Return the options of a study of drawn plants; numbers: of the study, None keeps its own."""
    return Options(cores, scheduler, output, library.parse_assignments(assignments), _without_none(**numbers))


def _without_none(**numbers: float | None) -> dict[str, Any]:
    return {name: value for name, value in numbers.items() if value is not None}
