# SPDX-License-Identifier: Apache-2.0
"""Bound of the tracking error against the largest error of simulated robots of its class, drawn and searched for.

`python -m bench.error_bound SCENARIO [NAME=VALUE ...] [runs=N] [searches=N]` prints the figures of one scenario, e.g.
for payload=0.2, with one sample of delay. It fails if a bound is missed.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from bench.figures import Figure, table
from bench.uncertain_robots import UncertainLoop
from fjr_core.numerics.checks import Array
from fjr_msgs_py.console.options import model_error
from fjr_msgs_py.scenarios import library
from fjr_proofs.check_rows import payload_position
from fjr_proofs.error_bound import bound_errors
from fjr_proofs.error_bound.search import SECONDS_TO_PROVE

RUNS, SEARCHES = 10_000, 200
ROUNDS = 15  # of a search
AT_ONCE = 250  # runs between two steps of the bar
SETTLED = 1.0  # s until errors count
SCENARIOS = {"paper_k31": (7.3, 1.5), "two_link": (7.3, 2.0), "arm7": (3.0, 3.0)}
"""Length [s] of a run, a period of the reference beyond SETTLED; largest ratio of bound and largest error."""


def of_scenario(
    name: str, errors: Mapping[str, ArrayLike], runs: int, searches: int, settings: list[str]
) -> list[Figure]:
    """Bound the tracking error for errors of parameters and one sample of delay; compare with runs and searches.

    The box of errors is not divided for a bound from the start.
    """
    scenario, (duration, limit) = library.load(name, settings), SCENARIOS[name]
    T, place = scenario.sample_period, payload_position(scenario)
    prove = None if scenario.robot.n <= SECONDS_TO_PROVE else True
    loop = scenario.law, scenario.reference, T, T
    bound = bound_errors(*loop, errors, prove=prove, payload_position=place, seconds=0.0)
    robots = UncertainLoop(*loop, errors, SETTLED, duration, place)
    steady, whole = drawn(robots, runs if errors else 1)
    found = robots.worst(searches, ROUNDS, bound.position) if errors and searches else steady[:0]
    largest, basis = np.max([*found, steady.max(axis=0)], axis=0), "proven" if bound.proven else "sampled"
    sizes = {
        f"{what} of {joint} [mrad]": 1e3 * float(size)
        for what, of_joints in (("bound", bound.position), ("largest error", largest))
        for joint, size in zip(scenario.joints, of_joints, strict=True)
    }
    ratio = float(np.max(bound.position / largest))
    return [
        Figure(f"{name}, {basis} error bound: runs of {len(steady)} beyond it", beyond(steady, bound.position), "", 0),
        Figure("... in parts", bound.parts, ""),
        Figure("... runs beyond the bound from the start", beyond(whole, bound.from_start), "", 0),
        Figure(f"... searches of {len(found)} beyond it", beyond(found, bound.position), "", 0),
        Figure("... bound / largest error, worst joint", ratio, "", limit, parts=sizes),
    ]


def beyond(peaks: Array, bound: Array) -> int:
    """Return the number of runs (k, n) that exceed a bound (n,)."""
    return int(np.count_nonzero(np.any(peaks > bound, axis=1))) if len(peaks) else 0


def drawn(loop: UncertainLoop, runs: int, seed: int = 0) -> tuple[Array, Array]:
    """Return the peaks of robots that are drawn uniformly; every second one is a corner of the class."""
    shares = np.random.default_rng(seed).uniform(-1, 1, (runs, loop.numbers))
    shares[::2] = np.sign(shares[::2])
    parts = [shares[i : i + AT_ONCE] for i in range(0, runs, AT_ONCE)]
    peaks = [loop.peaks(part) for part in tqdm(parts, desc="runs", disable=not sys.stderr.isatty())]
    steady, whole = (np.concatenate(each) for each in zip(*peaks, strict=True))
    if not np.all(np.isfinite(whole)):
        raise RuntimeError("a run is not stable; expected all of them to be")
    return steady, whole


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in SCENARIOS:
        sys.exit(f"usage: python -m bench.error_bound {'|'.join(SCENARIOS)} [NAME=VALUE ...] [runs=N] [searches=N]")
    settings = [word for word in sys.argv[2:] if ":=" in word]
    given = dict(model_error(word) for word in sys.argv[2:] if ":=" not in word)
    runs, searches = (int(np.max(given.pop(*of))) for of in (("runs", RUNS), ("searches", SEARCHES)))
    figures = of_scenario(sys.argv[1], given, runs, searches, settings)
    print(table(figures))
    sys.exit(not all(figure.holds for figure in figures))
