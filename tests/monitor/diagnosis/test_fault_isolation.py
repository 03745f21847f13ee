# SPDX-License-Identifier: Apache-2.0
"""A finding names kind, joint, side and size of what is wrong; body torques against an independent payload."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.model.rigid_arm import PayloadArm
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import Finding
from fjr_monitor.diagnosis.diagnosis import diagnose, innovations
from fjr_monitor.diagnosis.fault_isolation import velocity_faults
from fjr_monitor.diagnosis.hypotheses import SECOND_MOMENTS, Hypothesis, body_torques
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.diagnosis.residuals import Residuals, residuals
from fjr_monitor.diagnosis.thresholds import JointTolerances
from fjr_monitor.diagnosis.torque_faults import UNKNOWN, FittedFault, torque_fault, unexplained
from fjr_monitor.diagnosis.verdict import EXTERNAL, Diagnosis
from monitor.diagnosis.loops import PERIOD, Sensed, record_in_real_time, recorded
from system.test_other_joints import URDF

DURATION = 1.5
MODEL = fjr.planar_two_link()
NAMES = ("shoulder", "elbow")
AXES = replace(JointTolerances.plain(2), names=NAMES)


SWING = fjr.Sine([0.5, 0.7], [2.0, 3.0], [0.3, 0.0])


@cache
def law() -> fjr.TrackingLaw:
    return fjr.TrackingLaw(MODEL, fjr.synthesize(MODEL, 8.0, PERIOD), compile=True)


def record(robot: fjr.Robot = MODEL, **faults: Any) -> Record:
    """Run the loop with another robot than the model, or with faults of sensors or efforts (loops.recorded)."""
    return recorded(law(), SWING, np.zeros(8), round(DURATION / PERIOD), robot, **faults)


@cache
def healthy() -> Record:
    return record()


def verdict(robot: fjr.Robot = MODEL, **faults: Any) -> Diagnosis:
    return diagnose(record(robot, **faults), law(), axes=AXES)


def test_healthy_run_has_no_finding() -> None:
    assert diagnose(healthy(), law(), axes=AXES).findings == ()


def test_holding_names_no_torque_that_nothing_explains(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = Finding(UNKNOWN, "", "", 0.0, "", 0.0, "no single fault explains the torque")
    monkeypatch.setattr("fjr_monitor.diagnosis.diagnosis.isolate", lambda *_: (nothing,))
    holding = diagnose(healthy(), law(), axes=AXES)
    assert holding.kind == "holding"
    assert holding.findings == ()
    assert nothing.sentence not in holding.sentence


@pytest.mark.parametrize(
    ("robot", "kind", "joint", "side", "size", "unit"),
    [
        ({"stiffness": (40.0, 22.0)}, "stiffness", "elbow", "joint", -12.0, "%"),
        ({"motor_inertia": (0.024, 0.01)}, "inertia", "shoulder", "motor", 0.004, "kg m^2"),
        ({"link_inertia": (0.010, 0.008)}, "inertia", "elbow", "link", 0.003, "kg m^2"),
        ({"link_damping": (0.2, 0.16)}, "viscous friction", "elbow", "link", 0.06, "N m s/rad"),
        ({"motor_damping": (0.05, 0.01)}, "viscous friction", "shoulder", "motor", 0.03, "N m s/rad"),
        ({"input_gain": (1.0, 0.9)}, "torque constant", "elbow", "motor", -10.0, "%"),
    ],
)
def test_wrong_parameter_is_isolated_with_its_size(
    robot: dict[str, tuple[float, float]], kind: str, joint: str, side: str, size: float, unit: str
) -> None:
    found = verdict(fjr.planar_two_link(**robot))
    (finding,) = found.findings
    assert (finding.kind, finding.joint, finding.side, finding.unit) == (kind, joint, side, unit)
    assert finding.size == pytest.approx(size, rel=0.05)
    assert finding.share > 0.9
    assert finding.sentence in found.sentence


@pytest.mark.parametrize("factors", [(0.9, 1.0), (1.0, 0.97)])
def test_by_its_measured_torque_a_weak_motor_is_no_delay(factors: tuple[float, float]) -> None:
    """The torque is a share of the command: what is missing acts neither late nor was it lost."""
    seen = record(acting=lambda u: u * factors)
    applied = np.vstack([np.zeros((1, 2)), seen.u[:-1]]) * factors
    found = diagnose(replace(seen, u_applied=applied), law(), axes=AXES)
    (finding,) = found.findings
    assert (finding.kind, finding.side) == ("torque constant", "motor")
    assert found.causes[0] == "model mismatch"
    assert not {"delay", "loss"} & {*found.causes}
    assert finding.size == pytest.approx(100 * (min(factors) - 1), rel=0.05)


@pytest.mark.parametrize(
    ("robot", "kind", "side", "sizes"),
    [
        ({"stiffness": (34.0, 20.0)}, "stiffness", "joint", (-15.0, -20.0)),
        ({"motor_inertia": (0.026, 0.015)}, "inertia", "motor", (0.006, 0.005)),
        ({"input_gain": (0.9, 0.85)}, "torque constant", "motor", (-10.0, -15.0)),
        ({"motor_damping": (0.04, 0.03)}, "viscous friction", "motor", (0.02, 0.02)),
    ],
)
def test_a_parameter_that_is_wrong_at_all_joints_is_one_fault(
    robot: dict[str, tuple[float, float]], kind: str, side: str, sizes: tuple[float, float]
) -> None:
    (finding,) = verdict(fjr.planar_two_link(**robot)).findings
    assert (finding.kind, finding.joint, finding.side) == (kind, "", side), finding.sentence
    assert finding.size == pytest.approx(max(sizes, key=abs), rel=0.05)
    said = finding.sentence.partition("(")[2].partition(")")[0]
    assert np.array(said.split(", "), dtype=float) == pytest.approx(np.array(sizes), rel=0.05)
    assert list(finding.sizes) == [kind]
    assert finding.sizes[kind] == pytest.approx(sizes, rel=0.05)


def rubbing(coulomb: Sequence[float], viscous: float = 0.0, robot: fjr.Robot = MODEL) -> tuple[Finding, ...]:
    """Return what is found where the motors rub, by another curve than that of the hypothesis."""
    last = np.zeros(2)

    def sensed(q: Array, dq: Array) -> tuple[Array, Array]:
        last[:] = dq[2:]
        return q, dq

    def acting(u: Array) -> Array:
        return u - coulomb * np.clip(last / 0.02, -1, 1) - viscous * last

    return verdict(robot, sensed=sensed, acting=acting).findings


@pytest.mark.parametrize(("coulomb", "viscous"), [((0.08, 0.05), 0.0), ((0.08, 0.05), 0.02), ((0.08, 0.0), 0.02)])
def test_friction_of_all_motors_is_one_fault(coulomb: tuple[float, float], viscous: float) -> None:
    (finding,) = rubbing(coulomb, viscous)
    assert (finding.kind, finding.joint) == ("friction" if viscous else "Coulomb friction", ""), finding.sentence
    assert finding.sizes["Coulomb friction"] == pytest.approx(coulomb, rel=0.15, abs=2e-3)
    assert not viscous or finding.sizes["viscous friction"] == pytest.approx((viscous, viscous), rel=0.15)
    assert finding.sentence.startswith("all motors: ")
    assert finding.size == pytest.approx(0.08, rel=0.1)


@pytest.mark.parametrize(
    ("robot", "kind", "joint", "size"),
    [
        ({"link_mass": (1.2, 0.84)}, "gravity load", "elbow", 0.13),  # 0.04 kg, 0.34 m from the shoulder
        ({"stiffness": (38.0, 25.0)}, "stiffness", "shoulder", -5.0),
        ({"input_gain": (0.96, 1.0)}, "torque constant", "shoulder", -4.0),
    ],
)
def test_another_fault_is_named_beside_friction_of_all_motors(
    robot: dict[str, tuple[float, float]], kind: str, joint: str, size: float
) -> None:
    friction, other = rubbing((0.08, 0.05), robot=fjr.planar_two_link(**robot))
    assert (friction.joint, friction.side) == ("", "motor")
    assert friction.size == pytest.approx(0.08, rel=0.1)
    assert (other.kind, other.joint) == (kind, joint), other.sentence
    assert other.size == pytest.approx(size, rel=0.15)


@pytest.mark.parametrize("alone", [True, False], ids=["diagonal alone", "row and column"])
def test_a_softer_joint_of_a_coupled_stiffness_has_its_size(alone: bool) -> None:
    stiff = np.array([[40.0, 12.0], [12.0, 25.0]])
    softer = stiff * (np.array([[1.0, 1.0], [1.0, 0.88]]) if alone else np.array([[1.0, 0.88], [0.88, 0.88]]))
    model, real = (fjr.planar_two_link(stiffness=K) for K in (stiff, softer))
    law = fjr.TrackingLaw(model, fjr.synthesize(model, 8.0, PERIOD))
    reference = fjr.Sine([0.5, 0.7], [2.0, 3.0], [0.3, 0.0])
    seen = recorded(law, reference, np.zeros(8), round(DURATION / PERIOD), real)
    (finding,) = diagnose(seen, law, axes=AXES).findings
    assert (finding.kind, finding.joint) == ("stiffness", "elbow")
    assert finding.size == pytest.approx(-12.0, rel=0.05)


SOFT = fjr.TrackingLaw(fjr.single_link(stiffness=3.1), fjr.PAPER_GAINS, compile=True)
BURSTS = {*range(4, 7), 8, 9, *range(11, 15), 30, 31, *range(1000, 1030, 3), *range(2000, 2010)}


def late_computer(lost: Collection[int], seed: int | None, **robot: float) -> Diagnosis:
    """Diagnose the soft joint in real time; seed: of the instants at which efforts begin, None: always the same."""
    draw, start = np.random.default_rng(seed), SOFT.robot.state(0.5, 0.5, 0.0, 0.0)
    begins = (lambda k: 2) if seed is None else lambda k: int(draw.choice([1, 2] if k > 40 else [2, 3]))
    real = fjr.single_link(stiffness=3.1, **robot)
    seen = record_in_real_time(SOFT, fjr.Sine(1.0, 1.0), start, 3000, real, lost=lost, begins=begins)
    return diagnose(seen, SOFT)


LATE = [(set(), 1), ({5}, None), ({*range(3, 12)}, 2), (BURSTS, 3), (BURSTS, None), ({*range(2, 3000, 7)}, 4)]


@pytest.mark.parametrize(("lost", "seed"), LATE, ids=["none", "one", "at the start", "bursts", "regular", "many"])
def test_a_late_computer_is_no_fault_of_the_robot(lost: Collection[int], seed: int | None) -> None:
    """The effort falls by 36 N m in a sample at the start; no send time reveals when the robot takes it over."""
    verdict = late_computer(lost, seed)
    assert verdict.findings == (), verdict.sentence
    assert "model mismatch" not in verdict.causes


@pytest.mark.parametrize(("lost", "seed"), [(set(), None), (set(), 1), (BURSTS, 3)])
@pytest.mark.parametrize("friction", [-2.6e-3, 10e-3])
def test_a_fault_is_named_beside_a_late_computer(lost: Collection[int], seed: int | None, friction: float) -> None:
    """The transient does not reveal the smaller friction: a shift of the efforts by 17 us leaves the same residual."""
    (finding,) = late_computer(lost, seed, motor_damping=7e-3 + friction).findings
    assert (finding.kind, finding.side) == ("viscous friction", "motor")
    assert finding.size == pytest.approx(friction, rel=0.05)


@pytest.mark.parametrize(("change", "named"), [(0.05, True), (-0.05, False)])
def test_friction_that_would_add_energy_is_not_named(change: float, named: bool) -> None:
    """The motors of the model have a damping of 0.01 N m s/rad."""
    seen = healthy()
    u = seen.u + change * seen.velocity[:, 2:] * [1.0, 0.0]
    kinds = [finding.kind for finding in diagnose(replace(seen, u=u), law(), axes=AXES).findings]
    assert ("viscous friction" in kinds) is named


def test_spring_that_hardens_has_its_cubic_stiffness() -> None:
    (finding,) = verdict(replace(MODEL, cubic=(2e3, 0.0))).findings
    assert (finding.kind, finding.joint, finding.unit) == ("cubic stiffness", "shoulder", "N m/rad^3")
    assert finding.size == pytest.approx(2e3, rel=0.05)


@cache
def lift(forearm: float = 1.0, **changed: Any) -> fjr.Robot:
    """An elbow on a lift, a revolute joint on a prismatic one."""
    urdf = URDF.replace('<mass value="1.0"/>', f'<mass value="{forearm}"/>')
    return fjr.robot_from_urdf(urdf, ["lift", "elbow"], [4e4, 300.0], [3.0, 0.05], **changed)


def of_lift(**fault: Any) -> Finding:
    """Return what is found in a loop with the lift and a fault."""
    law = fjr.TrackingLaw(lift(), fjr.synthesize(lift(), 6.0, PERIOD), compile=True)
    start = lift().state(0.0, np.linalg.solve(lift().K, lift().grad_P_l(np.zeros(2))), [0.15, 1.2], [0.15, 1.2])
    seen = recorded(law, fjr.Sine([0.05, 0.4], [3.0, 3.0]), start, round(DURATION / PERIOD), **fault)
    (finding,) = diagnose(seen, law, axes=replace(JointTolerances.plain(2), names=("lift", "elbow"))).findings
    return finding


@pytest.mark.parametrize(
    ("fault", "kind", "joint", "size", "unit"),
    [
        ({"acting": lambda u: u + [5.0, 0.0]}, "constant torque", "lift", 5.0, "N"),
        ({"robot": lift(motor_damping=(30.0, 0.0))}, "viscous friction", "lift", 30.0, "N s/m"),
        ({"robot": lift(motor_damping=(0.0, 0.3))}, "viscous friction", "elbow", 0.3, "N m s/rad"),
        ({"robot": lift(forearm=1.5)}, "gravity load", "elbow", 0.5 * 9.81, "N"),  # of which the lift carries most
        ({"robot": lift(), "sensed": lambda q, dq: (q + [2e-4, 0, 0, 0], dq)}, "position offset", "lift", 2e-4, "m"),
    ],
)
def test_a_fault_of_an_arm_with_a_prismatic_joint_has_the_unit_of_its_joint(
    fault: dict[str, Any], kind: str, joint: str, size: float, unit: str
) -> None:
    finding = of_lift(**fault)
    kinds = finding.kind.split(" or ")
    assert (kind in kinds, finding.joint, finding.unit) == (True, joint, unit), finding.sentence
    # An offset of the link of a lift is the opposite one of its motor: the weight is the same everywhere.
    assert kind != kinds[0] or abs(finding.size) == pytest.approx(size, rel=0.05)
    assert "eccentricity" not in finding.sentence


def test_wrong_mass_is_a_gravity_load_on_its_link() -> None:
    """Its size is the largest change of weight at any joint, here the shoulder."""
    heavier = fjr.planar_two_link(link_mass=(1.2, 0.9))
    (finding,) = verdict(heavier).findings
    assert (finding.kind, finding.joint, finding.side, finding.unit) == ("gravity load", "elbow", "link", "N m")
    q = ca.SX.sym("q", 2)
    weight = ca.Function("weight", [q], [heavier.links.grad_P_l(q) - MODEL.links.grad_P_l(q)])
    largest = np.abs(weight(record(heavier).position[:, :2].T).full()).max()
    assert finding.size == pytest.approx(largest, rel=0.05)


@pytest.mark.parametrize("angle", [0.1, 0.3, -1.2], ids="{} rad".format)
def test_a_base_at_an_angle_has_another_direction_of_gravity(angle: float) -> None:
    """The axes of lift and elbow see gravity along z and x: the finding has the vector in the frame of the base."""
    turned = -9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle)
    finding = of_lift(robot=lift(gravity=turned))
    assert (finding.kind, finding.side, finding.unit) == ("direction of gravity", "base", "rad")
    assert finding.size == pytest.approx(abs(angle), rel=0.02)
    said = finding.sentence.partition("(gravity [")[2].partition("]")[0]
    assert np.array(said.split(", "), dtype=float) == pytest.approx(turned, abs=0.05)
    assert finding.sizes["gravity"] == pytest.approx(turned, abs=0.05)


def encoder(kind: str, channel: int, size: float, begin: float) -> Sensed:
    """Return what an encoder with a fault measures, whose velocity is the rate of its position."""
    taken, one = itertools.count(), np.eye(4)[channel]

    def sensed(q: Array, dq: Array) -> tuple[Array, Array]:
        since = PERIOD * next(taken) - begin
        error, rate = {
            "position offset": (size * np.ones(4), np.zeros(4)),
            "encoder gain": (size / 100 * q, size / 100 * dq),
            "eccentricity": (size * np.sin(q + 0.3), size * np.cos(q + 0.3) * dq),
            "encoder drift": (size * since, size * np.ones(4)),
            "encoder slip": (size * (since >= 0), np.zeros(4)),
        }[kind]
        return q + one * error, dq + one * rate

    return sensed


LINK, MOTOR = (0, "shoulder", "link"), (3, "elbow", "motor")
ENCODERS = [
    (LINK, "position offset", 1e-3, "rad", 0.0),
    (MOTOR, "encoder gain", -2.0, "%", 0.0),
    (LINK, "eccentricity", 5e-3, "rad", 0.0),
    (MOTOR, "encoder drift", 2e-3, "rad/s", 0.0),
    (LINK, "encoder slip", 2e-3, "rad", 0.7),
]
OF_THE_OTHER_SIDE = [(MOTOR if place == LINK else LINK, *fault) for place, *fault in ENCODERS]


@pytest.mark.parametrize(
    ("place", "kind", "size", "unit", "begin"),
    [*ENCODERS, *(pytest.param(*case, marks=pytest.mark.full) for case in OF_THE_OTHER_SIDE)],
)
def test_faulty_encoder_is_named_with_its_size_and_begin(
    place: tuple[int, str, str], kind: str, size: float, unit: str, begin: float
) -> None:
    channel, joint, side = place
    (finding,) = verdict(sensed=encoder(kind, channel, size, begin)).findings
    assert (finding.kind, finding.joint, finding.side, finding.unit) == (kind, joint, side, unit)
    assert finding.size == pytest.approx(size, rel=0.02 if kind == "position offset" else 0.05)
    assert finding.since == pytest.approx(begin, abs=0.04)


def test_begin_of_a_fault_of_the_robot_is_the_likeliest() -> None:
    """The motor of the elbow loses a tenth of its torque after 0.8 s."""
    taken = itertools.count()
    (finding,) = verdict(acting=lambda u: u * (1 - [0.0, 0.1] * np.array(next(taken) * PERIOD >= 0.8))).findings
    assert (finding.kind, finding.joint, finding.side) == ("torque constant", "elbow", "motor")
    assert finding.since == pytest.approx(0.8, abs=0.04)


@pytest.mark.parametrize("samples", [4000, 11_000])
def test_begin_is_told_by_the_stamps_across_a_gap_and_in_a_long_record(samples: int) -> None:
    """Of the long record the first and the last 5,000 states are used; states of the short one are missing."""
    begin = PERIOD * samples - 2.5
    sensed = encoder("encoder slip", *MOTOR[:1], 2e-3, begin)
    seen = recorded(law(), SWING, np.zeros(8), samples, sensed=sensed, steps=1)
    kept = np.delete(np.arange(samples), np.arange(500, 900)) if samples == 4000 else np.arange(samples)
    (finding,) = diagnose(replace(seen.rows(kept), t=seen.t[kept] + 100.0), law(), axes=AXES).findings
    assert (finding.kind.split(" or ")[0], finding.joint, finding.side) == ("encoder slip", "elbow", "motor")
    assert finding.since == pytest.approx(begin, abs=samples * PERIOD / 60)


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("kind", ["torque constant", "effort limit"])
def test_a_motor_of_a_differential_is_named(joint: int, kind: str) -> None:
    """Each of its motors drives both joints."""
    model = replace(MODEL, B_m=np.array([[1.0, 1.0], [1.0, -1.0]]))
    controlled = fjr.TrackingLaw(model, fjr.synthesize(model, 8.0, PERIOD), compile=True)
    one = np.eye(2)[joint]

    def acting(u: Array) -> Array:
        return u * (1 - 0.1 * one) if kind == "torque constant" else np.clip(u, *(s / (one + 1e-9) for s in (-3, 3)))

    seen = recorded(controlled, SWING, np.zeros(8), round(DURATION / PERIOD), acting=acting)
    (finding,) = diagnose(seen, controlled, axes=AXES).findings
    assert (finding.kind, finding.joint, finding.side) == (kind, NAMES[joint], "motor")
    assert finding.size == pytest.approx(-10.0 if kind == "torque constant" else 3.0, rel=0.06)


@pytest.mark.parametrize(("changed", "unit"), [("K", "%"), ("D_l", "N s/m"), ("M_m", "kg")])
def test_a_fault_of_a_prismatic_joint_has_its_units(changed: str, unit: str) -> None:
    """The equations are those of the two-link arm, of whose first joint metres are said."""
    real = replace(MODEL, **{changed: getattr(MODEL, changed) * [[1.2], [1.0]] * [[1.2, 1.0]]})
    sliding = replace(MODEL, prismatic=(True, False))
    controlled = fjr.TrackingLaw(sliding, law().gains, compile=True)
    (finding,) = diagnose(record(real), controlled, axes=replace(AXES, units=("m", "rad"))).findings
    assert (finding.joint, finding.unit) == ("shoulder", unit)
    assert f" {unit} explains" in finding.sentence


def torques_of(seen: Record, torque: Callable[[Residuals], Array]) -> Finding:
    """Return what is found if torques (b, 4) [N m] act in the blocks of a record, with noise."""
    found, rng, noise = innovations(seen, law()), np.random.default_rng(2), np.full(4, 1e-3)
    left = residuals(found, np.zeros((len(found), 2)), law())
    assert left is not None
    r = torque(left) + noise * rng.standard_normal(left.r.shape)
    (finding,) = torque_fault(replace(left, r=r, sigma=np.tile(noise, (len(r), 1)), noise=noise), NAMES)
    return finding


def found_in(seen: Record, signs: Array, drawn: bool) -> Finding:
    """Return what is found if torques of 0.1 N m times `signs` (4,) act in a record; drawn: anew in each block."""
    draw = np.random.default_rng(3).standard_normal if drawn else np.ones
    return torques_of(seen, lambda left: 0.1 * draw((len(left.r), 1)) * signs)


@pytest.mark.parametrize(("joints", "named"), [((0,), True), ((0, 1), False)])
def test_kinds_that_fit_equally_well_are_named_together(joints: tuple[int, ...], named: bool) -> None:
    """At rest a wrong stiffness leaves the torque of an offset; torques on two joints have no single cause."""
    q = np.array([0.4, -0.3])
    start = MODEL.state(q, q + np.linalg.solve(MODEL.K, MODEL.grad_P_l(q)), *np.zeros((2, 2)))
    still = recorded(law(), fjr.Sine([0.0, 0.0], [1.0, 1.0], q), start, round(DURATION / PERIOD))
    finding = found_in(still, sum(np.eye(4)[j] - np.eye(4)[2 + j] for j in joints), drawn=False)
    assert (finding.joint == "shoulder") is named
    assert ({"stiffness", "position offset"} <= {*finding.kind.split(" or ")}) is named or finding.kind == UNKNOWN


@pytest.mark.parametrize(
    ("channels", "joint", "side"),
    [((0,), "shoulder", "link"), ((3,), "elbow", "motor"), ((1, 3), "elbow", "joint"), ((0, 3), "", "")],
)
def test_place_of_an_unknown_torque_is_named(channels: tuple[int, ...], joint: str, side: str) -> None:
    """A torque that is drawn anew in each block fits no kind; on a link and another joint's motor it has no place."""
    signs = sum(np.eye(4)[channel] * (-1) ** i for i, channel in enumerate(channels))
    finding = found_in(healthy(), signs, drawn=True)
    assert (finding.kind, finding.joint, finding.side) == (UNKNOWN, joint, side)


