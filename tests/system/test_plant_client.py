# SPDX-License-Identifier: Apache-2.0
"""A run starts the robot only once its nodes have discovered the recorder's subscriptions."""

from __future__ import annotations

import signal

import pytest
import rclpy

from fjr_bringup.runner import plant_client
from fjr_bringup.runner.plant_client import PlantClient
from system.executables import NODES, Executable, wait_for

pytestmark = pytest.mark.system


def test_node_that_stands_still_has_not_discovered_new_subscriptions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plant_client, "RETRY_AFTER", 0.5)
    context = rclpy.Context()
    rclpy.init(context=context)
    client = PlantClient(context, "fjr_plant")
    plant = Executable(*NODES["plant"], "--ros-args", "-p", "start_paused:=true", "-p", "compile:=false")
    try:
        wait_for(lambda: client.discovered_by("fjr_plant"), "the answer of the plant")
        plant.signal(signal.SIGSTOP)
        assert not client.discovered_by("fjr_plant")
        plant.signal(signal.SIGCONT)
        wait_for(lambda: client.discovered_by("fjr_plant"), "the answer of the plant after its pause")
    finally:
        plant.kill()
        client.close()
        context.try_shutdown()


def test_node_that_does_not_exist_has_discovered_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plant_client, "RETRY_AFTER", 0.1)
    context = rclpy.Context()
    rclpy.init(context=context)
    client = PlantClient(context, "fjr_plant")
    assert not client.discovered_by("nobody")
    client.close()
    context.try_shutdown()
