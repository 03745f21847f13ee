# SPDX-License-Identifier: Apache-2.0
"""Share of late periods at 1 kHz: plant and controller in real time against a bare timer node."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.figures import Figure
from bench.nodes import bare, controller, plant, running, scenario_file
from bench.tap import Tap
from fjr_msgs_py import names

SECONDS = 60.0
LATE = 1_500_000  # ns
MOST = 0.1  # %; allowed share regardless of the bare node
FACTOR = 1.25
WARM_UP = 2.0  # s
LONGEST = 60.0  # s; timeout of the start


def late(seconds: float = SECONDS) -> list[Figure]:
    """Measure the share of late periods of states and commands; the bare node runs half before, half after."""
    before = _bare(seconds / 2)
    states, commands = _ours(seconds)
    theirs = np.concatenate([before, _bare(seconds / 2)])
    return [figure("states", states, theirs), figure("commands", commands, theirs)]


def _ours(seconds: float) -> list[NDArray[np.int64]]:
    with scenario_file() as file, running(plant(file), controller(file)):
        return _periods([names.JOINT_STATES, names.JOINT_COMMANDS], seconds)


def _bare(seconds: float) -> NDArray[np.int64]:
    with scenario_file(), running(bare("timer")):
        return _periods([names.JOINT_STATES], seconds)[0]


def _periods(topics: list[str], seconds: float) -> list[NDArray[np.int64]]:
    with Tap() as tap:
        tap.sent(topics, WARM_UP, LONGEST)
        return [np.diff(times) for times in tap.sent(topics, seconds, LONGEST)]


def _share(periods: NDArray[np.int64]) -> float:
    return 100 * float(np.mean(periods > LATE))


def figure(what: str, ours: NDArray[np.int64], theirs: NDArray[np.int64]) -> Figure:
    """Return the share of late periods [ns], bounded by that of the bare node."""
    bound = max(FACTOR * _share(theirs), MOST)
    parts = {
        "bare [%]": _share(theirs),
        "longest [ms]": 1e-6 * float(np.max(ours)),
        "bare, longest [ms]": 1e-6 * float(np.max(theirs)),
        "periods": float(len(ours)),
    }
    return Figure(f"{what} later than 1.5 ms at 1 kHz", _share(ours), "%", bound=bound, parts=parts)