def test_a_limit_of_the_effort_is_no_torque_constant() -> None:
    (finding,) = verdict(acting=lambda u: np.clip(u, [-np.inf, -0.6], [np.inf, 0.6])).findings
    assert (finding.kind, finding.joint, finding.side) == ("effort limit", "elbow", "motor")
    assert finding.size == pytest.approx(0.6, rel=0.06)  # of 60 tested ones


def test_a_motor_that_follows_no_command_has_no_kind_of_fault() -> None:
    """Nearly all of a large command is missing: each kind that takes it away explains the residual, not what acts."""
    acted = np.zeros(2)

    def acting(u: Array) -> Array:
        acted[:] = u[0], acted[1] + np.clip(u[1] - acted[1], -6e-3, 6e-3)
        return acted.copy()

    (finding,) = verdict(acting=acting).findings
    assert (finding.kind, finding.joint, finding.side) == (UNKNOWN, "elbow", "motor")


def test_a_cable_that_pulls_on_a_link_is_no_payload() -> None:
    finding = torques_of(healthy(), lambda left: (0.1 - 0.8 * left.means(left.q)[:, 1:2]) * np.eye(4)[1])
    assert (finding.kind, finding.joint, finding.side) == ("pull of a cable", "elbow", "link")
    assert finding.size == pytest.approx(0.8, rel=0.02)


