# SPDX-License-Identifier: Apache-2.0
"""Time calls alternately (A B A B ...), so that a slower machine affects all of them."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from timeit import timeit

import numpy as np

from fjr_core.numerics.checks import Array

REPEATS = 41
BLOCK = 5e-3  # s; approximate duration of a block of calls

Call = Callable[[], object]


@contextmanager
def one_core() -> Iterator[None]:
    """Pin this process to one core, if the system allows it, and disable the garbage collector."""
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if allowed:
        os.sched_setaffinity(0, {max(allowed)})
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        if allowed:
            os.sched_setaffinity(0, allowed)


def in_turns(calls: Mapping[str, Call], repeats: int = REPEATS) -> dict[str, Array]:
    """Return seconds per call of each, one entry per repeat; blocks of the calls alternate."""
    with one_core():
        counts = {name: _block_size(call) for name, call in calls.items()}
        rounds = [
            [timeit(call, number=counts[name]) / counts[name] for name, call in calls.items()] for _ in range(repeats)
        ]
    return dict(zip(calls, np.array(rounds).T, strict=True))


def ratio(ours: Array, theirs: Array) -> float:
    """Return the median over the repeats of ours / theirs."""
    return float(np.median(ours / theirs))


def microseconds(times: Mapping[str, Array]) -> dict[str, float]:
    """Return the medians [us]."""
    return {f"{name} [us]": 1e6 * float(np.median(seconds)) for name, seconds in times.items()}


def _block_size(call: Call) -> int:
    """Return the number of calls that take about BLOCK, after a warm-up call."""
    call()
    count = 1
    while timeit(call, number=count) < BLOCK:
        count *= 2
    return count
