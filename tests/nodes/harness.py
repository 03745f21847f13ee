# SPDX-License-Identifier: Apache-2.0
"""Spin nodes in the test process, with a separate rclpy context, waiting for events instead of sleeping."""

from __future__ import annotations

import gc
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from fjr_controller.controller_node import ControllerNode
from fjr_msgs_py.names import LATEST
from fjr_msgs_py.native.loop import NativeLoop
from fjr_msgs_py.node.participant import stop_discovery
from fjr_msgs_py.node.reports import CertificateValues, labelled
from fjr_plant.plant_node import PlantNode
from time_limits import Limit

try:
    from rclpy.experimental.events_executor import EventsExecutor  # a quarter of the processor time
except ImportError:  # an older rclpy
    EventsExecutor = SingleThreadedExecutor

TIME_LIMIT = 30.0  # s on an idle machine; a longer wait for an event fails the test
PATIENCE = 60.0  # s; a state_timeout that never expires in a test, even on a busy machine


class Ros:
    """A context manager: a context, an executor and the nodes of one test.

    host: parameter `executor` of the nodes, "events" or "native"; a native loop needs a compiled law or plant.
    """

    host = "native"

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(context=self.context)
        self.executor: Executor = EventsExecutor(context=self.context)
        self._nodes: list[Node] = []
        self._closing: list[Callable[[], None]] = []

    def __enter__(self) -> Ros:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def at_close(self, close: Callable[[], None]) -> None:
        """Call `close()` before the nodes are destroyed."""
        self._closing.append(close)

    def add(self, node: Node) -> Any:
        self.executor.add_node(node)
        self._nodes.append(node)
        return node

    def start(self, kind: type[Node], arguments: list[str] | None = None, **parameters: Any) -> Any:
        """Create a node that is connected with the others; parameters by name, with `__` for a dot."""
        overrides = [Parameter(name.replace("__", "."), value=value) for name, value in parameters.items()]
        node = self.add(kind(context=self.context, parameter_overrides=overrides, cli_args=arguments))
        self.meet()
        return node

    def plant(self, **parameters: Any) -> PlantNode:
        given = {"executor": self.host, "compile": self.host == "native"}
        return self._known(PlantNode, **{**given, **parameters})

    def controller(self, **parameters: Any) -> ControllerNode:
        given = {"executor": self.host, "compile": self.host == "native", "auxiliary_rate": 0.0}
        return self._known(ControllerNode, **{**given, "state_timeout": PATIENCE, **parameters})

    def _known(self, kind: type[Node], **parameters: Any) -> Any:
        """Create a node; fail if it does not know a parameter, which it only logs."""
        node = self.start(kind, **parameters)
        unknown = set(node._given) - set(node._parameters_by_name or node._given)
        assert not unknown, f"{node.get_name()} does not know {', '.join(sorted(unknown))}"
        return node

    def meet(self) -> None:
        """Wait until the nodes of this test are connected: publishers with all subscriptions to their topics, and back.

        Of two endpoints of one process either may know the other first; what is sent before both do is lost.
        """
        self.until(self._met, "the connection of all publishers and subscriptions")

    def _met(self) -> bool:
        senders = [each for node in self._nodes for each in node.publishers]
        readers = [each for node in self._nodes for each in subscriptions(node)]
        sent, heard = (Counter(each.topic_name for each in ends) for ends in (senders, readers))
        return all(each.get_subscription_count() >= heard[each.topic_name] for each in senders) and all(
            each.get_publisher_count() >= sent[each.topic_name] for each in readers
        )

    def until(self, happened: Callable[[], Any], what: str = "the event") -> None:
        """Spin until `happened()` is true; fail after the time limit."""
        limit = Limit(TIME_LIMIT)
        while not happened():
            assert not limit.passed(), f"{what} did not come within {TIME_LIMIT} s of a free machine"
            self.executor.spin_once(timeout_sec=0.05)

    def until_said(self, capfd: pytest.CaptureFixture[str], *words: str) -> str:
        """Spin until standard error has these words; return it, with what is said until no event is pending."""
        said = [""]
        self.until(lambda: said.append(capfd.readouterr().err) or all(word in "".join(said) for word in words), "a log")
        self.settle()
        return "".join([*said, capfd.readouterr().err])

    def settle(self, rounds: int = 50) -> None:
        """Spin until no event is pending: `rounds` consecutive waits, each of which may handle one event."""
        for _ in range(rounds):
            self.executor.spin_once(timeout_sec=0.002)

    def close(self) -> None:
        for close in self._closing:
            close()
        for node in self._nodes:
            stop_discovery(node.handle)
        for node in self._nodes:
            node.destroy_node()
        self.executor.shutdown()
        self.context.try_shutdown()
        if participants():
            gc.collect()


