# SPDX-License-Identifier: Apache-2.0
"""What happens to messages on their way, in the robot's time: delay, jitter, loss, repetition; without ROS.

How a node uses it. Make one channel for states going out and one for commands coming in:

    channel(errors, seed, STATES) -> Channel | None          # None: everything off, nothing to do

State: `states.push(robot.time, (robot.time, *robot.measure()))`, then publish what `states.due(robot.time)` gives,
each with the stamp of its measurement. Command: `commands.push(robot.time, effort)`, and while integrating up to
`now`, stop wherever a command takes effect:

    while (instant := commands.next_due) is not None and instant <= now:
        robot.advance_to(instant)
        for robot.u in commands.due(instant): pass
    robot.advance_to(now)

An effort acts from the last inner step at or before its instant on; a delay of whole inner steps is exact.
Lock-step: where nothing is due for the sample (lost or still on its way) there is nobody to wait for: hold the
effort and go on to the next sample. An item must not change after it was pushed: push numbers, not a message
that is filled again and again.
"""

from __future__ import annotations

import heapq
from typing import Generic, TypeVar

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_core.simulation.nonideal_parameters import NANOSECONDS, ChannelErrors

from .state_publisher import Sample

STATES, COMMANDS, SENSORS, PERIOD = range(4)  # which random sequence of a seed is whose
Item = TypeVar("Item")


def generator(seed: int, stream: int) -> np.random.Generator:
    """The random sequence number `stream` (STATES, COMMANDS, SENSORS, PERIOD) of a seed: independent of the others."""
    return np.random.default_rng([seed, stream])


class Channel(Generic[Item]):
    """Items in flight. Times are integer nanoseconds of the robot; nothing here looks at a clock.

    The fate of the k-th item pushed depends on the seed, the stream, k and the errors only, so a run repeats
    exactly; each of the errors has its own random numbers, so changing one leaves the fate by the others as it was.
    """

    def __init__(self, errors: ChannelErrors, seed: int = 0, stream: int = STATES) -> None:
        self.errors = errors
        self._seed, self._stream = seed, stream
        self.reset()

    def reset(self) -> None:
        """Nothing in flight, and the random sequence from its start."""
        self._random = generator(self._seed, self._stream)
        self._flying: list[tuple[int, int, Item]] = []  # a heap: due, number, item
        self._number = 0
        self._latest = 0

    def change(self, errors: ChannelErrors) -> None:
        """Other errors for what is pushed from now on; what is in flight arrives as it would have."""
        self.errors = errors

    def push(self, time: int, item: Item) -> None:
        """Send an item at `time` [ns]."""
        lost, repeated, wait, wait_of_copy = self._random.random(4)  # always four: fates stay apart
        if lost < self.errors.loss:
            return
        self._send(time, wait, item)
        if repeated < self.errors.repetition:
            self._send(time, wait_of_copy, item)

    def due(self, time: int) -> list[Item]:
        """What has arrived by `time` [ns] and was not given before, in the order of arrival."""
        arrived = []
        while self._flying and self._flying[0][0] <= time:
            arrived.append(heapq.heappop(self._flying)[2])
        return arrived

    @property
    def next_due(self) -> int | None:
        """When the next item arrives [ns]; None: nothing is in flight."""
        return self._flying[0][0] if self._flying else None

    def _send(self, time: int, share: float, item: Item) -> None:
        due = time + round((self.errors.delay + self.errors.jitter * share) * NANOSECONDS)
        if self.errors.in_order:
            due = max(due, self._latest)
        self._latest = max(due, self._latest)
        heapq.heappush(self._flying, (due, self._number, item))
        self._number += 1


def channel(errors: ChannelErrors | None, seed: int, stream: int) -> Channel | None:
    """A channel with these errors; None where they are off, so that what is off costs nothing."""
    return None if errors is None or errors.off else Channel(errors, seed, stream)


class SampleTimes:
    """When samples are taken: every period, each late by a uniform share of the jitter; in whole inner steps.

    The k-th is at k period + jitter_k, rounded down to an inner step: lateness does not add up. With a jitter
    below the period the instants grow, by at least one inner step.
    """

    def __init__(self, period: int, inner_step: int, jitter: float, seed: int = 0) -> None:
        """period, inner_step [ns], jitter [s]."""
        self._period, self._inner_step = period, inner_step
        self.jitter = jitter
        self._seed = seed
        self.reset()

    def reset(self) -> None:
        """Back to the first sample, at time 0."""
        self._random = generator(self._seed, PERIOD)
        self._k = 0
        self.now = 0

    def next(self) -> int:
        """The next sample's time [ns], which `now` gives from here on."""
        self._k += 1
        late = round(self._random.random() * self.jitter * NANOSECONDS)
        instant = self._k * self._period + late
        self.now = max(instant - instant % self._inner_step, self.now + self._inner_step)
        return self.now


class Transport:
    """Two channels, None where a message arrives once and at once, and the lateness of samples."""

    states: Channel[Sample] | None
    commands: Channel[Array] | None

    def __init__(self, period: int, inner_step: int, seed: int) -> None:
        """period, inner_step [ns]."""
        self.period = period
        self._inner_step = inner_step
        self._errors: tuple[ChannelErrors, ChannelErrors] = (ChannelErrors(), ChannelErrors())
        self._seed = seed
        self.times = SampleTimes(period, inner_step, 0.0, seed)
        self.reset()

    def reset(self) -> None:
        """Nothing is on its way, and every random sequence starts again."""
        states, commands = self._errors
        self.states, self.commands = channel(states, self._seed, STATES), channel(commands, self._seed, COMMANDS)
        self.times.reset()

    def lateness(self) -> int:
        """How late the next sample is taken [ns]."""
        return self.times.next() % self.period if self.times.jitter else 0

    def change(self, states: ChannelErrors, commands: ChannelErrors, jitter: float) -> None:
        """Other errors for what is sent from now on, and another lateness of samples [s]."""
        self._errors = states, commands
        self.states = _changed(self.states, states, self._seed, STATES)
        self.commands = _changed(self.commands, commands, self._seed, COMMANDS)
        self.times.jitter = jitter


def _changed(found: Channel | None, errors: ChannelErrors, seed: int, stream: int) -> Channel | None:
    """The channel with other errors; one that is there stays, for what is on its way in it."""
    if found is None:
        return channel(errors, seed, stream)
    found.change(errors)
    return found
