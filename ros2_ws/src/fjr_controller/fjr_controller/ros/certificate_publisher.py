# SPDX-License-Identifier: Apache-2.0
"""Sees every answered state after its effort left: the certificate on ~/certificate, the verdict on /diagnostics."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from fjr_core import TrackingLaw
from fjr_core.control.robust import Robust
from fjr_core.monitoring.diagnosis import Verdict, unknown
from fjr_core.monitoring.grading import Axes
from fjr_core.monitoring.latency import Latency
from fjr_core.monitoring.online_certificate import Forecast
from fjr_core.monitoring.online_diagnosis import RunningVerdict
from fjr_core.monitoring.thresholds import LONGEST_GAP
from fjr_core.numerics.checks import Array
from fjr_msgs_py import names
from fjr_msgs_py.messages.certificate import CertificateValues, CertificateWriter
from fjr_msgs_py.messages.joint_states import JointSample

from ..tracking.tracker import Command, Tracker

LEVELS = {
    "holding": DiagnosticStatus.OK,
    "degraded": DiagnosticStatus.WARN,
    "violated": DiagnosticStatus.ERROR,
    "unknown": DiagnosticStatus.OK,
}
BESIDE = "the law counts on torques beside its model (robust.*), of which the V here knows nothing"
AHEAD = "the effort is the law's for a predicted state (robust.delay)"
NO_BOUND = -1.0  # J; a storage is never negative
LONGEST = LONGEST_GAP * 1e-2  # s between two states, above which they have nothing to do with each other


class Witness:
    """A listener of Answering: publishes a certificate for each state, and keeps what the verdict is drawn from.

    A state without a predecessor has no rate and no certificate; nor has one whose numbers are not finite.
    With robust action there is no verdict and no bound: V and its rates are those of the law without it.
    """

    def __init__(
        self, node: Node, law: TrackingLaw, tracker: Tracker, limit: Array, robust: Robust, axes: Axes
    ) -> None:
        """limit (n,) [N m]: of the efforts. axes: of the joints, as a verdict names and grades them."""
        self._unjudged = BESIDE if robust.estimates or robust.integrates else AHEAD if robust.predicts else ""
        self._node, self._law, self._tracker = node, law, tracker
        self._forecast, self._latency = Forecast(law), Latency()
        self._simulated = bool(node.get_parameter("use_sim_time").value)
        self._running = RunningVerdict(law, limit, self._forecast, axes)
        self._writer = CertificateWriter()
        self._publisher = node.create_publisher(Float64MultiArray, names.CERTIFICATE, names.LATEST)
        self._name = f"{names.full_name(node)}: certificate"
        self._stamp, self._start, self._bound = 0, -1, NO_BOUND
        self._beta = self._rate()

    def use(self, law: TrackingLaw, limit: Array) -> None:
        """Another law, made by `with_gains`, or other limits."""
        if law is not self._law:
            self._law = law
            self._forecast.use(law)
        self._running.use(law, limit)
        self._start, self._beta = -1, self._rate()

    def see(self, sample: JointSample, command: Command, arrival: int, sent: int) -> None:
        """A state and its answer, when it arrived and was sent [ns]; where time is simulated that says nothing."""
        dt = (sample.stamp - self._stamp) * 1e-9
        if command.restarted or not 0 < dt < LONGEST:
            self._forecast.skip()
            self._latency.forget()
            latency = 0.0
        else:
            latency = 0.0 if self._simulated else self._latency.of(sample.stamp, arrival, sent)
        before, count = self._forecast.V, self._forecast.count
        self._forecast.take(dt, command.position, command.velocity, command.jets, command.u, latency)
        self._stamp = sample.stamp
        values = self._values((self._forecast.V - before) / dt if dt else 0.0, dt)
        if self._forecast.count == count:
            return
        if not self._unjudged:
            self._running.look(self._beta)
        if all(map(math.isfinite, values)):
            self._publisher.publish(self._writer.fill(sample.stamp, values))

    def status(self) -> DiagnosticStatus:
        """The verdict on the last second."""
        verdict: Verdict = unknown(self._unjudged) if self._unjudged else self._running.verdict()
        if self._law.robot.links.M_l_vertices is None:
            self._beta = self._rate()
        said = {"verdict": verdict.kind, "causes": ", ".join(verdict.causes)}
        figures = {name: f"{value:.6g}" for name, value in verdict.figures.items() if math.isfinite(value)}
        return DiagnosticStatus(
            level=LEVELS[verdict.kind],
            name=self._name,
            message=f"Degraded: {verdict.sentence}" if verdict.kind == "degraded" else verdict.sentence,
            values=[KeyValue(key=key, value=value) for key, value in (said | figures).items()],
        )

    def close(self) -> None:
        """Publish no more."""
        self._node.destroy_publisher(self._publisher)

    def _values(self, rate: float, dt: float) -> CertificateValues:
        f, certificate = self._forecast, self._tracker.certificate
        if certificate is None or self._unjudged:
            self._start, self._bound = -1, NO_BOUND
        elif certificate.start != self._start:
            self._start, self._bound = certificate.start, f.V
        else:
            self._bound *= math.exp(-2 * self._beta * dt)
        return CertificateValues(f.V, f.dV, rate, self._bound, f.H, f.supplied, f.dissipated)

    def _rate(self) -> float:
        """beta [1/s]: proven where it can be, else that of the present configuration."""
        law = self._law
        known = law.robot.links.M_l_vertices is not None
        return law.rate(None if known else self._forecast.position[None, : law.robot.n]).beta
