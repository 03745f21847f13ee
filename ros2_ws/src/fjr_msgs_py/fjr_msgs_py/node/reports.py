# SPDX-License-Identifier: Apache-2.0
"""What the nodes report: counters on /diagnostics, events, certificates, the diagnosis of the last second, the URDF."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray, String

from ..messages.joint_states import SECOND, MessageError, reason_of, set_nanoseconds
from ..names import DIAGNOSTICS, EVENTS, LATCHED, ROBOT_DESCRIPTION, STEADY, full_name
from ..native.loop import LARGEST
from ..native.program import Program


class CertificateValues(NamedTuple):
    """Storage function and energy at one state.

    V [J]: storage function of the law. dV_predicted [W]: dV/dt of the model under the effort sent.
    dV_measured [W]: mean dV/dt since the last state. bound [J]: continuous-time bound of V, -1 while the law does not
    determine the effort. H [J]: energy of the robot, with dH/dt = supplied - dissipated [W].
    """

    V: float
    dV_predicted: float
    dV_measured: float
    bound: float
    H: float
    supplied: float
    dissipated: float


LABELS = ("sec", "nanosec", *CertificateValues._fields)


def labelled(message: Float64MultiArray) -> dict[str, float]:
    """Return the numbers of an array by label; empty if their labels are incomplete.

    The labels are one per dimension, or separated by commas in a single dimension.
    """
    labels = [dimension.label for dimension in message.layout.dim]
    if len(labels) == 1:
        labels = labels[0].split(",")
    if len(labels) != len(message.data) or not all(labels):
        return {}
    return {label.strip(): float(value) for label, value in zip(labels, message.data, strict=True)}


STAMP = "stamp_ns"
"""Key of the stamp of the sample that an event belongs to."""
LEVELS = {"info": DiagnosticStatus.OK, "warn": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}


class EventWriter:
    """Publisher of events: DiagnosticStatus with level, kind as name, one sentence as message, and values."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(DiagnosticStatus, EVENTS, QoSProfile(depth=100))

    def publish(self, level: str, kind: str, sentence: str, values: Mapping[str, float | str] | None = None) -> None:
        """Publish an event of level info, warn or error."""
        pairs = [KeyValue(key=key, value=str(value)) for key, value in (values or {}).items()]
        self._publisher.publish(DiagnosticStatus(level=LEVELS[level], name=kind, message=sentence, values=pairs))


VERDICT_LEVELS = {
    "holding": DiagnosticStatus.OK,
    "degraded": DiagnosticStatus.WARN,
    "violated": DiagnosticStatus.ERROR,
    "unknown": DiagnosticStatus.OK,
}
"""Level of the status by kind of the diagnosis."""


