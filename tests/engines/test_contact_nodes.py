# SPDX-License-Identifier: Apache-2.0
"""Real nodes in lock-step meet a wall: the limits stop the arm, and once the wall is gone it goes on."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from engines.test_contact import FRONT
from engines.walls import LOADED, UNLOADED
from fjr_controller.controller_node import ControllerNode
from fjr_core.runtime.events import State
from fjr_core.runtime.safety_settings import REACTIONS, REPORT, STOP, YIELD
from fjr_msgs_py.console.ending import Exit
from fjr_msgs_py.names import WRENCH
from fjr_msgs_py.scenarios import library
from fjr_plant.plant_node import PlantNode
from nodes.harness import Ros
from nodes.managed import Manager
from system.executables import fjr_here, sets
from system.shared_runs import messages


class AtWall(Manager):
    """The nodes of arm7_contact with changed parameters, in lock-step."""

    def __init__(self, ros: Ros, folder: Path, **changes: Any) -> None:
        given = {"lockstep": True, "start_paused": True, "realtime_priority": 0, **changes}
        text, self.scenario = library.as_run(library.find("arm7_contact"), given)
        (folder / "run.yaml").write_text(text)
        file = ["--ros-args", "--params-file", str(folder / "run.yaml")]
        super().__init__(ros)
        self.control = ros.start(ControllerNode, [*file, "-p", "use_sim_time:=true"])._control
        self.plant = ros.start(PlantNode, file)

    def present(self, value: bool) -> tuple[bool, str]:
        """Put the wall there or take it away."""
        asked = [Parameter("obstacle.present", value=value).to_parameter_msg()]
        (result,) = self.call(SetParameters, "fjr_plant/set_parameters", parameters=asked).results
        return result.successful, result.reason


def test_limits_stop_the_arm_at_a_wall_and_it_goes_on_once_the_wall_is_gone(ros: Ros, tmp_path: Path) -> None:
    manager = AtWall(ros, tmp_path, advance_samples=1500, **FRONT)
    scenario, plant, step, present = manager.scenario, manager.plant, manager.control.step, manager.present
    assert manager.advance().success
    assert step.state is State.STOPPED
    assert step.counters["stops"] == 1
    assert present(False) == (True, "")
    assert manager.trigger("resume")[0]
    for _ in range(2):
        assert manager.advance().success
    assert step.state is State.TRACKING
    limit = scenario.robot.limits.effort
    assert all((np.abs(each.effort) <= limit).all() for each in manager.commands)
    q = np.array(manager.states[-1].position[:7])
    np.testing.assert_allclose(q, manager.references[-1].position, atol=5e-3)
    assert present(True) == (True, "")
    assert not plant._robot.contact.any()


@pytest.mark.parametrize("reaction", REACTIONS)
def test_contact_is_reported_and_the_arm_reacts_as_on_contact_says(ros: Ros, tmp_path: Path, reaction: str) -> None:
    manager = AtWall(ros, tmp_path, advance_samples=100, on_contact=reaction)
    step, advanced = manager.control.step, 0
    while step.state is State.WAITING or (not step.counters["contacts"] and advanced < 20):
        assert manager.advance().success
        advanced += 1
    status = manager.control._certificate.status()
    assert "model mismatch" not in status.message
    assert "external torque on joint1" in status.message
    assert step.counters["contacts"] == 1
    if reaction == STOP:
        assert step.state is State.STOPPED
        assert re.match(r"stopped: contact of joint\d: external torque = ", step.reason)
        return
    assert (step.state, step.counters["stops"]) == (State.TRACKING if reaction == REPORT else State.JOINING, 0)
    if reaction == YIELD:
        robot, law, command = manager.scenario.robot, manager.control.step.law, manager.commands[-1]
        state = next(each for each in manager.states if each.header.stamp == command.header.stamp)
        q_l, dq_m = np.array(state.position[:7]), np.array(state.velocity[7:])
        wanted = np.linalg.solve(robot.B_m, robot.grad_P_l(q_l) - law.hold_damping @ dq_m)
        np.testing.assert_allclose(command.effort, wanted, atol=1e-9)
        assert manager.present(False) == (True, "")
        for _ in range(20):
            assert manager.advance().success
        assert step.state is State.TRACKING
        np.testing.assert_allclose(manager.states[-1].position[:7], manager.references[-1].position, atol=5e-3)


@pytest.mark.system
def test_report_of_a_stop_at_a_wall_says_contact_beside_that_of_the_simulator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)  # no picture
    wall = sets(*(f"{name}:={value}" for name, value in FRONT.items()))
    run = ("run", "arm7_contact", "--lockstep", "--duration", "1.2", "--output", str(tmp_path), *wall)
    said = fjr_here(*run, code=Exit.FAILED)
    report = json.loads((tmp_path / "arm7_contact" / "report.json").read_text())
    assert report["status"] == "stopped"
    assert "; contact from 0.8" in report["stop"]["reason"]
    assert report["verdict"]["causes"] == ["external torque"], said
    contact = report["contact"]
    assert f"arm7_contact: contact from {contact['begins_s']:.3g} to {contact['ends_s']:.3g} s" in said
    touched = [message for _, message in messages(tmp_path / "arm7_contact", "/fjr_plant/contact")]
    assert touched[0].name[-6:] == list(WRENCH)
    efforts = np.array([message.effort for message in touched])
    largest = float(np.linalg.norm(efforts[:, 7:10], axis=1).max())
    assert contact["simulated_force_n"] == pytest.approx(largest)
    assert contact["force_n"] == pytest.approx(largest, rel=0.1)
    torque = np.abs(efforts[:, :7]).max(axis=0) / np.abs(efforts[:, :7]).max()
    loaded, felt = ({f"joint{j + 1}" for j in np.flatnonzero(torque >= least)} for least in (LOADED, UNLOADED))
    assert loaded <= {each["joint"] for each in contact["joints"]} <= felt
    for each in contact["joints"]:
        assert each["largest_torque_nm"] == pytest.approx(each["simulated_torque_nm"], rel=0.1, abs=1.0)
    assert "in the simulator" in (tmp_path / "arm7_contact" / "report.html").read_text()
