# SPDX-License-Identifier: Apache-2.0
"""Robot driver in its own process: send states at 1 kHz and measure the time until the effort arrives.

    python -m bench.driver --ros-args -p rounds:=3 -p sides:="[ours, bare]" -p position:="[...]"

Blocks of states go to the sides (namespaces) in turns; a state waits for the effort of the previous one. Print JSON:
for each side its rounds, each a list of the times [us].
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Sequence

from std_msgs.msg import Float64MultiArray

from bench.bare import PERIOD, Bare, full_state, stamp
from fjr_msgs_py import names
from fjr_msgs_py.node import process

BLOCK = 250  # consecutive states to one side
BLOCKS = 4  # of each side per round
LONGEST = 0.1  # s; timeout of an effort


class Driver(Bare):
    """Publish <side>/joint_states and subscribe to <side>/effort_controller/commands."""

    def build(self) -> None:
        """Create the endpoints; every tick checks whether the peers are connected."""
        self._sides: list[str] = list(self.get_parameter("sides").value)
        self._rounds = self.get_parameter("rounds").value + 1  # the first is discarded
        self._state = full_state()
        self._state.position = self.get_parameter("position").value
        self._states = [self.publisher(f"{side}/{names.JOINT_STATES}") for side in self._sides]
        for side in self._sides:
            topic = f"{side}/{names.EFFORT_COMMANDS}"
            self.create_subscription(Float64MultiArray, topic, self._on_effort, names.LATEST)
        self._blocks: list[list[float]] = [[]]
        self._sent = 0.0  # s; 0: no state is pending
        self._ready = False
        self.every(PERIOD * 1e-9, self._tick)

    def stop(self) -> None:
        """Print the measured times."""
        print(json.dumps(rounds(self._blocks, self._sides, self._rounds)), flush=True)

    def _tick(self) -> None:
        if not self._ready:
            self._ready = all(states.get_subscription_count() for states in self._states)
        elif not self._sent or time.perf_counter() - self._sent > LONGEST:
            stamp(self._state, self.get_clock().now().nanoseconds)
            self._sent = time.perf_counter()
            self._states[(len(self._blocks) - 1) % len(self._sides)].publish(self._state)

    def _on_effort(self, _: Float64MultiArray) -> None:
        if self._sent:
            self._blocks[-1].append((time.perf_counter() - self._sent) * 1e6)
            self._sent = 0.0
            if len(self._blocks[-1]) == BLOCK:
                if len(self._blocks) == self._rounds * BLOCKS * len(self._sides):
                    os.kill(os.getpid(), signal.SIGINT)
                self._blocks.append([])


def rounds(blocks: Sequence[list[float]], sides: Sequence[str], count: int) -> dict[str, list[list[float]]]:
    """Return the times of each side by round, without the first round; blocks of the sides alternate."""
    of_side = {side: blocks[index :: len(sides)] for index, side in enumerate(sides)}
    return {
        side: [sum(own[k * BLOCKS : (k + 1) * BLOCKS], []) for k in range(1, count)] for side, own in of_side.items()
    }


if __name__ == "__main__":
    sys.exit(process.run(lambda: Driver("fjr_bench_driver"), sys.argv[1:]))
