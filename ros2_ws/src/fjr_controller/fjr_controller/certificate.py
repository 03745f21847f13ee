# SPDX-License-Identifier: Apache-2.0
"""The certificate of each sample on ~/certificate, and the diagnosis of the last second on /diagnostics.

The command loop evaluates and publishes the certificates in C (step.h); Python diagnoses its records.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from fjr_core import TrackingLaw
from fjr_core.monitoring.certificate import Certificate, Prediction
from fjr_core.numerics.jit import CLibrary
from fjr_core.robust.options import Robust
from fjr_core.runtime.library import CertificateStruct
from fjr_monitor.diagnosis.online_diagnosis import EffortLimits, Latency, LatestIntervals, OnlineDiagnosis
from fjr_monitor.diagnosis.thresholds import LONGEST_JUDGED, JointTolerances
from fjr_monitor.diagnosis.verdict import EXTERNAL, external, unknown
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr import float_array
from fjr_msgs_py.native.loop import NativeMessage
from fjr_msgs_py.native.program import Program
from fjr_msgs_py.node.reports import LABELS, diagnosis_status

ESTIMATES = "V does not include the disturbance estimate (robust.* is enabled)"
PREDICTS = "the effort is the law's for a predicted state (robust.delay)"
BATCH = 64  # records; fewer than half of those that the diagnosis keeps


class LiveCertificate:
    """The certificate of the running law, its publisher, and the diagnosis of its innovations.

    With robust action there is neither diagnosis nor bound, because V and its rates are those of the law without it.
    pointer: struct fjr_certificate*; message: struct fjr_message* of the certificate, for the command loop.
    """

    def __init__(
        self,
        node: Node,
        program: Program,
        law: TrackingLaw,
        library: CLibrary,
        limits: EffortLimits,
        robust: Robust,
        axes: JointTolerances,
    ) -> None:
        """library: the control step; axes: names and grades of the joints."""
        self._node, self._ffi, self._law = node, program.ffi, law
        self._why_not = ESTIMATES if robust.estimates or robust.integrates else PREDICTS if robust.predicts else ""
        self._simulated = bool(node.get_parameter("use_sim_time").value)
        self._intervals = LatestIntervals(law.robot.n, library)
        self._diagnosis = OnlineDiagnosis(law, limits, self._intervals, axes)
        self._latency, self._name = Latency(), f"{names.full_name(node)}: certificate"
        self.publisher = node.create_publisher(Float64MultiArray, names.CERTIFICATE, names.sample_qos(node))
        self._message = NativeMessage(program, float_array(",".join(LABELS), len(LABELS)))
        certificate, prediction = Certificate(law).function, Prediction(law).function
        functions = {"certify": certificate, "predict": prediction, "law": law.function}
        self._struct = CertificateStruct(program.ffi, functions, law, LONGEST_JUDGED)
        self.pointer, self.message = self._struct.pointer, self._message.pointer
        self.pointer.bounded, self.pointer.beta = not self._why_not, self._rate()
        self.recertify: Callable[[Any, Any], None] = lambda gains, beta: None
        """Let the command loop use another beta, and other gains unless NULL; set by it."""
        self.touched: Callable[[], list[str]] = list
        """Return the joints of a contact in the last second; set by the command loop."""

    def use(self, law: TrackingLaw, limits: EffortLimits) -> None:
        """Replace the law by one made by `with_gains`, and the limits of the effort; the bound starts again."""
        if law is not self._law:
            self._law = law
            self._intervals.forget()
        self._diagnosis.use(law, limits)
        self.restart()

    def restart(self) -> None:
        """Hand gains and beta of the present law to the command loop."""
        self.recertify(self._struct.keep(self._law), self._ffi.new("double*", self._rate()))

    def status(self) -> DiagnosticStatus:
        """Return the diagnosis of the last second; update a beta that depends on the configuration."""
        found: Any = unknown(self._why_not) if self._why_not else self._diagnosis.verdict()
        if joints := self.touched():
            found = external(found)
            found = replace(found, sentence=f"{found.sentence}; {EXTERNAL} on {', '.join(joints)}")
        if self._law.robot.links.M_l_vertices is None:
            self.recertify(self._ffi.NULL, self._ffi.new("double*", self._rate()))
        return diagnosis_status(self._name, found.kind, found.causes, found.sentence, found.figures)

    def on_records(self, records: NDArray[Any]) -> None:
        """Add the certificates of records of the command loop to the diagnosis."""
        for start in range(0, len(records), BATCH):
            batch = records[start : start + BATCH]
            columns = (batch["sample"]["stamp"], batch["arrival"], batch["sent"], batch["certified"]["follows"])
            latency = [self._latency_of(*row) for row in zip(*(each.tolist() for each in columns), strict=True)]
            count = self._intervals.append(batch["certified"], batch["command"], np.array(latency))
            if not self._why_not:
                self._diagnosis.look(self.pointer.beta, count)

    def close(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self.publisher)

    def _latency_of(self, stamp: int, arrival: int, sent: int, follows: int) -> float:
        """Return the latency [s] of a command, 0 if it is not known; follows: the sample has a predecessor."""
        if not follows:
            self._latency.forget()
        return 0.0 if self._simulated or not follows else self._latency.of(stamp, arrival, sent)

    def _rate(self) -> float:
        """Return beta [1/s]: proven if the inertia is known in closed form, else at the present configuration."""
        proven = self._law.robot.links.M_l_vertices is not None
        return self._law.rate(None if proven else self._intervals.position[None, : self._law.robot.n]).beta
