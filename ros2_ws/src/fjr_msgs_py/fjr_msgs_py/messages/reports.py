# SPDX-License-Identifier: Apache-2.0
"""What the nodes report: certificates, events, the diagnosis of the last second, the robot's description."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray, String

from ..names import EVENTS, LATCHED, ROBOT_DESCRIPTION

SECOND = 1_000_000_000


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
        self._node = node
        self._publisher = node.create_publisher(DiagnosticStatus, EVENTS, QoSProfile(depth=100))

    def publish(self, level: str, kind: str, sentence: str, values: Mapping[str, float | str] | None = None) -> None:
        """Publish an event of level info, warn or error."""
        pairs = [KeyValue(key=key, value=str(value)) for key, value in (values or {}).items()]
        self._publisher.publish(DiagnosticStatus(level=LEVELS[level], name=kind, message=sentence, values=pairs))

    def close(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self._publisher)


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
