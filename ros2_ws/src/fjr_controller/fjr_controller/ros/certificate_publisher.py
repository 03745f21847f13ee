# SPDX-License-Identifier: Apache-2.0
"""Publish the certificate of each sample on ~/certificate, after its command was sent."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from fjr_core import TrackingLaw
from fjr_core.numerics.checks import Array
from fjr_msgs_py import names
from fjr_msgs_py.messages.certificate import CertificateValues, CertificateWriter
from fjr_msgs_py.messages.joint_states import JointSample

from ..tracking.tracker import Command
from .auxiliary_rate import AuxiliaryRate
from .certificate_diagnosis import LONGEST, CertificateDiagnosis

NO_BOUND = -1.0  # J; a storage is never negative


class CertificatePublisher:
    """A listener of the command loop that certifies each sample.

    A sample without a predecessor, or with values that are not finite, has no certificate.
    """

    def __init__(self, node: Node, diagnosis: CertificateDiagnosis, period: float) -> None:
        """Create the publisher; period [s]: between two certificates; 0: one per sample."""
        self._node, self._diagnosis, self._auxiliary = node, diagnosis, AuxiliaryRate(period)
        self._writer = CertificateWriter()
        self._publisher = node.create_publisher(Float64MultiArray, names.CERTIFICATE, names.sample_qos(node))
        self._stamp, self._start, self._bound = 0, -1, NO_BOUND

    def use(self, law: TrackingLaw, limit: Array) -> None:
        """Replace the law by one made by `with_gains`, and the effort limits (n,) [N m]; the bound starts again."""
        self._diagnosis.use(law, limit)
        self._start = -1

    def status(self) -> DiagnosticStatus:
        """Return the diagnosis of the last second."""
        return self._diagnosis.status()

    def on_command(self, sample: JointSample, command: Command, arrival: int, sent: int) -> None:
        """Publish the certificate of a sample.

        arrival, sent [ns]: times of its state and of its command; not used with simulated time.
        """
        online = self._diagnosis.online_certificate
        dt = (sample.stamp - self._stamp) * 1e-9
        follows = not command.restarted and 0 < dt < LONGEST
        if not follows:
            online.skip()
        latency = self._diagnosis.latency(sample.stamp, arrival, sent, follows)
        before, count = online.V, online.count
        online.take(dt, command.position, command.velocity, command.jets, command.u, latency)
        self._stamp = sample.stamp
        rate = (online.V - before) / dt if dt else 0.0
        values = self._values(rate, dt, command.bound_start)
        due = self._auxiliary.due(sample.stamp)
        if online.count == count:
            return
        self._diagnosis.look()
        if due and all(map(math.isfinite, values)):
            self._publisher.publish(self._writer.fill(sample.stamp, values))

    def close(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self._publisher)

    def _values(self, rate: float, dt: float, start: int | None) -> CertificateValues:
        f = self._diagnosis.online_certificate
        if start is None or self._diagnosis.no_diagnosis:
            self._start, self._bound = -1, NO_BOUND
        elif start != self._start:
            self._start, self._bound = start, f.V
        else:
            self._bound *= math.exp(-2 * self._diagnosis.beta * dt)
        return CertificateValues(f.V, f.dV, rate, self._bound, f.H, f.supplied, f.dissipated)
