# SPDX-License-Identifier: Apache-2.0
"""Publish the certificate of every sample on ~/certificate and the diagnosis of the last second on /diagnostics."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from fjr_core import TrackingLaw
from fjr_core.control.robust import Robust
from fjr_core.monitoring.diagnosis import Diagnosis, unknown
from fjr_core.monitoring.grading import Axes
from fjr_core.monitoring.latency import Latency
from fjr_core.monitoring.online_certificate import OnlineCertificate
from fjr_core.monitoring.online_diagnosis import OnlineDiagnosis
from fjr_core.monitoring.thresholds import LONGEST_GAP
from fjr_core.numerics.checks import Array
from fjr_msgs_py import names
from fjr_msgs_py.messages.certificate import CertificateValues, CertificateWriter
from fjr_msgs_py.messages.diagnosis import diagnosis_status
from fjr_msgs_py.messages.joint_states import JointSample

from ..tracking.tracker import Command, Tracker

ESTIMATES = "V does not include the disturbance estimate (robust.* is enabled)"
PREDICTS = "the effort is the law's for a predicted state (robust.delay)"
NO_BOUND = -1.0  # J; a storage is never negative
LONGEST = LONGEST_GAP * 1e-2  # s; two samples further apart are not compared


class CertificatePublisher:
    """A listener of the command loop that certifies each sample after its command was sent.

    A sample without a predecessor, or with values that are not finite, has no certificate. With robust action there is
    neither diagnosis nor bound, because V and its rates are those of the law without it.
    """

    def __init__(
        self, node: Node, law: TrackingLaw, tracker: Tracker, limit: Array, robust: Robust, axes: Axes
    ) -> None:
        """Create the publisher; limit (n,) [N m]: of the efforts; axes: names and grades of the joints."""
        self._no_diagnosis = ESTIMATES if robust.estimates or robust.integrates else PREDICTS if robust.predicts else ""
        self._node, self._law, self._tracker = node, law, tracker
        self._online_certificate, self._latency = OnlineCertificate(law), Latency()
        self._simulated = bool(node.get_parameter("use_sim_time").value)
        self._online_diagnosis = OnlineDiagnosis(law, limit, self._online_certificate, axes)
        self._writer = CertificateWriter()
        self._publisher = node.create_publisher(Float64MultiArray, names.CERTIFICATE, names.LATEST)
        self._name = f"{names.full_name(node)}: certificate"
        self._stamp, self._start, self._bound = 0, -1, NO_BOUND
        self._beta = self._rate()

    def use(self, law: TrackingLaw, limit: Array) -> None:
        """Replace the law by one made by `with_gains`, and the effort limits (n,) [N m]; the bound starts again."""
        if law is not self._law:
            self._law = law
            self._online_certificate.use(law)
        self._online_diagnosis.use(law, limit)
        self._start, self._beta = -1, self._rate()

    def on_command(self, sample: JointSample, command: Command, arrival: int, sent: int) -> None:
        """Publish the certificate of a sample.

        arrival, sent [ns]: times of its state and of its command; not used with simulated time.
        """
        dt = (sample.stamp - self._stamp) * 1e-9
        if command.restarted or not 0 < dt < LONGEST:
            self._online_certificate.skip()
            self._latency.forget()
            latency = 0.0
        else:
            latency = 0.0 if self._simulated else self._latency.of(sample.stamp, arrival, sent)
        before, count = self._online_certificate.V, self._online_certificate.count
        self._online_certificate.take(dt, command.position, command.velocity, command.jets, command.u, latency)
        self._stamp = sample.stamp
        values = self._values((self._online_certificate.V - before) / dt if dt else 0.0, dt)
        if self._online_certificate.count == count:
            return
        if not self._no_diagnosis:
            self._online_diagnosis.look(self._beta)
        if all(map(math.isfinite, values)):
            self._publisher.publish(self._writer.fill(sample.stamp, values))

    def status(self) -> DiagnosticStatus:
        """Return the diagnosis of the last second."""
        diagnosis: Diagnosis = unknown(self._no_diagnosis) if self._no_diagnosis else self._online_diagnosis.verdict()
        if self._law.robot.links.M_l_vertices is None:
            self._beta = self._rate()
        return diagnosis_status(self._name, diagnosis.kind, diagnosis.causes, diagnosis.sentence, diagnosis.figures)

    def close(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self._publisher)

    def _values(self, rate: float, dt: float) -> CertificateValues:
        f, start = self._online_certificate, self._tracker.bound_start
        if start is None or self._no_diagnosis:
            self._start, self._bound = -1, NO_BOUND
        elif start != self._start:
            self._start, self._bound = start, f.V
        else:
            self._bound *= math.exp(-2 * self._beta * dt)
        return CertificateValues(f.V, f.dV, rate, self._bound, f.H, f.supplied, f.dissipated)

    def _rate(self) -> float:
        """Return beta [1/s]: proven if the inertia is known in closed form, else at the present configuration."""
        law = self._law
        proven = law.robot.links.M_l_vertices is not None
        return law.rate(None if proven else self._online_certificate.position[None, : law.robot.n]).beta
