# SPDX-License-Identifier: Apache-2.0
"""Message channels with delay, jitter, loss and duplication in robot time, see channel.h; without ROS."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array
from fjr_core.simulation.imperfections import NANOSECONDS, ChannelErrors

from .native import plant_program

STATES, COMMANDS, SENSORS, PERIOD = range(4)  # streams of random numbers of a seed
SPARE = 256  # items in transit beyond two per period of the delay


def generator(seed: int, stream: int) -> np.random.Generator:
    """Return the generator of a stream (STATES, COMMANDS, SENSORS, PERIOD) of a seed; streams are independent."""
    return np.random.default_rng([seed, stream])


class Random:
    """A stream of random numbers for C, which draws what the generator would."""

    def __init__(self, seed: int, stream: int) -> None:
        self._seed = seed, stream

    def restart(self) -> Any:
        """Return the stream from its beginning on as a struct fjr_random*; it ends with the next call."""
        self._generator = generator(*self._seed)
        return plant_program().ffi.cast("struct fjr_random*", self._generator.bit_generator.ctypes.bit_generator.value)


class Channel:
    """A channel for items of `width` numbers in transit, as struct fjr_channel.

    Loss, duplication and delay of the k-th item depend only on seed, stream, k and the errors, so that a run repeats
    exactly. Each error has its own random numbers, so that changing one does not affect the others.
    """

    def __init__(
        self, errors: ChannelErrors, seed: int = 0, stream: int = STATES, width: int = 1, period: int = 1_000_000
    ) -> None:
        """period: usual time between two items [ns]."""
        self._program, self._random, self._period = plant_program(), Random(seed, stream), period
        self.pointer = self._program.ffi.new("struct fjr_channel*", {"width": width})
        self.errors = errors
        self._arrays: tuple[NDArray[Any], ...] = ()
        self.reset()

    def reset(self) -> None:
        """Discard all items and restart the random sequence."""
        p = self.pointer
        p.on = p.capacity = p.first = p.count = p.latest = 0
        p.random = self._random.restart()
        self.change(self.errors)

    def change(self, errors: ChannelErrors) -> None:
        """Use other errors for items pushed from now on; items in transit arrive unchanged."""
        self.errors, p = errors, self.pointer
        p.delay, p.jitter, p.loss, p.repetition = errors.delay, errors.jitter, errors.loss, errors.repetition
        p.in_order, p.on = errors.in_order, p.on or not errors.off
        longest = (errors.delay + errors.jitter) * NANOSECONDS
        if p.on:
            self._reserve(SPARE + 2 * math.ceil(longest / self._period))

    def push(self, time: int, item: Array) -> None:
        """Send an item (width,) at `time` [ns]."""
        self._program.lib.fjr_channel_push(self.pointer, time, self._program.array(item))

    def due(self, time: int) -> list[Array]:
        """Return and remove the items that have arrived by `time` [ns], in the order of arrival."""
        ffi, arrived = self._program.ffi, []
        while (item := self._program.lib.fjr_channel_pop(self.pointer, time)) != ffi.NULL:
            arrived.append(np.frombuffer(ffi.buffer(item, 8 * self.pointer.width)).copy())
        return arrived

    @property
    def next_due(self) -> int | None:
        """Arrival time of the next item [ns]; None: no items in transit."""
        return int(self._program.lib.fjr_channel_next(self.pointer)) if self.pointer.count else None

    @property
    def on(self) -> bool:
        """False if every item arrives at once, so that none needs to be sent."""
        return bool(self.pointer.on)

    def _reserve(self, capacity: int) -> None:
        """Make place for at least so many items; those in transit stay."""
        p = self.pointer
        if capacity <= p.capacity:
            return
        slot, due = np.arange(capacity, dtype=np.int32), np.zeros(capacity, dtype=np.int64)
        items = np.zeros((capacity, p.width))
        if p.count:
            old_slot, old_due, old_items = self._arrays
            order = old_slot[(p.first + np.arange(p.count)) % len(old_slot)]
            due[: p.count], items[: p.count] = old_due[order], old_items[order]
        self._arrays = slot, due, items
        self._kept = [self._program.array(each) for each in (slot, due, items.reshape(-1))]
        p.slot, p.due, p.items = self._kept
        p.capacity, p.first = capacity, 0


class SampleTimes:
    """Sample times with jitter, as struct fjr_sample_times.

    The k-th sample is at k period + jitter_k, rounded down to an inner step, so that delays do not accumulate. If the
    jitter is below the period, the instants increase by at least one inner step.
    """

    def __init__(self, period: int, inner_step: int, jitter: float, seed: int = 0) -> None:
        """Start at time 0; period, inner_step [ns], jitter [s]."""
        self._program, self._random = plant_program(), Random(seed, PERIOD)
        given = {"period": period, "inner_step": inner_step, "jitter": jitter}
        self.pointer = self._program.ffi.new("struct fjr_sample_times*", given)
        self.reset()

    def reset(self) -> None:
        """Return to the first sample at time 0 and restart the random sequence."""
        self.pointer.k = self.pointer.now = 0
        self.pointer.random = self._random.restart()

    def next(self) -> int:
        """Advance to the next sample and return its time [ns]."""
        return int(self._program.lib.fjr_sample_times_next(self.pointer))


class Transport:
    """Channels for states and commands, and the sample times."""

    def __init__(self, n: int, period: int, inner_step: int, seed: int) -> None:
        """Start without errors; n: joints; period, inner_step [ns]."""
        self.period = period
        self.times = SampleTimes(period, inner_step, 0.0, seed)
        self.states = Channel(ChannelErrors(), seed, STATES, 2 + 6 * n, period)
        self.commands = Channel(ChannelErrors(), seed, COMMANDS, n, period)

    def reset(self) -> None:
        """Discard all messages and restart all random sequences."""
        for part in (self.states, self.commands, self.times):
            part.reset()

    def change(self, states: ChannelErrors, commands: ChannelErrors, jitter: float) -> None:
        """Use other errors for messages sent from now on and another jitter [s] of the sample times."""
        self.states.change(states)
        self.commands.change(commands)
        self.times.pointer.jitter = jitter
