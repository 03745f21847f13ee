# SPDX-License-Identifier: Apache-2.0
"""Publish the certificate of each sample on ~/certificate, after its command was sent."""

from __future__ import annotations

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from fjr_core import TrackingLaw
from fjr_core.numerics.checks import Array
from fjr_msgs_py import names
from fjr_msgs_py.messages.certificate import CertificateValues, CertificateWriter
from fjr_msgs_py.messages.joint_states import JointSample

from ..tracking.tracker import Command
from .certificate_diagnosis import CertificateDiagnosis


class CertificatePublisher:
    """A listener of the command loop that certifies each sample.

    A sample without a predecessor, or with values that are not finite, has no certificate.
    """

    def __init__(self, node: Node, diagnosis: CertificateDiagnosis, is_due: Callable[[], bool]) -> None:
        """Create the publisher; is_due: whether the certificate of the present sample is published."""
        self._node, self._diagnosis, self._is_due = node, diagnosis, is_due
        self._writer = CertificateWriter()
        self._publisher = node.create_publisher(Float64MultiArray, names.CERTIFICATE, names.sample_qos(node))
        self._struct = diagnosis.online_certificate.struct.pointer
        self._struct.bounded, self._struct.beta = not diagnosis.no_diagnosis, diagnosis.beta

    def use(self, law: TrackingLaw, limit: Array) -> None:
        """Replace the law by one made by `with_gains`, and the effort limits (n,) [N m]; the bound starts again."""
        self._diagnosis.use(law, limit)
        self._diagnosis.online_certificate.restart()
        self._struct.beta = self._diagnosis.beta

    def status(self) -> DiagnosticStatus:
        """Return the diagnosis of the last second."""
        found = self._diagnosis.status()
        self._struct.beta = self._diagnosis.beta
        return found

    def on_command(self, sample: JointSample, command: Command, arrival: int, sent: int) -> None:
        """Publish the certificate of a sample.

        arrival, sent [ns]: times of its state and of its command; not used with simulated time.
        """
        c, online = command, self._diagnosis.online_certificate
        f = online.certify(sample.stamp, c.position, c.velocity, c.jets, c.u, c.bound_start, c.restarted)
        self._diagnosis.add([(sample.stamp, arrival, sent)], **online.records)
        if f.valid and self._is_due():
            values = CertificateValues(f.V, f.dV, f.rate, f.bound, f.H, f.supplied, f.dissipated)
            self._publisher.publish(self._writer.fill(sample.stamp, values))

    def close(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self._publisher)
