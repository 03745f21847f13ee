# SPDX-License-Identifier: Apache-2.0
"""The installed executables: signals, last commands, exit codes, and one sentence instead of a traceback."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_msgs_py.console.ending import Exit
from fjr_msgs_py.names import LATEST
from nodes.harness import Listener, Peer, Ros, stamped
from nodes.test_controller_node import paper_effort
from system.executables import NODES, Executable, scenario, wait_for

pytestmark = pytest.mark.system


@pytest.fixture
def start() -> Iterator[Callable[..., Executable]]:
    started: list[Executable] = []

    def starter(node: str, *arguments: str) -> Executable:
        started.append(Executable(*NODES[node], *arguments))
        return started[-1]

    yield starter
    for executable in started:
        executable.kill()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_the_controller_with_zero_effort_and_exit_code_0(ros: Ros, start, number: int) -> None:
    peer = Peer(ros)
    controller = start("controller")
    peer.meet_controller()
    while not peer.commands:  # the controller first listens for other publishers and does not answer
        peer.state_publisher.publish(stamped(0.0))
        ros.settle(1)
    np.testing.assert_allclose(peer.commands[-1].effort, paper_effort(0.0, 0.5, 0.5), rtol=1e-9)
    controller.signal(number)
    ros.until(lambda: peer.efforts[-1].data[0] == 0.0 and peer.commands[-1].effort[0] == 0.0, "the last effort")
    code, said = controller.end()
    assert code == 0, said
    assert "Traceback" not in said


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("lockstep", ["true", "false"])
def test_a_signal_ends_the_plant_with_code_0(ros: Ros, start, number: int, lockstep: str) -> None:
    peer = Peer(ros)
    plant = start("plant", "--ros-args", "-p", f"lockstep:={lockstep}")
    ros.until(lambda: peer.states, "a state")
    plant.signal(number)
    code, said = plant.end()
    assert code == 0, said
    assert "Traceback" not in said


@pytest.mark.parametrize("node", NODES)
def test_signal_ends_a_node_without_messages(ros: Ros, start, node: str) -> None:
    peer = Peer(ros)
    executable = start(node, "--ros-args", *(("-p", "start_paused:=true") if node == "plant" else ()))
    ros.until(lambda: peer.diagnostics, "its first diagnostics")
    executable.signal(signal.SIGTERM)
    assert executable.end()[0] == 0


@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("name", ["paper_k31", "paper_k3p1"])
def test_runs_with_a_scenario_file_without_a_warning(ros: Ros, start, node: str, name: str) -> None:
    peer = Peer(ros)
    executable = start(node, "--ros-args", "--params-file", scenario(name))
    ros.until(lambda: peer.diagnostics, "its first diagnostics")
    executable.signal(signal.SIGINT)
    code, said = executable.end()
    assert code == 0, said
    assert "unknown parameter" not in said


LOADED = {"python": os.path.realpath(sys.executable), "numpy": "_multiarray_umath", "casadi": "_casadi"}


def has_loaded(executable: Executable, file: str) -> bool:
    """Return whether a file is mapped into the memory of a process, or the process has ended."""
    try:
        return file in Path(f"/proc/{executable.process.pid}/maps").read_text() or executable.process.poll() is not None
    except OSError:
        return executable.process.poll() is not None


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("loaded", LOADED)
@pytest.mark.parametrize("program", ["plant", "controller", "fjr"])
def test_a_signal_while_python_loads_ends_a_program_without_a_traceback(program: str, loaded: str, number: int) -> None:
    """The signal is handled from the first instruction of the interpreter on; before that only `sh` and `env` run."""
    fjr = ("fjr_bringup", "fjr", "check", "paper_k31")
    executable = Executable(*(fjr if program == "fjr" else NODES[program]))
    try:
        wait_for(lambda: has_loaded(executable, LOADED[loaded]), loaded)
        executable.signal(number)
        code, said = executable.end()
    finally:
        executable.kill()
    assert code == (Exit.INTERRUPTED if program == "fjr" else 0), said
    assert "Traceback" not in said


def policies(pid: int) -> set[int]:
    return {os.sched_getscheduler(int(thread)) for thread in os.listdir(f"/proc/{pid}/task")}


@pytest.mark.parametrize("node", NODES)
def test_realtime_priority_applies_to_the_process_or_its_refusal_is_reported(ros: Ros, start, node: str) -> None:
    peer = Peer(ros)
    executable = start(node, "--ros-args", "-p", "realtime_priority:=10")
    ros.until(lambda: peer.diagnostics, "its first diagnostics")
    python, seen = os.sched_getscheduler(executable.process.pid), policies(executable.process.pid)
    executable.signal(signal.SIGTERM)
    said = executable.end()[1]
    assert (os.SCHED_FIFO in seen) != ("realtime_priority 10 is refused" in said)
    assert python != os.SCHED_FIFO


@pytest.mark.parametrize("node", NODES)
def test_scheduling_is_ordinary_by_default(ros: Ros, start, node: str) -> None:
    peer = Peer(ros)
    executable = start(node)
    ros.until(lambda: peer.diagnostics, "its first diagnostics")
    assert policies(executable.process.pid) == {os.SCHED_OTHER, os.SCHED_BATCH}  # the loop, and Python beside it


def test_a_plant_that_diverges_ends_with_one_sentence(ros: Ros, start) -> None:
    peer = Peer(ros)
    plant = start("plant")
    ros.until(lambda: peer.states and peer.effort_publisher.get_subscription_count() >= 2, "a state")

    def ended_by_efforts() -> bool:
        peer.effort_publisher.publish(Float64MultiArray(data=[1e308]))
        return plant.process.poll() is not None

    ros.until(ended_by_efforts, "the end of the plant")
    code, said = plant.end()
    assert code == 1
    ended = [line for line in said.splitlines() if "not finite" in line]
    assert len(ended) == 1, said
    assert ended[0].startswith("ended: the state of the robot is not finite after ")
    assert "Traceback" not in said
    assert "FATAL" not in said
    assert all(np.isfinite(state.position).all() for state in peer.states)


def test_conflict_found_with_the_first_state_ends_the_controller_with_one_sentence(ros: Ros, start) -> None:
    peer = Listener(ros)
    controller = start("controller")
    ros.until(lambda: peer.diagnostics, "its first report: it has looked for others at its start and is active")
    conflict = peer.create_publisher(JointState, "joint_commands", LATEST)
    robot = peer.create_publisher(
        JointState, "joint_states", LATEST
    )  # connected later: the other publisher is known by the first state
    ros.until(lambda: robot.get_subscription_count() >= 2 and conflict.get_subscription_count() >= 2, "the controller")
    for _ in range(100):  # the controller hears the other before the first state, on a busy machine, too
        conflict.publish(JointState(name=["joint1"], effort=[1.0]))
        ros.settle(1)

    def ended_by_both() -> bool:
        conflict.publish(JointState(name=["joint1"], effort=[1.0]))
        robot.publish(stamped(0.0))
        return controller.process.poll() is not None

    ros.until(ended_by_both, "the end of the controller")
    code, said = controller.end()
    assert code == 1
    (ended,) = [line for line in said.splitlines() if line.startswith("ended: ")]
    assert "publishes on /joint_commands; expected nobody else to command the robot" in ended
    assert "Traceback" not in said
    assert "FATAL" not in said
    assert not peer.references, "nothing must be sent"


MIXED = "/**:\n  ros__parameters:\n    robot:\n      joint_stiffness: [1, 2.0]\n"
BAD = {
    "negative stiffness": (["-p", "robot.joint_stiffness:=[-31.0]"], "positive definite"),
    "empty": (["-p", "robot.joint_stiffness:=[]"], "empty list"),
    "mixed list": (["-p", "robot.joint_stiffness:=[1, 2.0]"], "parameter"),
    "missing file": (["--params-file", "/there/is/no/such.yaml"], "/there/is/no/such.yaml"),
    "parameter before the file": (
        ["-p", "realtime_priority:=7", "--params-file", scenario("paper_k31")],
        "argument '-p realtime_priority:=7' has no effect: a parameter file sets realtime_priority to 50",
    ),
    "bad parameter after the file": (
        ["--params-file", scenario("paper_k31"), "-p", "realtime_priority:=-1"],
        "holds -1; expected 0 to 98",
    ),
    "bad node name": (["-r", "__node:=not a name"], "cannot start"),
}


@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("case", BAD)
def test_invalid_input_is_refused_in_one_sentence_without_traceback(start, node: str, case: str) -> None:
    arguments, words = BAD[case]
    code, said = start(node, "--ros-args", *arguments).end()
    assert code == 1
    assert "Traceback" not in said
    assert words in said
    assert "cannot start" in said.splitlines()[-1]


def test_a_mixed_list_in_a_file_is_explained(start, tmp_path: Path) -> None:
    path = tmp_path / "mixed.yaml"
    path.write_text(MIXED)
    code, said = start("plant", "--ros-args", "--params-file", str(path)).end()
    assert code == 1
    assert "Traceback" not in said
    assert "same type" in said