def subscriptions(node: Node) -> Iterator[Subscription]:
    """Yield the subscriptions of a node, with those of its native loop and of its inbox, which it does not know."""
    yield from node.subscriptions
    control, base = getattr(node, "_control", None), getattr(node, "_time_base", None)
    host = control._command_loop._host if control else base and base.host
    if isinstance(host, NativeLoop):
        yield from (each._subscription for each in host.subscriptions)
    inbox = control and getattr(control._interface._close_subscription, "__self__", None)
    if inbox:
        yield inbox._subscription


def participants() -> int:
    """Return the number of DDS participants of this process, by their event threads.

    A node in a reference cycle keeps its participant until it is collected. Fast DDS 2.14 delivers discovery messages
    between participants of one process under locks, and two of them may wait for each other forever
    (https://github.com/eProsima/Fast-DDS/issues/6193).
    """
    count = 0
    for path in Path("/proc/self/task").glob("*/comm"):
        with suppress(OSError):  # the thread has ended
            count += path.read_text().startswith("dds.ev")
    return count


class Listener(Node):
    """Store the messages of the nodes under test; publish nothing."""

    def __init__(self, ros: Ros, only: Collection[str] | None = None) -> None:
        """only: topics to subscribe to; all by default. Each topic costs processor time."""
        super().__init__("peer", context=ros.context)
        self._ros = ros
        self.states: list[JointState] = []
        self.efforts: list[Float64MultiArray] = []
        self.commands: list[JointState] = []
        self.references: list[JointState] = []
        self.errors: list[JointState] = []
        self.diagnostics: list[DiagnosticArray] = []
        self._clients_by_name: dict[str, Any] = {}
        heard = {
            "joint_states": (JointState, self.states),
            "effort_controller/commands": (Float64MultiArray, self.efforts),
            "joint_commands": (JointState, self.commands),
            "fjr_controller/reference": (JointState, self.references),
            "fjr_controller/tracking_error": (JointState, self.errors),
            "diagnostics": (DiagnosticArray, self.diagnostics),
        }
        deep = QoSProfile(depth=1000)
        for topic, (kind, keep) in heard.items():
            if only is None or topic in only:
                self.create_subscription(kind, topic, keep.append, deep)
        ros.add(self)

    def request(self, kind: Any, name: str, **fields: Any) -> Future:
        """Call a service without waiting for its response."""
        client = self._clients_by_name.get(name) or self.create_client(kind, name)
        self._clients_by_name[name] = client
        self._ros.until(client.service_is_ready, f"the service {name}")
        return client.call_async(kind.Request(**fields))

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        """Call a service and return its response."""
        future = self.request(kind, name, **fields)
        self._ros.until(future.done, f"the response of {name}")
        return future.result()

    def advance(self) -> Trigger.Response:
        """Let the plant advance by `advance_samples` samples."""
        return self.call(Trigger, "fjr_plant/advance")

    def reset(self) -> None:
        """Return the plant to its initial state."""
        assert self.call(Trigger, "fjr_plant/reset").success

    def pause(self, paused: bool) -> None:
        """Pause or resume the plant."""
        assert self.call(SetBool, "fjr_plant/pause", data=paused).success

    def count(self, key: str, node: str) -> int:
        """Return the latest counter `key` of a node, 0 if it has none yet."""
        for message in reversed(self.diagnostics):
            if message.status[0].name == node:
                return int({value.key: value.value for value in message.status[0].values}.get(key, 0))
        return 0

    def reported(self, node: Node, key: str, count: int = 1) -> None:
        """Stop a node, which then publishes its diagnostics, and wait for its counter `key`."""
        node.stop()
        self._ros.until(lambda: self.count(key, node.get_name()) == count, f"the counter of {key}")


