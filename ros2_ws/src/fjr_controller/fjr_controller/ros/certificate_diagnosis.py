# SPDX-License-Identifier: Apache-2.0
"""The diagnosis of the last second on /diagnostics, from the certificate of each sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from rclpy.node import Node

from fjr_core import TrackingLaw
from fjr_core.law.robust import Robust
from fjr_core.monitoring.axes import Axes
from fjr_core.numerics.checks import Array
from fjr_core.runtime.library import StepLibrary
from fjr_monitor.diagnosis.diagnosis import Diagnosis, unknown
from fjr_monitor.diagnosis.online_diagnosis import Latency, OnlineCertificate, OnlineDiagnosis
from fjr_msgs_py import names
from fjr_msgs_py.messages.diagnosis import diagnosis_status

ESTIMATES = "V does not include the disturbance estimate (robust.* is enabled)"
PREDICTS = "the effort is the law's for a predicted state (robust.delay)"


class CertificateDiagnosis:
    """Innovations of the running robot and their diagnosis.

    With robust action there is neither diagnosis nor bound, because V and its rates are those of the law without it.
    """

    def __init__(
        self, node: Node, law: TrackingLaw, library: StepLibrary, limit: Array, robust: Robust, axes: Axes
    ) -> None:
        """library: the control step; limit (n,) [N m]: of the efforts; axes: names and grades of the joints."""
        self.no_diagnosis = ESTIMATES if robust.estimates or robust.integrates else PREDICTS if robust.predicts else ""
        self.law, self.online_certificate = law, OnlineCertificate(law, library)
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

    def add(self, times: Sequence[tuple[int, int, int]], certified: NDArray[Any], command: NDArray[Any]) -> None:
        """Add k certified commands, fewer than half of those that are kept.

        times: stamp of the sample, arrival and sending of the command [ns] of each; certified, command (k,): struct
        fjr_certified and fjr_command.
        """
        rows = zip(times, certified["follows"].tolist(), strict=True)
        latency = [self._latency_of(*each, bool(follows)) for each, follows in rows]
        count = self.online_certificate.append(certified, command, np.array(latency))
        if not self.no_diagnosis:
            self._online_diagnosis.look(self.beta, count)

    def _latency_of(self, stamp: int, arrival: int, sent: int, follows: bool) -> float:
        """Return the latency [s] of a command, 0 if it is not known; follows: the sample has a predecessor."""
        if not follows:
            self._latency.forget()
        return 0.0 if self.simulated or not follows else self._latency.of(stamp, arrival, sent)

    def _rate(self) -> float:
        """Return beta [1/s]: proven if the inertia is known in closed form, else at the present configuration."""
        law = self.law
        proven = law.robot.links.M_l_vertices is not None
        return law.rate(None if proven else self.online_certificate.position[None, : law.robot.n]).beta
