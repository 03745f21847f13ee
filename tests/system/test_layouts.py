# SPDX-License-Identifier: Apache-2.0
"""The layouts for Foxglove and PlotJuggler refer only to topics of a run of the 7-joint arm."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from ament_index_python.packages import get_package_share_directory

from system.recorded import reader
from system.shared_runs import shared_run

pytestmark = pytest.mark.system

CERTIFICATE = "/fjr_controller/certificate"
LABELS = ["sec", "nanosec", "V", "dV_predicted", "dV_measured", "bound", "H", "supplied", "dissipated"]
PATH = re.compile(r"(?P<topic>/[\w/]+)\.(?P<field>\w+)\[(?P<index>\d+)\](?:\.@(?P<function>\w+))?")
FUNCTIONS = {"abs", "log", "log2", "log10", "negative", "deg2rad", "rad2deg"}


@dataclass(frozen=True)
class Published:
    """Topics of a run, with their last messages."""

    topics: dict[str, str]
    last: dict[str, Any]


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Published:
    with reader(shared_run(tmp_path_factory, "arm7")) as bag:
        topics = {connection.topic: connection.msgtype for connection in bag.connections}
        last = {c.topic: bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages()}
    return Published(topics, last)


def config(name: str) -> str:
    return (Path(get_package_share_directory("fjr_bringup")) / "config" / name).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def foxglove() -> dict[str, Any]:
    return json.loads(config("foxglove_layout.json"))


def panels(layout: Any) -> list[str]:
    return [layout] if isinstance(layout, str) else panels(layout["first"]) + panels(layout["second"])


def test_foxglove_contains_each_panel_once(foxglove: dict[str, Any]) -> None:
    assert sorted(panels(foxglove["layout"])) == sorted(foxglove["configById"])


def test_foxglove_plots_numbers_that_are_published(foxglove: dict[str, Any], published: Published) -> None:
    plots = [panel for name, panel in foxglove["configById"].items() if name.startswith("Plot!")]
    assert len(plots) == 5
    for path in (path["value"] for plot in plots for path in plot["paths"]):
        found = PATH.fullmatch(path)
        assert found, path
        assert found["function"] is None or found["function"] in FUNCTIONS
        check_number(published, found["topic"], found["field"], int(found["index"]))


def check_number(published: Published, topic: str, field: str, index: int) -> None:
    if topic == CERTIFICATE and topic not in published.topics:
        assert 2 <= index < len(LABELS)
        return
    assert topic in published.topics
    assert isinstance(float(getattr(published.last[topic], field)[index]), float)


def test_foxglove_shows_the_arm_its_health_and_its_events(foxglove: dict[str, Any], published: Published) -> None:
    panels = foxglove["configById"]
    urdf = panels["3D!arm"]["layers"]["urdf"]
    assert published.topics[urdf["topic"]] == "std_msgs/msg/String"
    assert published.topics[urdf["jointStatesTopic"]] == "sensor_msgs/msg/JointState"
    robot = ElementTree.fromstring(published.last[urdf["topic"]].data)
    assert panels["3D!arm"]["followTf"] in {link.get("name") for link in robot.iter("link")}
    moving = {joint.get("name") for joint in robot.iter("joint") if joint.get("type") != "fixed"}
    assert moving <= set(published.last[urdf["jointStatesTopic"]].name)
    topics = panels["DiagnosticSummary!health"]["topicToRender"], panels["RawMessages!events"]["topicPath"]
    assert published.topics[topics[0]] == "diagnostic_msgs/msg/DiagnosticArray"
    assert published.topics[topics[1]] == "diagnostic_msgs/msg/DiagnosticStatus"


def test_plotjuggler_plots_numbers_that_are_published(published: Published) -> None:
    """PlotJuggler's parsers name curves of joint states by joint and those of arrays by index."""
    curves = [curve.get("name", "") for curve in ElementTree.fromstring(config("plotjuggler_layout.xml")).iter("curve")]
    assert len(curves) > 30
    for curve in curves:
        array = re.fullmatch(r"(/[\w/]+)/data\[(\d+)\]", curve)
        if array:
            check_number(published, array[1], "data", int(array[2]))
            continue
        topic, joint, field = curve.rsplit("/", 2)
        message = published.last[topic]
        assert len(getattr(message, field)) > list(message.name).index(joint)


def test_curve_named_V_in_the_layouts_is_V(foxglove: dict[str, Any], published: Published) -> None:
    if CERTIFICATE not in published.topics:
        pytest.skip("this controller publishes no certificate")
    labels = [label for part in published.last[CERTIFICATE].layout.dim for label in part.label.split(",")]
    meant = {"V": "V", "bound": "bound", "measured": "dV_measured", "predicted": "dV_predicted"}
    for plot in ("Plot!storage", "Plot!power"):
        for path in foxglove["configById"][plot]["paths"]:
            assert labels[int(PATH.fullmatch(path["value"])["index"])] == meant[path["label"]]
