# SPDX-License-Identifier: Apache-2.0
"""Evaluate candidates of a tuning study with the workers of a sweep; finished parts are kept."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass

from fjr_design.experiments.tuning.candidates import Point, Range, run_candidate
from fjr_design.experiments.tuning.goal import Figures, Score, joined
from fjr_design.studies.monte_carlo.pool import AHEAD, LOOK, Workers, result_of
from fjr_design.studies.tuning.store import Part, TuningStore
from fjr_msgs_py.console.ending import Interrupted

SMALL, LARGE, MANY = 16, 200, 1000
"""Runs of a part: of a few draws, of at least MANY draws."""


@dataclass(frozen=True)
class Evaluation:
    """Evaluates points of the study of a store; raises Interrupted when `stop` is set.

    on_progress: called with the number of runs of each part, also of a kept one.
    """

    store: TuningStore
    workers: Workers
    stop: threading.Event
    on_progress: Callable[[int], object] = lambda runs: None

    def __call__(self, points: Sequence[Point], runs: Range) -> list[Score]:
        """Return the scores of points over a range of runs."""
        study = self.store.study
        return [study.score(point, found) for point, found in zip(points, self.figures(points, runs), strict=True)]

    def figures(self, points: Sequence[Point], runs: Range) -> list[Figures]:
        """Return the figures of points over a range of runs; empty if a point has no gains."""
        parts = {point: list(_parts(point, runs)) for point in points}
        self._run([part for each in parts.values() for part in each if part not in self.store.parts])
        for _, begin, end in (part for each in parts.values() for part in each):
            self.on_progress(end - begin)
        return [joined([self.store.parts[part] for part in parts[point]]) for point in points]

    def _run(self, missing: list[Part]) -> None:
        """Run and keep the missing parts."""
        waiting, pending = iter(missing), dict[Future[Figures], Part]()
        text = self.store.study.text
        try:
            while not self.stop.is_set():
                for part in waiting:
                    pending[self.workers.executor.submit(run_candidate, text, *part)] = part
                    if len(pending) >= AHEAD * self.workers.count:
                        break
                if not pending:
                    return
                done, _ = wait(pending, timeout=LOOK, return_when=FIRST_COMPLETED)
                for future in done:
                    self.store.keep(pending.pop(future), result_of(future, self.workers.remote))
        finally:
            for future in pending:
                future.cancel()
        raise Interrupted(self.store.folder)


def _parts(point: Point, runs: Range) -> list[Part]:
    begin, end = runs
    size = LARGE if end - begin >= MANY else SMALL
    return [(point, first, min(first + size, end)) for first in range(begin, end, size)]