def diagnosis_status(
    name: str, kind: str, causes: Sequence[str], sentence: str, figures: Mapping[str, float]
) -> DiagnosticStatus:
    """Return the status `name` of a diagnosis of this kind, with its causes and its finite figures."""
    values = {"verdict": kind, "causes": ", ".join(causes)}
    values |= {key: f"{value:.6g}" for key, value in figures.items() if math.isfinite(value)}
    return DiagnosticStatus(
        level=VERDICT_LEVELS[kind],
        name=name,
        message=f"Degraded: {sentence}" if kind == "degraded" else sentence,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def publish_description(node: Node, urdf: str) -> Publisher:
    """Publish the URDF once on robot_description; late subscribers receive it while the publisher exists."""
    publisher = node.create_publisher(String, ROBOT_DESCRIPTION, LATCHED)
    publisher.publish(String(data=urdf))
    return publisher


def refusal(what: str, error: MessageError) -> tuple[str, str]:
    """Return kind and sentence of a rejected message, for Health."""
    return f"{what} refused: {error.kind}", f"{what} refused: {error} (logged once; counted on {DIAGNOSTICS})"


class Refusals:
    """Report the messages that C has refused: each kind once, with the sentence of the Python reader, and how many.

    pointer: struct fjr_refusals*.
    """

    def __init__(
        self, program: Program, what: str, read: Callable[[bytes], object], tell: Callable[[str, str, str], None]
    ) -> None:
        """what: messages; read: reads one and raises MessageError; tell: reports level, kind and sentence."""
        self._ffi, self._lib, self._what, self._read, self._tell = program.ffi, program.lib, what, read, tell
        self._kinds = [""] * len(program.ffi.new("struct fjr_refusals*").count)
        self._first = program.ffi.new("uint8_t[]", len(self._kinds) * LARGEST)
        self.pointer = program.ffi.new("struct fjr_refusals*", {"room": LARGEST, "first": self._first})

    def report(self) -> Counter[str]:
        """Report the kinds that are new; return the numbers by the kind of the first message of each."""
        count, numbers = [self._lib.fjr_refused(self.pointer, k) for k in range(len(self._kinds))], Counter[str]()
        for k in range(len(count)):
            if count[k] and not self._kinds[k]:
                error = reason_of(bytes(self._ffi.buffer(self._first + k * LARGEST, self.pointer.size[k])), self._read)
                self._kinds[k], sentence = refusal(self._what, error)
                self._tell("warn", self._kinds[k], sentence)
            numbers[self._kinds[k]] += count[k]
        return +numbers


class Health:
    """Counters of a node, published once a second and whenever `publish` is called.

    expected: counters of a healthy run. Any other nonzero counter makes the status WARN; a counter of `error` makes
    it ERROR. With use_sim_time the second is measured by the stamps given to `at`, so that reports are repeatable.
    """

    def __init__(self, node: Node, expected: tuple[str, ...], robot: str = "") -> None:
        """Create the publisher. robot: its name; namespace and robot form the hardware_id of every status."""
        self._count: Counter[str] = Counter(dict.fromkeys(expected, 0))
        self._counters: list[Callable[[], Mapping[str, int]]] = []
        self._node = node
        self._hardware = f"{node.get_namespace()}/{robot}".strip("/")
        self._expected = set(expected)
        self._errors: set[str] = set()
        self._values: dict[str, str] = {}
        self._others: list[Callable[[], DiagnosticStatus]] = []
        self._logged: set[str] = set()
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        self._by_stamps = bool(node.get_parameter("use_sim_time").value)
        self._stamp = self._reported = 0
        self._timer = None if self._by_stamps else node.create_timer(1.0, self.publish, clock=STEADY)

    @property
    def count(self) -> Counter[str]:
        """The counters, with the present values of those that are kept elsewhere."""
        for counters in self._counters:
            for key, value in counters().items():
                self._count[key] = value
        return self._count

    def add_counters(self, counters: Callable[[], Mapping[str, int]]) -> None:
        """Report counters that are kept elsewhere; they only grow."""
        self._counters.append(counters)

    def note(self, level: str, kind: str, sentence: str) -> None:
        """Count an event of level info, warn or error, which makes the status ERROR, and `say` it."""
        self.count[kind] += 1
        if level == "error":
            self._errors.add(kind)
        self.say(level, kind, sentence)

    def say(self, level: str, kind: str, sentence: str) -> None:
        """Log a sentence at a level the first time that this kind occurs."""
        if kind not in self._logged:
            self._logged.add(kind)  # first: another thread may say the same while this one logs
            log = self._node.get_logger()  # which lets no line of code have two levels
            if level == "error":
                log.error(sentence)
            elif level == "warn":
                log.warning(sentence)
            else:
                log.info(sentence)

    def value(self, key: str, text: str) -> None:
        """Report a value in addition to the counters, from the next report on."""
        self._values[key] = text

    def add_status(self, status: Callable[[], DiagnosticStatus]) -> None:
        """Publish another status with each report; `status` is called to make it."""
        self._others.append(status)

    def due(self, stamp: int) -> bool:
        """Return True if `at` publishes a report at this stamp [ns]."""
        return self._by_stamps and not 0 <= stamp - self._reported < SECOND  # the period of the reports

    def at(self, stamp: int) -> None:
        """Set the current stamp [ns]; with use_sim_time publish a report once per second of stamps."""
        if self._by_stamps:
            due, self._stamp = self.due(stamp), stamp
            if due:
                self._reported = stamp
                self.publish()

    def close(self) -> None:
        """Destroy timer and publisher."""
        if self._timer:
            self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)

    def publish(self, wrong: str = "") -> None:
        """Publish the counters; wrong: what is wrong at present, which makes the status ERROR."""
        count = dict(self.count)  # a copy: a plant in lock-step may count on its own thread meanwhile
        unwanted = [key for key, value in count.items() if value and key not in self._expected]
        level = DiagnosticStatus.WARN if unwanted else DiagnosticStatus.OK
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if wrong or self._errors & set(unwanted) else level,
            name=full_name(self._node),
            message=", ".join(filter(None, (wrong, *unwanted))) or "ok",
            values=[KeyValue(key=key, value=str(value)) for key, value in count.items()]
            + [KeyValue(key=key, value=text) for key, text in self._values.items()],
        )
        message = DiagnosticArray(status=[status, *(other() for other in self._others)])
        for each in message.status:
            each.hardware_id = self._hardware
        message.header.stamp = self._node.get_clock().now().to_msg()
        if self._by_stamps:
            set_nanoseconds(message.header.stamp, self._stamp)
        self._publisher.publish(message)
