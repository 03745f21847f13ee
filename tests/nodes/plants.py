# SPDX-License-Identifier: Apache-2.0
"""Helpers for tests of the plant node: the paper's joint integrated by fjr_core, its messages, its services."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

import fjr_core as fjr
from fjr_msgs_py.names import LATEST
from fjr_plant.lock_step import START
from nodes.harness import Peer, Ros, nanoseconds

INNER = 250_000  # ns, the default 1 kHz in 4 steps
PERIOD = 1_000_000  # ns


def integrate(x: np.ndarray, u: float, steps: int) -> np.ndarray:
    plant = fjr.Plant(fjr.single_link())
    for _ in range(steps):
        x = plant.step(x, [u], INNER * 1e-9)
    return x


def state_of(message: JointState) -> np.ndarray:
    return fjr.single_link().state(*(np.array([v]) for v in (*message.position, *message.velocity)))


def command(*efforts: float) -> Float64MultiArray:
    return Float64MultiArray(data=list(efforts))


def answer(state: JointState, effort: float, names: tuple[str, ...] = ("joint1",)) -> JointState:
    message = JointState(name=list(names), effort=[effort] * len(names))
    message.header.stamp.sec, message.header.stamp.nanosec = state.header.stamp.sec, state.header.stamp.nanosec
    return message


class CommandLoop:
    """A peer that commands an effort for each state, a function of the state, except for ignored ones."""

    def __init__(
        self,
        peer: Peer,
        ignores: tuple[int, ...] = (),
        effort: Callable[[JointState], float] = lambda s: -0.2 * s.position[0] - 0.01 * s.velocity[1],
    ) -> None:
        """ignores: numbers of states; the first state received is 1."""
        self._peer = peer
        self._ignored = ignores
        self._effort = effort
        self._seen = 0

    def listen(self) -> None:
        """Answer each state on arrival."""
        self._peer.create_subscription(JointState, "joint_states", self._answer, LATEST)

    def until(self, ros: Ros, samples: int) -> None:
        """Answer all states before the given sample after the start, and wait for its state."""
        end = START + samples * PERIOD

        def done() -> bool:
            for state in self._peer.states[self._seen :]:
                self._seen += 1
                if self._seen not in self._ignored and nanoseconds(state) < end:
                    self._answer(state)
            return nanoseconds(self._peer.states[-1]) == end

        ros.until(done, f"sample {samples}")

    def _answer(self, state: JointState) -> None:
        self._peer.command_publisher.publish(answer(state, self._effort(state)))


def numbers(states: list[JointState]) -> list[tuple[int, bytes]]:
    """Return stamps and bytes of all numbers of the states, without repeated ones."""
    fields = ("position", "velocity", "effort")
    return list({nanoseconds(s): b"".join(getattr(s, f).tobytes() for f in fields) for s in states}.items())
