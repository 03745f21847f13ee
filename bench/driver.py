# SPDX-License-Identifier: Apache-2.0
"""Robot driver in its own process: send states at 1 kHz and measure the time until the effort arrives.

    python -m bench.driver --ros-args -p rounds:=3 -p sides:="[ours, bare]" -p position:="[...]"

Blocks of states go to the sides (namespaces) in turns; a state waits for the effort of the previous one. Print JSON:
for each side its rounds, each a list of the times [us]. States and efforts pass a native loop (driver.c), so that the
times are those of the nodes under test.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import Float64MultiArray

from bench.bare import JOINTS, PERIOD, Bare
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr import joint_state
from fjr_msgs_py.native.loop import NativeLoop, NativeMessage, NativeSubscription
from fjr_msgs_py.native.program import Program
from fjr_msgs_py.node import process

BLOCK = 250  # consecutive states to one side
BLOCKS = 4  # of each side per round
LONGEST = 100_000_000  # ns; timeout of an effort
LOOK_PERIOD = 0.05  # s


class Driver(Bare):
    """Publish <side>/joint_states and subscribe to <side>/effort_controller/commands."""

    def build(self) -> None:
        """Create the endpoints and the loop, which starts once all peers are connected."""
        self._sides: list[str] = list(self.get_parameter("sides").value)
        self._rounds = self.get_parameter("rounds").value + 1  # the first is discarded
        self._states = [self.publisher(f"{side}/{names.JOINT_STATES}") for side in self._sides]
        topics = [f"{side}/{names.EFFORT_COMMANDS}" for side in self._sides]
        self._efforts = [NativeSubscription(self, Float64MultiArray, topic, names.LATEST) for topic in topics]
        self._times = np.zeros(self._rounds * BLOCKS * BLOCK * len(self._sides))
        self._loop = self._native_loop()
        self._started = False
        self.every(LOOK_PERIOD, self._look)

    def stop(self) -> None:
        """End the loop and print the measured times."""
        self._loop.stop()
        print(json.dumps(rounds(self._times, self._sides, self._rounds)), flush=True)

    def _native_loop(self) -> NativeLoop:
        texts = {kind: Path(__file__).with_name(f"driver.{kind}").read_text(encoding="utf-8") for kind in "hc"}
        program = Program("bench_driver", [texts["h"]], [texts["c"]])
        ffi, n = program.ffi, 2 * len(JOINTS)
        self._message = NativeMessage(program, joint_state(names.state_names(JOINTS), (n, n, n)), (n, n, n))
        position = np.array(self.get_parameter("position").value)
        program.lib.fjr_put_numbers(self._message.pointer, 0, ffi.from_buffer("double[]", position))
        self._struct = ffi.new(
            "struct driver*",
            {
                "state": self._message.pointer,
                "period": PERIOD,
                "longest": LONGEST,
                "sides": len(self._sides),
                "block": BLOCK,
                "total": len(self._times),
                "times": ffi.from_buffer("double[]", self._times),
            },
        )
        functions = ("message", "tick", "request", "end")
        driver = {f"on_{name}": ffi.addressof(program.lib, f"driver_{name}") for name in functions}
        loop = NativeLoop(program, {"self": self._struct, **driver}, self._efforts)
        loop.use(self._states)
        self._struct.loop = loop.pointer
        return loop

    def _look(self) -> None:
        connected = all(states.get_subscription_count() for states in self._states)
        if not self._started and connected and all(efforts.publishers for efforts in self._efforts):
            self._started = True
            self._loop.start()
        elif self._started and not self._loop.runs:
            os.kill(os.getpid(), signal.SIGINT)


def rounds(times: NDArray[np.float64], sides: Sequence[str], count: int) -> dict[str, list[list[float]]]:
    """Return the times of each side by round, without the first round; blocks of the sides alternate."""
    blocks = np.reshape(times, (count, BLOCKS, len(sides), BLOCK))
    return {side: blocks[1:, :, k].reshape(count - 1, -1).tolist() for k, side in enumerate(sides)}


if __name__ == "__main__":
    sys.exit(process.run(lambda: Driver("fjr_bench_driver"), sys.argv[1:]))
