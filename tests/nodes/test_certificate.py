# SPDX-License-Identifier: Apache-2.0
"""Certificate and external torque of plant and controller in lock-step; each cause injected, its diagnosis heard."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from scipy import signal
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

import fjr_core as fjr
from fjr_core.monitoring.certificate import Certificate
from fjr_msgs_py.node.reports import LABELS, CertificateValues
from nodes.harness import Listener, Ros, nanoseconds, read_certificate

STATUS = "fjr_controller: certificate"
LAW = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS)


class Hearer(Listener):
    """A listener to the diagnostics, with certificates to all topics."""

    def __init__(self, ros: Ros, certificates: bool = False) -> None:
        super().__init__(ros, only=None if certificates else ("diagnostics",))
        self.certificates: list[Float64MultiArray] = []
        if certificates:
            self.create_subscription(Float64MultiArray, "fjr_controller/certificate", self.certificates.append, 1000)

    def statuses(self) -> list[DiagnosticStatus]:
        """Return the diagnoses."""
        return [status for message in self.diagnostics for status in message.status if status.name == STATUS]

    def verdicts(self) -> list[tuple[str, str]]:
        """Return (kind, causes) of each diagnosis."""
        values = [{value.key: value.value for value in status.values} for status in self.statuses()]
        return [(value["verdict"], value["causes"]) for value in values]


def running(
    ros: Ros, seconds: int, plant: dict[str, Any], controller: dict[str, Any], certificates: bool = False
) -> Hearer:
    """Run the paper's joint in lock-step until that many diagnoses were published."""
    hearer = Hearer(ros, certificates)
    ros.controller(use_sim_time=True, **controller)
    ros.plant(lockstep=True, initial_link_position=[0.5], initial_motor_position=[0.5], **plant)
    ros.until(lambda: len(hearer.verdicts()) > seconds, f"{seconds} verdicts")
    return hearer


def test_each_state_of_a_healthy_loop_has_its_certificate_and_the_law_holds(ros: Ros) -> None:
    hearer = running(ros, 2, {}, {}, certificates=True)
    assert hearer.verdicts()[1:] == [("holding", "")] * len(hearer.verdicts()[1:])
    assert hearer.statuses()[-1].level == DiagnosticStatus.OK
    assert hearer.certificates[0].layout.dim[0].label.split(",") == list(LABELS)
    ros.until(lambda: len(hearer.certificates) > 300)
    answered = {nanoseconds(command): command.effort[0] for command in hearer.commands}
    states = {nanoseconds(state): state for state in hearer.states}
    seen = dict(read_certificate(message) for message in hearer.certificates)
    stamps = sorted(set(seen) & set(states) & set(answered))[:50]
    jets = fjr.Sine(1.0, 1.0).jets(1e-9 * (np.array(stamps) - min(answered)))
    position, velocity = ([getattr(states[stamp], name) for stamp in stamps] for name in ("position", "velocity"))
    wanted = Certificate(LAW).along(position, velocity, jets, [[answered[stamp]] for stamp in stamps])
    found = CertificateValues(*np.array([seen[stamp] for stamp in stamps]).T)
    for name in ("V", "H", "supplied", "dissipated"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-9, err_msg=name)
    np.testing.assert_allclose(found.dV_predicted, wanted.dV, rtol=1e-8)
    assert np.all(found.bound * (1 + 1e-9) >= found.V)
    one, other = sorted(set(seen))[10:12]
    rate = (seen[other].V - seen[one].V) / ((other - one) * 1e-9)
    assert seen[other].dV_measured == pytest.approx(rate, rel=1e-9)


@pytest.mark.parametrize(
    ("grade", "cause", "plant", "controller"),
    [
        ("degraded", "model mismatch", {"imperfections__motor_coulomb_friction": [0.01]}, {}),
        ("violated", "delay", {"imperfections__state_delay": 0.002}, {"certificate_tolerance": [1e-6]}),
    ],
)
def test_a_cause_is_graded_on_the_diagnostics(ros: Ros, grade: str, cause: str, plant: Any, controller: Any) -> None:
    hearer = running(ros, 2, plant, controller)
    assert hearer.verdicts()[-1] == (grade, cause)
    level, message = hearer.statuses()[-1].level, hearer.statuses()[-1].message
    assert level == {"degraded": DiagnosticStatus.WARN, "violated": DiagnosticStatus.ERROR}[grade]
    assert f"{cause} makes " in message
    assert " mrad at joint1" in message
    assert message.startswith("Degraded: ") == (grade == "degraded")


