# SPDX-License-Identifier: Apache-2.0
"""Message channels with delay, jitter, loss and duplication in robot time; without ROS.

Make one channel for outgoing states and one for incoming commands:

    channel(errors, seed, STATES) -> Channel | None          # None: no errors

States: `states.push(robot.time, (robot.time, *robot.measure()))`, then publish the items of `states.due(robot.time)`,
each with the stamp of its measurement. Commands: `commands.push(robot.time, effort)`; while integrating up to `now`,
stop at each instant at which a command takes effect:

    while (instant := commands.next_due) is not None and instant <= now:
        robot.advance_to(instant)
        for robot.u in commands.due(instant): pass
    robot.advance_to(now)

An effort acts from the last inner step at or before its instant, so that a delay of whole inner steps is exact. In
lock-step, if nothing is due for a sample (lost or delayed), hold the effort and continue with the next sample. Items
must not change after they were pushed: push numbers, not a message that is reused.
"""

from __future__ import annotations

import heapq
from typing import Generic, TypeVar

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_core.simulation.nonideal_parameters import NANOSECONDS, ChannelErrors

from .state_publisher import Sample

STATES, COMMANDS, SENSORS, PERIOD = range(4)  # streams of random numbers of a seed
Item = TypeVar("Item")


def generator(seed: int, stream: int) -> np.random.Generator:
    """Return the generator of a stream (STATES, COMMANDS, SENSORS, PERIOD) of a seed; streams are independent."""
    return np.random.default_rng([seed, stream])


class Channel(Generic[Item]):
    """Channel for items in transit. Times are integer nanoseconds of robot time; no clock is read.

    Loss, duplication and delay of the k-th item depend only on seed, stream, k and the errors, so that a run repeats
    exactly. Each error has its own random numbers, so that changing one does not affect the others.
    """

    def __init__(self, errors: ChannelErrors, seed: int = 0, stream: int = STATES) -> None:
        self.errors = errors
        self._seed, self._stream = seed, stream
        self.reset()

    def reset(self) -> None:
        """Discard all items and restart the random sequence."""
        self._random = generator(self._seed, self._stream)
        self._in_transit: list[tuple[int, int, Item]] = []  # a heap: due, number, item
        self._number = 0
        self._latest = 0

    def change(self, errors: ChannelErrors) -> None:
        """Use other errors for items pushed from now on; items in transit arrive unchanged."""
        self.errors = errors

    def push(self, time: int, item: Item) -> None:
        """Send an item at `time` [ns]."""
        lost, duplicated, wait, wait_of_copy = self._random.random(4)  # always four, so that errors stay independent
        if lost < self.errors.loss:
            return
        self._send(time, wait, item)
        if duplicated < self.errors.repetition:
            self._send(time, wait_of_copy, item)

    def due(self, time: int) -> list[Item]:
        """Return and remove the items that have arrived by `time` [ns], in the order of arrival."""
        arrived = []
        while self._in_transit and self._in_transit[0][0] <= time:
            arrived.append(heapq.heappop(self._in_transit)[2])
        return arrived

    @property
    def next_due(self) -> int | None:
        """Arrival time of the next item [ns]; None: no items in transit."""
        return self._in_transit[0][0] if self._in_transit else None

    def _send(self, time: int, share: float, item: Item) -> None:
        due = time + round((self.errors.delay + self.errors.jitter * share) * NANOSECONDS)
        if self.errors.in_order:
            due = max(due, self._latest)
        self._latest = max(due, self._latest)
        heapq.heappush(self._in_transit, (due, self._number, item))
        self._number += 1


def channel(errors: ChannelErrors | None, seed: int, stream: int) -> Channel | None:
    """Return a channel with these errors; None if they are off, which costs nothing."""
    return None if errors is None or errors.off else Channel(errors, seed, stream)


class SampleTimes:
    """Sample times: every period, each delayed by a uniform share of the jitter, in whole inner steps.

    The k-th sample is at k period + jitter_k, rounded down to an inner step, so that delays do not accumulate. If the
    jitter is below the period, the instants increase by at least one inner step.
    """

    def __init__(self, period: int, inner_step: int, jitter: float, seed: int = 0) -> None:
        """Start at time 0; period, inner_step [ns], jitter [s]."""
        self._period, self._inner_step = period, inner_step
        self.jitter = jitter
        self._seed = seed
        self.reset()

    def reset(self) -> None:
        """Return to the first sample at time 0 and restart the random sequence."""
        self._random = generator(self._seed, PERIOD)
        self._k = 0
        self.now = 0

    def next(self) -> int:
        """Advance to the next sample and return its time [ns], also available as `now`."""
        self._k += 1
        late = round(self._random.random() * self.jitter * NANOSECONDS)
        instant = self._k * self._period + late
        self.now = max(instant - instant % self._inner_step, self.now + self._inner_step)
        return self.now


class Transport:
    """Channels for states and commands, None without errors, and the sample times."""

    states: Channel[Sample] | None
    commands: Channel[Array] | None

    def __init__(self, period: int, inner_step: int, seed: int) -> None:
        """Start without errors; period, inner_step [ns]."""
        self.period = period
        self._inner_step = inner_step
        self._errors: tuple[ChannelErrors, ChannelErrors] = (ChannelErrors(), ChannelErrors())
        self._seed = seed
        self.times = SampleTimes(period, inner_step, 0.0, seed)
        self.reset()

    def reset(self) -> None:
        """Discard all messages and restart all random sequences."""
        states, commands = self._errors
        self.states, self.commands = channel(states, self._seed, STATES), channel(commands, self._seed, COMMANDS)
        self.times.reset()

    def lateness(self) -> int:
        """Return the delay of the next sample [ns]."""
        return self.times.next() % self.period if self.times.jitter else 0

    def change(self, states: ChannelErrors, commands: ChannelErrors, jitter: float) -> None:
        """Use other errors for messages sent from now on and another jitter [s] of the sample times."""
        self._errors = states, commands
        self.states = _changed(self.states, states, self._seed, STATES)
        self.commands = _changed(self.commands, commands, self._seed, COMMANDS)
        self.times.jitter = jitter


def _changed(found: Channel | None, errors: ChannelErrors, seed: int, stream: int) -> Channel | None:
    """Return the channel with other errors; an existing channel keeps its items."""
    if found is None:
        return channel(errors, seed, stream)
    found.change(errors)
    return found
