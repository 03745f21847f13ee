# SPDX-License-Identifier: Apache-2.0
"""The layouts for Foxglove and PlotJuggler refer only to topics of a run of the 7-joint arm."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from ament_index_python.packages import get_package_share_directory

from system.recorded import messages
from system.shared_runs import shared_run

pytestmark = pytest.mark.system

CERTIFICATE = "/fjr_controller/certificate"
PATH = re.compile(r"(?P<topic>/[\w/]+)\.(?P<field>\w+)\[(?P<index>\d+)\](?:\.@(?P<function>\w+))?")
FUNCTIONS = {"abs", "log", "log2", "log10", "negative", "deg2rad", "rad2deg"}


Published = dict[str, Any]
"""The last message of each topic of a run."""


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Published:
    return dict(messages(shared_run(tmp_path_factory, "arm7")))


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
    assert len(plots) == 6
    for path in (path["value"] for plot in plots for path in plot["paths"]):
        found = PATH.fullmatch(path)
        assert found, path
        assert found["function"] is None or found["function"] in FUNCTIONS
        check_number(published, found["topic"], found["field"], int(found["index"]))


def check_number(published: Published, topic: str, field: str, index: int) -> None:
    assert isinstance(float(getattr(published[topic], field)[index]), float)  # the topic is there, and the number


def test_foxglove_shows_the_arm_its_health_and_its_events(foxglove: dict[str, Any], published: Published) -> None:
    panels = foxglove["configById"]
    urdf = panels["3D!arm"]["layers"]["urdf"]
    assert published[urdf["topic"]].__msgtype__ == "std_msgs/msg/String"
    assert published[urdf["jointStatesTopic"]].__msgtype__ == "sensor_msgs/msg/JointState"
    robot = ElementTree.fromstring(published[urdf["topic"]].data)
    assert panels["3D!arm"]["followTf"] in {link.get("name") for link in robot.iter("link")}
    moving = {joint.get("name") for joint in robot.iter("joint") if joint.get("type") != "fixed"}
    assert moving <= set(published[urdf["jointStatesTopic"]].name)
    topics = panels["DiagnosticSummary!health"]["topicToRender"], panels["RawMessages!events"]["topicPath"]
    assert published[topics[0]].__msgtype__ == "diagnostic_msgs/msg/DiagnosticArray"
    assert published[topics[1]].__msgtype__ == "diagnostic_msgs/msg/DiagnosticStatus"


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
        message = published[topic]
        assert len(getattr(message, field)) > list(message.name).index(joint)


def test_curve_named_V_in_the_layouts_is_V(foxglove: dict[str, Any], published: Published) -> None:
    labels = [label for part in published[CERTIFICATE].layout.dim for label in part.label.split(",")]
    meant = {"V": "V", "bound": "bound", "measured": "dV_measured", "predicted": "dV_predicted"}
    for plot in ("Plot!storage", "Plot!power"):
        for path in foxglove["configById"][plot]["paths"]:
            assert labels[int(PATH.fullmatch(path["value"])["index"])] == meant[path["label"]]