class Peer(Listener):
    """The peer of a node under test: publish messages for a test and store those received."""

    def __init__(self, ros: Ros) -> None:
        super().__init__(ros)
        self.state_publisher = self.create_publisher(JointState, "joint_states", LATEST)
        self.effort_publisher = self.create_publisher(Float64MultiArray, "effort_controller/commands", LATEST)
        self.command_publisher = self.create_publisher(JointState, "joint_commands", LATEST)

    def plant(self, **parameters: Any) -> PlantNode:
        """Start a plant; return it once its states are heard."""
        node = self._ros.plant(**parameters)
        self._ros.until(lambda: self.states, "a state")
        return node

    def started(self, q: Any = 0.5, **parameters: Any) -> ControllerNode:
        """Start a controller; return it once it has answered the first state, at rest at q."""
        node = self.lone_controller(**parameters)
        self.ask(stamped(0.0, q))
        return node

    def lone_controller(self, **parameters: Any) -> ControllerNode:
        """Start a controller; return it once the publishers of earlier tests have left."""
        node = self._ros.controller(**parameters)
        topics = node._control._command_loop._topics
        self._ros.until(lambda: not topics.others_appeared(), "publishers of an earlier test to leave")
        return node

    def ask(self, state: JointState, answered: bool = True) -> JointState | None:
        """Publish a state; return the command for it, or None once it is certain that none follows."""
        before = len(self.commands)
        self.state_publisher.publish(state)
        if answered:
            self._ros.until(lambda: len(self.commands) > before and len(self.errors) == len(self.commands), "an answer")
            return self.commands[-1]
        self._ros.settle()
        assert len(self.commands) == before, f"answered {self.commands[-1]}"
        return None

    def answer(self, state: JointState) -> JointState:
        """Publish a state; return the command with its stamp, even if others arrive in between, e.g. a stop."""
        self.state_publisher.publish(state)
        heard = (self.commands, self.references, self.errors)
        self._ros.until(lambda: all(each and each[-1].header == state.header for each in heard), "the answer")
        return self.commands[-1]


class Stranger:
    """A publisher in a context of its own, which the middleware treats as another process; its node is `other`."""

    def __init__(self, topic: str, message: Any) -> None:
        self._ros, self._message = Ros(), message
        node = self._ros.add(Node("other", context=self._ros.context))
        self.publisher = node.create_publisher(type(message), topic, LATEST)

    @contextmanager
    def talking(self) -> Iterator[None]:
        """Publish the message again and again inside the block."""
        quiet = threading.Event()

        def talk() -> None:
            while not quiet.wait(0.01):
                self.publisher.publish(self._message)

        thread = threading.Thread(target=talk)
        thread.start()
        try:
            yield
        finally:
            quiet.set()
            thread.join()

    def close(self) -> None:
        self._ros.close()


def stamped(t: float, q: Any = 0.5, dq: Any = 0.0, names: list[str] | None = None) -> JointState:
    """Return a JointState of the paper's joint, or of `names`, stamped 100 s + t."""
    names = names or ["joint1", "joint1_motor"]
    message = JointState(name=names)
    nanoseconds = round((100 + t) * 1e9)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanoseconds, 10**9)
    message.position = np.broadcast_to(np.asarray(q, dtype=float), len(names)).tolist()
    message.velocity = np.broadcast_to(np.asarray(dq, dtype=float), len(names)).tolist()
    return message


def seconds(message: JointState) -> float:
    """Return the stamp of a message [s]."""
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


def read_certificate(message: Float64MultiArray) -> tuple[int, CertificateValues]:
    """Stamp [ns] and values of a certificate, by their labels."""
    numbers = labelled(message)
    stamp = round(numbers["sec"]) * 10**9 + round(numbers["nanosec"])
    return stamp, CertificateValues(*(numbers[name] for name in CertificateValues._fields))


def nanoseconds(message: JointState) -> int:
    """Return the stamp of a message [ns]."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