def test_saturation_is_diagnosed_while_it_lasts(ros: Ros) -> None:
    hearer = running(ros, 2, {}, {"limits__effort": [0.6]})
    assert ("violated", "saturation") in hearer.verdicts()


@pytest.mark.parametrize(
    ("robust", "sentence"),
    [
        ({"robust__residual_gain": [60.0]}, "V does not include the disturbance estimate (robust.*"),
        ({"robust__delay": 0.001}, "no diagnosis: the effort is the law's for a predicted state (robust.delay)"),
    ],
    ids=["estimate", "prediction"],
)
def test_robust_action_has_no_diagnosis_but_a_storage_with_rates(ros: Ros, robust, sentence: str) -> None:
    hearer = running(ros, 1, {}, robust, certificates=True)
    assert {verdict for verdict, _ in hearer.verdicts()} == {"unknown"}
    assert sentence in hearer.statuses()[-1].message
    _, values = read_certificate(hearer.certificates[-1])
    assert np.isfinite(values).all()
    assert values.bound == -1


def test_the_certificate_can_be_disabled(ros: Ros) -> None:
    assert ros.controller(certificate=False).count_publishers("fjr_controller/certificate") == 0


# The torque that is sent to the plant's ~/external_torque is published through a low-pass.


STEP = 0.3  # N m
L = 30.0  # 1/s
SAMPLES = 500
OBSERVED = {"measurement__velocity": "observer", "measurement__observer_bandwidth": 200.0}


@pytest.mark.parametrize(
    ("more", "poles", "tolerance"),
    [({}, [-L], 1e-3), ({"compile": False}, [-L], 1e-3), (OBSERVED, [-L, -200.0, -200.0], 0.07)],
    ids=["measured", "in Python", "observed"],
)
def test_torque_on_the_plant_is_published_through_the_low_pass(
    ros: Ros, more: dict[str, Any], poles: list[float], tolerance: float
) -> None:
    """With estimated velocities also through their observer; damping times their error, 0.2 / 0.031 * 2 / 200, adds."""
    peer, found = Listener(ros, only=()), []
    peer.create_subscription(JointState, "fjr_controller/external_torque", found.append, 1000)
    publisher = peer.create_publisher(JointState, "fjr_plant/external_torque", 1)
    ros.controller(use_sim_time=True, external_torque_bandwidth=L, **more)
    start = {"initial_link_position": [0.5], "initial_motor_position": [0.5]}
    node = ros.plant(lockstep=True, start_paused=True, advance_samples=SAMPLES, **start)

    def advanced(to: int) -> np.ndarray:
        """Advance the plant; return the estimates at the present state, which it repeats, and at the next SAMPLES."""
        assert peer.advance().success
        ros.until(lambda: found and nanoseconds(found[-1]) == 10**9 + to * 10**6, "the estimates")
        return np.array([message.effort[0] for message in found[-SAMPLES - 1 :]])

    assert np.abs(advanced(SAMPLES)[-100:]).max() < tolerance * STEP
    assert nanoseconds(found[0]) == 10**9 + (5_000_000 if more is OBSERVED else 0)  # until the velocities have settled
    publisher.publish(JointState(name=["joint1"], effort=[STEP]))
    ros.until(lambda: node._health.count["external torques received"] == 1)
    t = np.arange(SAMPLES + 1) * 1e-3
    wanted = STEP * signal.step(signal.ZerosPolesGain([], poles, np.prod(np.negative(poles))), T=t)[1]
    assert advanced(2 * SAMPLES) == pytest.approx(wanted, abs=tolerance * STEP)
    assert {tuple(message.name) for message in found} == {("joint1",)}
