# SPDX-License-Identifier: Apache-2.0
"""Run a scenario on two nodes and record every topic.

Start in this order: the recorder; the plant, paused; the controller. Beside another run of this machine it does not
start, nor beside other nodes: the graph must show none of these names and no other publisher of states or commands, and
the plant listens for states of its joints before it publishes. Nodes of the run are known by their enclave. The plant
resumes once all are connected. At the end the controller stops first, so that plant and bag get its zero effort.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import rclpy
from rclpy.node import NodeNameNonExistentError
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_srvs.srv import SetBool

from fjr_bringup.clients import RESPONSE_LIMIT, ServiceClient
from fjr_bringup.node_process import NodeError, StartedNode
from fjr_core.config.nodes import CONTROLLER, PLANT
from fjr_core.errors import FjrError
from fjr_core.files.text_file import write_text
from fjr_monitor.recording.bag import header_stamp
from fjr_monitor.recording.recorder import Recorder
from fjr_monitor.recording.run_folder import RunFolder
from fjr_msgs_py import names
from fjr_msgs_py.console.ending import Interrupted
from fjr_msgs_py.console.output import heartbeat, note, phase, progress_bar
from fjr_msgs_py.console.ros2 import discover_quickly
from fjr_msgs_py.node.conflicting_publishers import node_of
from fjr_msgs_py.node.loading import domain
from fjr_msgs_py.node.scheduling import prioritised

STATES = f"/{names.JOINT_STATES}"
EFFORT_COMMANDS, JOINT_COMMANDS = f"/{names.EFFORT_COMMANDS}", f"/{names.JOINT_COMMANDS}"
OBSERVED = (names.REFERENCE, names.TRACKING_ERROR, names.EXTERNAL_TORQUE, names.CERTIFICATE)
SAMPLES = (STATES, EFFORT_COMMANDS, names.CLOCK, *(topic.replace("~", f"/{CONTROLLER}") for topic in OBSERVED))
STARTUP_LIMIT = 120.0  # s for each step of the start; a node that ends is detected at once
SILENCE_LIMIT = 15.0  # s without a new command
CATCH_UP_LIMIT = 5.0  # s for messages that are sent again to the recorder
ENDED = 500_000_000  # ns; a topic that is older than the last command by this has ended, as V of a loop that diverges
POLL = 0.02  # s
PROGRESS = "{desc}: {percentage:3.0f}% |{bar}| {n:.1f}/{total:.1f} s"
GRAPH_PERIOD = 0.5  # s between checks of the graph during the run
NOT_JUDGED = "expected room for the whole bag: what was not recorded is not judged"
ALONE = "expected a domain for this run alone: stop the other, or set the environment variable ROS_DOMAIN_ID (0 to 101)"
DISCOVERY = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER"
UNKNOWN = "an unknown node"
PASSING = 6.0  # s; a second plant or controller is in the graph for less: it refuses to start, or its lease of 5 s ends
RECORDER_PRIORITY = 1  # below the nodes, above other programs: without a core for 0.1 s the recorder loses messages


class RunError(FjrError):
    """A run could not start or could not be finished. kept: its folder if something was recorded."""

    def __init__(self, sentence: str, kept: Path | None = None) -> None:
        super().__init__(sentence)
        self.kept = kept


@dataclass(frozen=True)
class RunPlan:
    """What to run: name, scenario as YAML text, duration [s of stamped time], folder, and whether in lock-step.

    folder: link to the newest run of that name; run() creates a numbered folder and updates the link.
    """

    name: str
    scenario: str
    duration: float
    folder: Path
    lockstep: bool


@contextmanager
def domain_claimed() -> Iterator[None]:
    """Keep the ROS domain for one run of this machine; raise RunError if another has it.

    Two runs that start together would both end: each would see the other's nodes. The name ends with the process.
    """
    with socket.socket(socket.AF_UNIX) as claim:
        try:
            claim.bind(f"\0fjr_run_in_ROS_domain_{int(domain())}")
        except OSError:
            raise RunError(f"another fjr run uses ROS domain {domain()}; {ALONE}") from None
        yield


def run(plan: RunPlan, stop: threading.Event) -> tuple[Path, dict[str, str]]:
    """Run the plan and write bag, scenario and logs into a new folder.

    Return the folder, and the reason for each topic that could not be recorded. Raises FjrError or Interrupted.
    """
    discover_quickly(locally=True)
    with domain_claimed(), RunFolder(plan.folder) as kept:
        plan = replace(plan, folder=kept.path)
        write_text(plan.folder / "scenario.yaml", plan.scenario)
        with Recorder(plan.folder / "bag") as recorder:
            _Run(plan, recorder, stop).execute(on_go=kept.keep)
        if recorder.loss:  # at the last messages, or while the bag was closed
            raise RunError(f"{recorder.loss}; {NOT_JUDGED}\nwhat was recorded is in {plan.folder}", plan.folder)
    return plan.folder, recorder.skipped


class _Run:
    """One run in progress."""

    def __init__(self, plan: RunPlan, recorder: Recorder, stop: threading.Event) -> None:
        self.plan, self.recorder, self.stop = plan, recorder, stop
        self.enclave = f"/fjr_run_{os.getpid()}"
        context = recorder.context
        self.node = rclpy.create_node("fjr_run", context=context, enable_rosout=False, start_parameter_services=False)
        self.client = ServiceClient(self.node, RESPONSE_LIMIT)
        self.pausing = self.node.create_client(SetBool, f"/{PLANT}/pause")
        self.nodes: dict[str, StartedNode] = {}
        self.going = False  # whether the plant was resumed
        self.alone = time.monotonic()  # when no other publisher was in the graph

    def execute(self, on_go: Callable[[], None]) -> None:
        """Start, run and stop the nodes; `on_go` is called when the plant is about to be resumed."""
        try:
            with phase(f"{self.plan.name}: starting the nodes"):
                self._start_nodes()
            on_go()
            self.going = True
            if not self.plan.lockstep:
                note(f"{self.plan.name}: {self.nodes[CONTROLLER].scheduling()}")
            with prioritised(RECORDER_PRIORITY, beside=True):
                self._resume()
                self._follow()
        except FjrError as error:
            kept = f"\nwhat was recorded is in {self.plan.folder}" if self.going else ""
            raise RunError(f"{error}{kept}", self.plan.folder if self.going else None) from None
        finally:  # the controller first; the recorder is still connected
            for name in (CONTROLLER, PLANT):
                if name in self.nodes:
                    self.nodes[name].stop()
            with suppress(Exception):
                self.client.close()
                self.node.destroy_node()

    def _start_nodes(self) -> None:
        """Start plant and controller, and wait until both are connected with each other and with the recorder."""
        self._start(PLANT, "fjr_plant", "plant_node", "-p", "start_paused:=true")
        self._wait_for(PLANT, STATES)
        clock = ("-p", "use_sim_time:=true") if self.plan.lockstep else ()
        # Only now: started earlier, it might answer the states of another robot.
        self._start(CONTROLLER, "fjr_controller", "controller_node", *clock)
        self._wait_for(CONTROLLER, JOINT_COMMANDS)
        commands = JOINT_COMMANDS if self.plan.lockstep else EFFORT_COMMANDS

        def matched() -> bool:
            subscribed = self.recorder.node.get_subscriptions_info_by_topic
            return CONTROLLER in map(_name, subscribed(STATES)) and PLANT in map(_name, subscribed(commands))

        self._wait(matched, "plant and controller to find each other")
        self._wait(lambda: not self._refuse_others(PASSING), "other publishers to leave")
        self._wait(self.pausing.service_is_ready, "the plant's pause service")

    def _start(self, node: str, package: str, name: str, *arguments: str) -> None:
        ros = ["--enclave", self.enclave, "--params-file", str(self.plan.folder / "scenario.yaml"), *arguments]
        self.nodes[node] = StartedNode(package, name, ros, self.plan.folder / f"{name}.log")

    def _wait_for(self, node: str, signature: str) -> None:
        """Wait until the node publishes the topic `signature` and the recorder is connected to all its topics."""

        def unconnected() -> list[str]:
            connected, started = self.recorder.matched, self.nodes
            published = self._published_by(node)
            return [t for t in published if connected(t) < sum(name in started for name in self._publishers(t))]

        def seen() -> str:
            published, silent = (", ".join(each) for each in (self._published_by(node), unconnected()))
            others = ", ".join(sorted(self.recorder.node.get_node_names())) or "none"
            here = "".join(f"; {name} is {os.environ[name]}" for name in DISCOVERY if name in os.environ)
            lacks = f"; it publishes {published}; not connected to {silent or 'none of these'}" if published else ""
            return f"{lacks}; nodes in ROS domain {domain()}: {others}{here}"

        def appeared() -> bool:
            alone = not self._refuse_others(PASSING)  # ended ones stay in the graph for their lease
            return alone and (node, self.enclave) in self._present() and signature in self._published_by(node)

        for condition, what in (
            (appeared, f"{node} to appear"),
            (lambda: not unconnected(), f"the recorder to be connected to {node}"),
            (lambda: self.client.discovered_by(node), f"{node} to discover the recorder"),
        ):
            self._wait(condition, what, seen)

    def _resume(self) -> None:
        """Let the plant run; raises ClientError if it does not respond, RunError if it refuses."""
        answer = self.client.ask(self.pausing, SetBool.Request(data=False))
        if not answer.success:
            raise RunError(f"{self.pausing.srv_name} did not resume the plant: {answer.message}")

    def _published_by(self, node: str) -> list[str]:
        """Return the topics that a node without a namespace publishes; none while it is not in the graph."""
        with suppress(NodeNameNonExistentError):
            return [topic for topic, _ in self.node.get_publisher_names_and_types_by_node(node, "/")]
        return []

    def _present(self) -> list[tuple[str, str]]:
        """Return name and enclave of each node without a namespace."""
        nodes = self.recorder.node.get_node_names_and_namespaces_with_enclaves()
        return [(name, enclave) for name, namespace, enclave in nodes if namespace == "/"]

    def _publishers(self, topic: str) -> list[str]:
        """Return the node of each publisher on a topic."""
        return [_name(info) for info in self.recorder.node.get_publishers_info_by_topic(topic)]

    def _refuse_others(self, lasting: float) -> bool:
        """Return whether there are other nodes (`_others`); raise RunError if there have been for `lasting` [s]."""
        found, now = self._others(), time.monotonic()
        self.alone = self.alone if found else now
        if found and now - self.alone >= lasting:
            raise RunError(f"{found}; {ALONE}")
        return bool(found)

    def _others(self) -> str:
        """Describe another node with a name of this run, or one that publishes states or commands; "" for none.

        Between two messages of discovery a publisher has no node. It may be of this run, until the plant is resumed.
        """
        for topic, owner in ((STATES, PLANT), (EFFORT_COMMANDS, CONTROLLER), (JOINT_COMMANDS, CONTROLLER)):
            publishers = [name for name in self._publishers(topic) if self.going or name != UNKNOWN]
            if owner in self.nodes and owner not in publishers and UNKNOWN in publishers:
                publishers.remove(UNKNOWN)  # a node of this run that was suspended for longer than its lease
            if publishers.count(owner) > (owner in self.nodes) or set(publishers) - {owner}:
                return f"{topic} has other publishers in ROS domain {domain()} ({', '.join(sorted(publishers))})"
        twice = [name for name, enclave in self._present() if name in (PLANT, CONTROLLER) and enclave != self.enclave]
        return f"another node of ROS domain {domain()} is named /{twice[0]}" if twice else ""

    def _follow(self) -> None:
        """Wait until commands for `duration` [s of stamped time] are recorded; raise RunError after SILENCE_LIMIT."""
        name, duration = self.plan.name, self.plan.duration
        line = f"{name}: running for {duration:g} s of stamped time"
        with progress_bar(line, PROGRESS, desc=name, total=duration) as bar:
            beat = heartbeat(lambda: f"{name}: {min(self._elapsed(), duration):.1f} of {duration:g} s")
            with beat if bar.disable else nullcontext():
                last, deadline, look = 0.0, time.monotonic() + SILENCE_LIMIT, 0.0
                while last < duration:
                    self._pause()
                    if time.monotonic() > look:
                        self._refuse_others(PASSING)
                        look = time.monotonic() + GRAPH_PERIOD
                    elapsed = self._elapsed()
                    if elapsed > last:
                        last, deadline = elapsed, time.monotonic() + SILENCE_LIMIT
                        bar.update(min(elapsed, duration) - bar.n)
                    elif time.monotonic() > deadline:
                        raise RunError(f"no command to a new state for {SILENCE_LIMIT:g} s\n{self._logs()}")
                self._catch_up()
        while self._refuse_others(PASSING):  # unless they leave, the bag is not of this run alone
            self._pause()

    def _catch_up(self) -> None:
        """Wait until the recorder has what was sent before the last command on each topic of samples.

        A topic that has ENDED is not waited for: of a loop that diverges no certificate is finite.
        """
        sent, end, deadline = self.recorder.sent, self.recorder.sent(JOINT_COMMANDS), time.monotonic() + CATCH_UP_LIMIT
        while time.monotonic() < deadline:
            if not any(sent(JOINT_COMMANDS) - ENDED < sent(topic) < end for topic in SAMPLES):
                return
            self._pause()

    def _elapsed(self) -> float:
        """Return the stamped time [s] from the first to the latest state with a command."""
        ends = self.recorder.ends(JOINT_COMMANDS)
        return (header_stamp(ends[1]) - header_stamp(ends[0])) * 1e-9 if ends else 0.0

    def _wait(self, condition: Callable[[], bool], what: str, seen: Callable[[], str] = str) -> None:
        """Wait until the condition is true; raise RunError with what is `seen` after STARTUP_LIMIT."""
        deadline = time.monotonic() + STARTUP_LIMIT
        while not condition():
            if time.monotonic() > deadline:
                raise RunError(f"waited {STARTUP_LIMIT:g} s for {what}{seen()}\n{self._logs()}")
            self._pause()

    def _pause(self) -> None:
        """Wait for POLL; raise Interrupted, NodeError or RunError if the run has to end."""
        if self.stop.wait(POLL):
            raise Interrupted(self.plan.folder if self.going else None)
        for node in self.nodes.values():
            try:
                node.check()
            except NodeError:
                self._refuse_others(0.0)  # for which it may have ended
                raise
        if self.recorder.failure:
            raise RunError(f"the recorder failed: {self.recorder.failure}")
        if self.recorder.loss:
            raise RunError(f"{self.recorder.loss}; {NOT_JUDGED}")

    def _logs(self) -> str:
        return "\n".join(f"log of {node.name}:\n{node.last_lines()}" for node in self.nodes.values())


def _name(info: TopicEndpointInfo) -> str:
    """Return the node of an endpoint, as in `left/fjr_plant`; UNKNOWN if it is not known yet."""
    return node_of(info).lstrip("/") or UNKNOWN
