# SPDX-License-Identifier: Apache-2.0
"""Times of calls, measured in turns (A B A B ...), so that a machine that slows down slows all of them."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import repeat
from time import perf_counter

import numpy as np

from fjr_core.numerics.checks import Array

REPEATS = 41
BLOCK = 5e-3  # s; a block is as many calls as take about so long

Call = Callable[[], object]


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process on one core, and the garbage collector quiet, where the system allows it."""
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
    """Seconds per call of each, one entry a repeat; each block of one is followed by a block of the next."""
    with one_core():
        counts = {name: _block_size(call) for name, call in calls.items()}
        rounds = [[_seconds_per_call(call, counts[name]) for name, call in calls.items()] for _ in range(repeats)]
    return dict(zip(calls, np.array(rounds).T, strict=True))


def ratio(ours: Array, theirs: Array) -> float:
    """The median over the repeats of ours over theirs, each taken beside the other."""
    return float(np.median(ours / theirs))


def microseconds(times: Mapping[str, Array]) -> dict[str, float]:
    """Medians for a table."""
    return {f"{name} [us]": 1e6 * float(np.median(seconds)) for name, seconds in times.items()}


def _block_size(call: Call) -> int:
    """How many calls take about BLOCK; the first call, which may build what it needs, does not count."""
    call()
    count = 1
    while _seconds_per_call(call, count) * count < BLOCK:
        count *= 2
    return count


def _seconds_per_call(call: Call, count: int) -> float:
    start = perf_counter()
    for _ in repeat(None, count):
        call()
    return (perf_counter() - start) / count
