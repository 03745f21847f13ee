# SPDX-License-Identifier: Apache-2.0
"""The diagnosis of the last second on /diagnostics, from the certificate of each sample."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

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
from fjr_msgs_py.messages.diagnosis import diagnosis_status

ESTIMATES = "V does not include the disturbance estimate (robust.* is enabled)"
PREDICTS = "the effort is the law's for a predicted state (robust.delay)"
LONGEST = LONGEST_GAP * 1e-2  # s; two samples further apart are not compared


class CertificateDiagnosis:
    """Innovations of the running robot and their diagnosis.

    With robust action there is neither diagnosis nor bound, because V and its rates are those of the law without it.
    """

    def __init__(self, node: Node, law: TrackingLaw, limit: Array, robust: Robust, axes: Axes) -> None:
        """limit (n,) [N m]: of the efforts; axes: names and grades of the joints."""
        self.no_diagnosis = ESTIMATES if robust.estimates or robust.integrates else PREDICTS if robust.predicts else ""
        self.law, self.online_certificate = law, OnlineCertificate(law)
        self.simulated = bool(node.get_parameter("use_sim_time").value)
        self._online_diagnosis = OnlineDiagnosis(law, limit, self.online_certificate, axes)
        self._latency, self._name = Latency(), f"{names.full_name(node)}: certificate"
        self.beta = self._rate()

    def use(self, law: TrackingLaw, limit: Array) -> None:
        """Replace the law by one made by `with_gains`, and the effort limits (n,) [N m]."""
        if law is not self.law:
            self.law = law
            self.online_certificate.use(law)
        self._online_diagnosis.use(law, limit)
        self.beta = self._rate()

    def status(self) -> DiagnosticStatus:
        """Return the diagnosis of the last second; update beta."""
        diagnosis: Diagnosis = unknown(self.no_diagnosis) if self.no_diagnosis else self._online_diagnosis.verdict()
        if self.law.robot.links.M_l_vertices is None:
            self.beta = self._rate()
        return diagnosis_status(self._name, diagnosis.kind, diagnosis.causes, diagnosis.sentence, diagnosis.figures)

    def latency(self, stamp: int, arrival: int, sent: int, follows: bool) -> float:
        """Return the latency [s] of a command, 0 if it is not known; follows: the sample has a predecessor."""
        if not follows:
            self._latency.forget()
        return 0.0 if self.simulated or not follows else self._latency.of(stamp, arrival, sent)

    def look(self, count: int = 1) -> None:
        """Process `count` more intervals."""
        if not self.no_diagnosis:
            self._online_diagnosis.look(self.beta, count)

    def _rate(self) -> float:
        """Return beta [1/s]: proven if the inertia is known in closed form, else at the present configuration."""
        law = self.law
        proven = law.robot.links.M_l_vertices is not None
        return law.rate(None if proven else self.online_certificate.position[None, : law.robot.n]).beta
