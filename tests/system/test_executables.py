# SPDX-License-Identifier: Apache-2.0
"""The installed executables: signals, last commands, exit codes, and one sentence instead of a traceback."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from fjr_msgs_py.console.ending import Exit
from nodes.harness import Peer, Ros, stamped
from nodes.test_controller_node import paper_effort
from system.executables import NODES, Executable, Start, wait_for

pytestmark = pytest.mark.system


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_controller_with_zero_effort_and_exit_code_0(ros: Ros, start: Start, number: int) -> None:
    """SIGHUP comes when the terminal closes, as at the end of an ssh session. Ctrl-C: test_fjr_command.py."""
    peer = Peer(ros)
    controller = start("controller")

    def answered() -> bool:
        """Send the state again: before it knows this peer, and other publishers, the controller does not answer.

        Not before it is there: the peer hears each state itself, and would do nothing but send and hear meanwhile.
        """
        if peer.state_publisher.get_subscription_count() > 1:
            peer.state_publisher.publish(stamped(0.0))
        return bool(peer.commands and peer.efforts)

    ros.until(answered, "an answer")
    np.testing.assert_allclose(peer.commands[-1].effort, paper_effort(0.0, 0.5, 0.5), rtol=1e-9)
    controller.signal(number)
    ros.until(
        lambda: peer.efforts and peer.efforts[-1].data[0] == 0.0 == peer.commands[-1].effort[0], "the last effort"
    )
    ended_by(controller, number)


def ended_by(executable: Executable, number: int) -> str:
    """End a node by a signal; return its output."""
    executable.signal(number)
    code, said = executable.end()
    assert code == 0, said
    assert "Traceback" not in said
    return said


LOADED = {"python": os.path.realpath(sys.executable), "casadi": "_casadi"}
CAUGHT = [
    ("plant", "python", signal.SIGINT),
    ("controller", "casadi", signal.SIGTERM),
    ("fjr", "python", signal.SIGTERM),
    ("fjr", "casadi", signal.SIGINT),
]
"""Program, what it has loaded, signal; the two nodes start alike."""


def has_loaded(executable: Executable, file: str) -> bool:
    """Return whether a file is mapped into the memory of a process, or the process has ended."""
    try:
        return file in Path(f"/proc/{executable.process.pid}/maps").read_text() or executable.process.poll() is not None
    except OSError:
        return executable.process.poll() is not None


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize(("program", "loaded", "number"), CAUGHT)
def test_a_signal_while_python_loads_ends_a_program_without_a_traceback(
    start: Start, program: str, loaded: str, number: int
) -> None:
    """The signal is handled from the first instruction of the interpreter on; before that only `sh` and `env` run."""
    executable = start(program, *(("check", "paper_k31") if program == "fjr" else ()))
    wait_for(lambda: has_loaded(executable, LOADED[loaded]), loaded)
    executable.signal(number)
    code, said = executable.end()
    assert code == (Exit.INTERRUPTED if program == "fjr" else 0), said
    assert "Traceback" not in said


@pytest.mark.parametrize("node", NODES)
def test_a_node_without_messages_has_ordinary_scheduling_no_scipy_and_ends_by_a_signal(
    ros: Ros, start: Start, node: str
) -> None:
    peer = Peer(ros)
    executable = start(node, "--ros-args", *(("-p", "start_paused:=true") if node == "plant" else ()))
    ros.until(lambda: peer.diagnostics, "its first diagnostics")
    process = Path(f"/proc/{executable.process.pid}")
    policies = {os.sched_getscheduler(int(thread.name)) for thread in (process / "task").iterdir()}
    assert policies == {os.SCHED_OTHER, os.SCHED_BATCH}  # the loop, and Python beside it
    assert "/scipy/" not in (process / "maps").read_text()  # it would double the start
    ended_by(executable, signal.SIGTERM if node == "plant" else signal.SIGINT)


MIXED = "/**:\n  ros__parameters:\n    robot:\n      joint_stiffness: [1, 2.0]\n"
BAD = {
    "empty": ("controller", ["-p", "robot.joint_stiffness:=[]"], "empty list"),
    "mixed list": ("plant", ["-p", "robot.joint_stiffness:=[1, 2.0]"], "parameter"),
    "mixed list in a file": ("controller", ["--params-file", "mixed.yaml"], "same type"),
    "missing file": ("plant", ["--params-file", "/there/is/no/such.yaml"], "/there/is/no/such.yaml"),
    "bad node name": ("controller", ["-r", "__node:=not a name"], "cannot start"),
}
"""Node, ROS arguments, sentence: both nodes read their arguments in the same function (process.run)."""


@pytest.mark.parametrize(("node", "arguments", "words"), BAD.values(), ids=BAD)
def test_invalid_input_is_refused_in_one_sentence_without_traceback(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, node: str, arguments: list[str], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mixed.yaml").write_text(MIXED)
    code, said = start(node, "--ros-args", *arguments).end()
    assert code == 1
    assert "Traceback" not in said
    assert words in said
    assert "cannot start" in said.splitlines()[-1]
