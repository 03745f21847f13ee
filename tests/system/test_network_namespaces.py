# SPDX-License-Identifier: Apache-2.0
"""Plant and controller on two sides of a network: two namespaces joined by a veth pair."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fjr_bringup.runner import set_ros_environment
from system.executables import NODES, scenario
from system.network import Network, RefusedError, installed
from time_limits import HANG

pytestmark = [pytest.mark.system, pytest.mark.real_time]

SECONDS = 4.0  # of stamped time
AUXILIARY_RATE = 100  # Hz, of the topics for observers in real time
FAULTS = {"delay": 0.001, "loss": 0.05}
SETTLED = 2.0  # s; the initial error of 0.5 rad has decayed by then
WATCH = str(Path(__file__).with_name("watch.py"))


@dataclass(frozen=True)
class Seen:
    """Answered states (k): time (k,) [s], error (k,) [rad]; stamps of all states [ns]; all efforts."""

    time: np.ndarray
    error: np.ndarray
    states: np.ndarray
    efforts: np.ndarray
    packets: int

    @property
    def lost(self) -> float:
        """Return the share of lost states, of one per millisecond."""
        return 1.0 - len(self.states) / (1 + (self.states[-1] - self.states[0]) / 1e6)

    @property
    def worst(self) -> float:
        return float(np.max(self.error[self.time > SETTLED]))


@pytest.fixture
def network(monkeypatch) -> Iterator[Network]:
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", "")
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE")
    set_ros_environment()
    try:
        with Network() as made:
            yield made
    except RefusedError as why:
        pytest.skip(f"no network namespaces here: {why}")


def run(network: Network, **plant: Any) -> Seen:
    """Run plant and watcher on the left and the controller on the right."""
    node = {name: [installed(*NODES[name]), "--ros-args", "--params-file", scenario("paper_k31")] for name in NODES}
    given = [word for name, value in plant.items() for word in ("-p", f"{name.replace('__', '.')}:={value}")]
    watch = network.start(network.left, sys.executable, WATCH, str(SECONDS), out=subprocess.PIPE)
    nodes = [
        network.start(network.left, *node["plant"], *given),
        network.start(network.right, *node["controller"]),
    ]
    said = watch.communicate(timeout=HANG)[0]
    assert watch.returncode == 0, network.words()
    for process in reversed(nodes):
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=HANG) == 0, network.words()
    arrays = {name: np.array(values) for name, values in json.loads(said).items()}
    return Seen(**arrays, packets=min(network.sent(network.left), network.sent(network.right)))


def test_demo_runs_unchanged_between_two_network_namespaces(network: Network) -> None:
    seen = run(network)
    assert len(seen.time) >= 0.5 * SECONDS * AUXILIARY_RATE
    assert np.median(np.diff(seen.states)) == pytest.approx(1e6, rel=0.01)  # 1 kHz
    assert seen.packets >= len(seen.states)  # states and efforts cross the network, not shared memory
    assert np.isfinite(seen.efforts).all()
    assert seen.worst <= 2e-3


def test_tracks_with_loss_and_delay_of_messages_in_the_plant(network: Network) -> None:
    """The plant loses 5 % of states and commands and delays both by 1 ms."""
    sides = {f"imperfections__{side}_{what}": value for side in ("state", "command") for what, value in FAULTS.items()}
    seen = run(network, **sides)
    assert seen.lost >= 0.03
    assert np.isfinite(seen.efforts).all()
    assert seen.worst <= 5e-3


def test_tracks_with_loss_and_delay_of_packets_in_the_network(network: Network) -> None:
    """The kernel loses 5 % of the packets and delays them by 1 ms in both directions."""
    try:
        network.impair("1ms", "5%")
    except RefusedError as why:
        pytest.skip(f"no `tc netem` here: {why}")
    seen = run(network)
    assert np.isfinite(seen.efforts).all()
    assert seen.worst <= 0.05
