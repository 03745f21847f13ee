# SPDX-License-Identifier: Apache-2.0
"""What lies between the robot and its controller: states on their way out, commands on their way in, sample times."""

from __future__ import annotations

from fjr_core.numerics.checks import Array
from fjr_core.simulation.nonideal_signals import ChannelErrors

from .channel import COMMANDS, STATES, Channel, SampleTimes, channel
from .state_publisher import Sample


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