@pytest.mark.parametrize(("swings", "kind"), [(False, EXTERNAL), (True, UNKNOWN)])
def test_a_torque_that_swings_is_a_resonance_and_no_contact(swings: bool, kind: str) -> None:
    def torque(left: Residuals) -> Array:
        k, driven = np.arange(len(left.r)), np.sign(left.means(left.dq)[:, 1])
        push = 0.3 * np.cos(2.0 * k) if swings else 0.3 * driven
        return np.where(k < len(k) // 3, push, 0.0)[:, None] * np.eye(4)[1]

    assert torques_of(healthy(), torque).kind == kind


@pytest.mark.parametrize(("step", "white", "velocity"), [(0.0, 1e-5, 1e-3), (2e-5, 0.0, 1e-3), (0.0, 3e-5, 1e-4)])
def test_noise_of_residuals_is_that_of_the_sensors_whatever_the_torque(
    step: float, white: float, velocity: float
) -> None:
    """Oracle: the residuals with noise minus those without it. step [rad]: resolution of the encoders."""
    clean, rng = healthy(), np.random.default_rng(3)
    torque = 0.05 * np.repeat(rng.standard_normal((len(clean.t) // 20 + 1, 2)), 20, axis=0)[: len(clean.t)]
    clean = replace(clean, u=clean.u + torque)
    position = clean.position + white * rng.standard_normal(clean.position.shape)
    position = step * np.round(position / step) if step else position
    noisy = replace(
        clean, position=position, velocity=clean.velocity + velocity * rng.standard_normal((len(torque), 4))
    )
    exact, seen = (
        residuals(found, np.zeros((len(found), 2)), law())
        for found in (innovations(each, law()) for each in (clean, noisy))
    )
    assert exact is not None
    assert seen is not None
    assert seen.noise == pytest.approx((seen.r - exact.r).std(axis=0), rel=0.25)


@pytest.mark.parametrize(("kind", "size"), [("velocity scale", 5.0), ("velocity delay", 2e-3), ("velocity sign", -1.0)])
def test_velocity_that_contradicts_the_position_is_isolated_without_a_model(kind: str, size: float) -> None:
    velocity = healthy().velocity.copy()
    changed = {"velocity scale": 1.05 * velocity, "velocity sign": -velocity}
    late = np.vstack([velocity[:1], velocity[:1], velocity[:-2]])
    velocity[:, 2] = changed.get(kind, late)[:, 2]
    (fault,) = velocity_faults(replace(healthy(), velocity=velocity), NAMES)
    assert (fault.kind, fault.joint, fault.side) == (kind, "shoulder", "motor")
    assert fault.size == pytest.approx(size, rel=0.05)


def test_a_record_without_velocities_or_too_short_has_no_finding() -> None:
    seen = healthy()
    few = {name: getattr(seen, name)[:15] for name in ("t", "position", "velocity", "jets", "u")}
    assert diagnose(replace(seen, **few), law()).findings == ()
    assert diagnose(replace(seen, velocity=np.full_like(seen.velocity, np.nan)), law()).findings == ()
    assert diagnose(seen, law(), velocities_measured=False).findings == ()


def test_body_torques_of_a_point_mass_equal_those_of_a_payload() -> None:
    """Oracle: inertia and potential with the payload minus those without, at zero velocity."""
    m, r = 0.3, np.array([0.1, 0.05, 0.2])
    theta = np.array([m, *(m * r), *(m * r[i] * r[j] for i, j in SECOND_MOMENTS)])
    loaded, q = PayloadArm(MODEL.links, MODEL.links.end_effector, ca.SX(m), ca.SX(r)), ca.SX.sym("q", 2)
    M = ca.Function("M", [q], [loaded.M_l(q) - MODEL.links.M_l(q)])
    g = ca.Function("g", [q], [loaded.grad_P_l(q) - MODEL.links.grad_P_l(q)])
    rng = np.random.default_rng(1)
    q_l, ddq_l = rng.normal(size=(2, 4, 2))
    found = body_torques(MODEL.links, 1, q_l, np.zeros((4, 2)), ddq_l) @ theta
    wanted = [M(a).full() @ b + g(a).full().ravel() for a, b in zip(q_l, ddq_l, strict=True)]
    assert found == pytest.approx(np.array(wanted), abs=1e-12)


@pytest.mark.parametrize(("share", "named"), [(0.05, False), (0.3, True)])
def test_nearest_kind_is_named_only_if_it_explains_a_tenth(share: float, named: bool) -> None:
    nearest = Hypothesis("inertia", 0, "motor", "kg m^2", np.zeros((1, 2, 1)))
    assert (
        "inertia (motor of a)" in unexplained(FittedFault(1.0, np.ones(1), nearest), share, ["a"]).sentence
    ) is named
