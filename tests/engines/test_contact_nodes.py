# SPDX-License-Identifier: Apache-2.0
"""Real nodes in lock-step meet a wall: the limits stop the arm, and once the wall is gone it goes on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from engines.test_contact import FRONT
from fjr_controller.controller_node import ControllerNode
from fjr_core.runtime.events import State
from fjr_msgs_py.console.ending import Exit
from fjr_msgs_py.names import WRENCH
from fjr_msgs_py.scenarios import library
from fjr_plant.plant_node import PlantNode
from nodes.harness import Ros
from nodes.managed import Manager
from system.executables import fjr_here
from system.recorded import messages


def test_limits_stop_the_arm_at_a_wall_and_it_goes_on_once_the_wall_is_gone(ros: Ros, tmp_path: Path) -> None:
    given = {"lockstep": True, "start_paused": True, "advance_samples": 1500, "realtime_priority": 0, **FRONT}
    text, scenario = library.as_run(library.find("arm7_contact"), given)
    (tmp_path / "run.yaml").write_text(text)
    file = ["--ros-args", "--params-file", str(tmp_path / "run.yaml")]
    manager = Manager(ros)
    controller = ros.start(ControllerNode, [*file, "-p", "use_sim_time:=true"])
    plant = ros.start(PlantNode, file)
    ros.until(lambda: manager.heard("joint_states") and manager.heard("joint_commands"), "the nodes")

    def present(value: bool) -> tuple[bool, str]:
        asked = [Parameter("obstacle.present", value=value).to_parameter_msg()]
        (result,) = manager.call(SetParameters, "fjr_plant/set_parameters", parameters=asked).results
        return result.successful, result.reason

    assert manager.advance().success
    step = controller._control.step
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


@pytest.mark.system
def test_report_of_a_stop_at_a_wall_says_contact_beside_that_of_the_simulator(tmp_path: Path) -> None:
    changes = [part for name, value in FRONT.items() for part in ("--set", f"{name}:={value}")]
    run = ("run", "arm7_contact", "--lockstep", "--duration", "1.5", "--output", str(tmp_path), *changes)
    said = fjr_here(*run, codes=(Exit.FAILED,))
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
    for each in contact["joints"]:
        assert each["largest_torque_nm"] == pytest.approx(each["simulated_torque_nm"], rel=0.1, abs=1.0)
    assert "in the simulator" in (tmp_path / "arm7_contact" / "report.html").read_text()
