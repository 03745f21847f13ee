# SPDX-License-Identifier: Apache-2.0
"""Contradictions of a record are found and named: one labelled record each; healthy records pass.

The records are those of independent oracles (`system/motion_tables.py`); mistakes of files: `system/test_records.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from bench.identification import draw
from core.oracles.elastic_joint import ElasticJoint
from fjr_core.errors import RecordError
from fjr_core.numerics.checks import Array
from fjr_identification.estimation.motion_record import MotionRecord, on_uniform_grid
from fjr_identification.records.checks import findings, jumps
from fjr_identification.records.missing_sensors import LONGEST, _most_moving, least_seen
from fjr_identification.records.rigid_motion import RigidMotion, rigid_motion
from system.motion_tables import MotionTable, one_joint, two_joints

BOTH, MOTOR, SENSOR, LINK = ("link", "motor"), ("motor",), ("motor", "torque"), ("link", "torque")
SIGNALS = ("u", "q_l", "q_m", "torque")
Change = Callable[[MotionTable], MotionTable]


def elbow(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Return a change of one signal of the elbow."""
    return lambda table: table.with_joint(name, 1, change(table.signals[name][:, 1]))


def scaled(**factors: float) -> Change:
    """Return a change of whole signals by factors."""
    return lambda t: replace(t, signals={name: factors.get(name, 1.0) * x for name, x in t.signals.items()})


def exchanged(*names: str) -> Change:
    """Return a change that exchanges the joints of some signals."""
    return lambda table: replace(
        table, signals={name: x[:, ::-1] if name in names else x for name, x in table.signals.items()}
    )


def swapped(table: MotionTable) -> MotionTable:
    """Return the table with the sides of the elbow swapped."""
    link, motor = (table.signals[name][:, 1] for name in BOTH)
    return table.with_joint("link", 1, motor).with_joint("motor", 1, link)


def stopped(x: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(x)) < 700, x, x[700])


def late(x: np.ndarray) -> np.ndarray:
    return np.concatenate([np.full(10, x[0]), x[:-10]])


def spiked(x: np.ndarray) -> np.ndarray:
    return x + 0.5 * (np.arange(len(x)) == 600)


DEGREES, TURNS = np.degrees(1.0), 1 / (2 * np.pi)
CONTRADICTIONS: dict[str, tuple[tuple[str, ...], Change, str]] = {
    "too short": (BOTH, lambda t: t.rows(slice(99)), "has 99 samples; expected at least 200"),
    "at rest": (BOTH, scaled(link=1e-6, motor=1e-6), "expected a record of motion"),
    "a constant effort": (BOTH, elbow("effort", lambda x: 0 * x + 2.0), "u of elbow is 2 at every sample"),
    "a constant link": (BOTH, elbow("link", np.zeros_like), "q_l of elbow is 0 at every sample"),
    "one column for both sides": (
        BOTH,
        lambda table: table.with_signal("link", table.signals["motor"]),
        "q_m - q_l of shoulder is constant at every sample",
    ),
    "a revolution lost": (BOTH, elbow("link", lambda x: x - 2 * np.pi * (np.arange(len(x)) > 600)), "jumps by -6.28"),
    "a spike": (MOTOR, elbow("motor", spiked), "q_m of elbow jumps by 0.5"),
    "a motor that stops": (MOTOR, elbow("motor", stopped), "q_m of elbow stops at"),
    "both sides in degrees": (BOTH, scaled(link=DEGREES, motor=DEGREES), "as degrees only; expected rad"),
    "motors alone in degrees": (MOTOR, scaled(motor=DEGREES), "as degrees only; expected rad"),
    "one link in degrees": (BOTH, elbow("link", np.degrees), "degrees against rad"),
    "motors in turns": (BOTH, scaled(motor=TURNS), "turns against rad"),
    "joints of the links exchanged": (BOTH, exchanged("link"), "q_m of shoulder follows q_l of elbow"),
    "joints of the efforts exchanged": (MOTOR, exchanged("effort"), "the efforts of shoulder and elbow fit the motion"),
    "all joints exchanged": (BOTH, exchanged("effort", *BOTH), "all signals of shoulder and elbow fit the robot in"),
    "joints of the motors exchanged": (SENSOR, exchanged("motor"), "the positions of shoulder and elbow fit the robot"),
    "one gear ratio applied twice": (BOTH, elbow("motor", lambda x: x / 100), "q_m of elbow moves 0.0"),
    "one gear ratio not applied": (BOTH, elbow("motor", lambda x: 100 * x), "q_m of elbow moves 99"),
    "one ratio of 101 in place of 100": (BOTH, elbow("motor", lambda x: 1.01 * x), "q_m of elbow moves 1.01"),
    "sign of one motor": (BOTH, elbow("motor", np.negative), "q_m of elbow moves against q_l"),
    "sign of one motor alone": (MOTOR, elbow("motor", np.negative), "elbow"),
    "sign of one effort": (BOTH, elbow("effort", np.negative), "effort of elbow is -"),
    "sign of one torque sensor": (SENSOR, elbow("torque", np.negative), "torque of elbow is -"),
    "a link of 40 ms ago": (BOTH, elbow("link", late), "q_l of elbow is read 38.1 ms earlier than"),
    "a motor of 40 ms ago": (BOTH, elbow("motor", late), "q_l of elbow is read 38.6 ms later than"),
    "sides of one joint": (BOTH, swapped, "elbow"),
    "one effort at the motor's shaft": (BOTH, elbow("effort", lambda x: x / 100), "effort of elbow is 0.0"),
    "efforts in mN m": (MOTOR, scaled(effort=1e3), "effort of shoulder is 1"),
    "one effort clipped": (BOTH, elbow("effort", lambda x: np.minimum(x, 0.6 * x.max())), "effort of elbow is"),
    "half a gear ratio, motors alone": (
        MOTOR,
        elbow("motor", lambda x: 2 * x),
        "motion of elbow fit the links of the robot only with positions 0.5 times as large",
    ),
    "gear ratio of position and effort, motors alone": (
        MOTOR,
        lambda t: elbow("effort", lambda x: 2 * x)(elbow("motor", lambda x: x / 2)(t)),
        "only with positions 2 times and efforts 0.5 times as large",
    ),
    "a time of half the length, motors alone": (MOTOR, lambda t: replace(t, t=t.t / 2), "with a time 2 times as long"),
    "a time of twice the length, links": (LINK, lambda t: replace(t, t=2 * t.t), "with a time 0.5 times as long"),
}


@pytest.mark.parametrize("label", CONTRADICTIONS)
def test_a_contradiction_is_named_first(label: str) -> None:
    measured, change, sentence = CONTRADICTIONS[label]
    table = two_joints().of(*measured)
    found = findings(change(table).record, table.guess)
    assert sentence in found[0].sentence
    assert len({finding.kind for finding in found}) == 1


def test_a_fast_transient_of_a_long_record_is_no_jump() -> None:
    """The step response of a spring, 5 ms fast at 1 kHz, and then 20 s of slow motion."""
    t = 1e-3 * np.arange(20_000)
    transient = np.where(t > 0.5, 1 - np.exp(-(t - 0.5) / 5e-3) * (1 + (t - 0.5) / 5e-3), 0.0)
    q_l, u = (transient + 0.1 * np.sin(t))[:, None], np.cos(t)[:, None]
    record = MotionRecord("long", ("joint1",), 1e-3, u, q_l, np.nan * u, np.nan * u)
    assert list(jumps(record)) == []
    (found,) = jumps(replace(record, q_l=q_l + 0.2 * (t > 0.6)[:, None]))
    assert "q_l of joint1 jumps by 0.2" in found.sentence


TWO: dict[str, tuple[Change, tuple[str, ...]]] = {
    "sides swapped and sign of the other effort": (
        lambda t: swapped(t).with_joint("effort", 0, -t.signals["effort"][:, 0]),
        ("swapped_sides", "sign"),
    ),
    "degrees and a wrong gear ratio": (
        lambda t: scaled(link=DEGREES)(t).with_joint("motor", 0, 50 * t.signals["motor"][:, 0]),
        ("degrees", "gear_ratio"),
    ),
    "a spike and a clipped effort": (
        lambda t: elbow("link", spiked)(t).with_joint("effort", 0, np.minimum(t.signals["effort"][:, 0], 5.0)),
        ("jump", "clipped"),
    ),
}


@pytest.mark.parametrize("label", TWO)
def test_accepting_one_of_two_contradictions_shows_the_other(label: str) -> None:
    change, kinds = TWO[label]
    table, seen = two_joints().of(*BOTH), set[str]()
    for _ in kinds:
        new = [each.kind for each in findings(change(table).record, table.guess, seen) if each.kind not in seen]
        seen.add(new[0])
    assert seen & set(kinds)
    assert len(seen) == len(kinds)


def test_a_good_record_has_no_contradiction_even_if_the_robot_file_is_wrong_by_a_factor() -> None:
    for measured in (BOTH, MOTOR, SENSOR, LINK):
        assert findings(two_joints().of(*measured).record, two_joints().guess) == ()
    joint = ElasticJoint()
    for factor in (0.3, 3.0):
        links = {"link_inertia": joint.M / factor, "gravity_torque": joint.load / factor, "link_damping": joint.D_l}
        guessed = fjr.single_link(factor * joint.K, motor_inertia=factor * joint.B, **links)
        assert findings(one_joint().of(*BOTH).record, guessed) == ()


def slipping(torque: float, slip: float, ratio: float) -> MotionRecord:
    """Return 12 s of the paper's joint along a sine, with a Maxwell element beside its spring and a gear ratio."""
    t = 2e-3 * np.arange(6000)
    q_l, dq_l, ddq_l = np.sin(t), np.cos(t), -np.sin(t)
    tau, k, s, zeta = 0.031 * ddq_l + 0.2 * dq_l + 0.8 * np.sin(q_l), torque / slip, 0.0, np.empty(len(t))
    for i, needed in enumerate(tau):
        zeta[i] = (needed + k * s) / (31.0 + k)
        if abs(zeta[i] - s) > slip:
            side = np.sign(zeta[i] - s)
            zeta[i] = (needed - side * torque) / 31.0
            s = zeta[i] - side * slip
    dq_m = np.gradient(q_l + zeta, t)
    u = tau + 0.004 * np.gradient(dq_m, t) + 0.007 * dq_m
    columns = [each[:, None] for each in (u, q_l, ratio * (q_l + zeta), np.nan * u)]
    return MotionRecord("slipping", ("joint1",), 2e-3, *columns)


@pytest.mark.parametrize(("torque", "slip"), [(0.02, 2e-3), (0.05, 5e-3), (0.2, 1e-2)])
def test_hysteresis_is_no_gear_ratio(torque: float, slip: float) -> None:
    """Along one sine its lag is nearly a ratio of 0.98 to 0.99."""
    assert findings(slipping(torque, slip, 1.0), fjr.single_link(31.0)) == ()


@pytest.mark.parametrize(("torque", "slip", "ratios"), [(1e-9, 5e-3, (0.99, 1.01)), (0.02, 2e-3, (0.99, 1.01))])
def test_a_gear_ratio_is_refused_without_and_with_hysteresis(torque: float, slip: float, ratios: Any) -> None:
    for ratio in ratios:
        found = findings(slipping(torque, slip, ratio), fjr.single_link(31.0))
        assert [each.kind for each in found] == ["gear_ratio"], ratio


def test_what_contradicts_a_record_of_a_prismatic_joint_is_said_in_its_units() -> None:
    record, said = slipping(1e-9, 5e-3, 1.0), []
    jumping = replace(record, q_l=record.q_l + 0.5 * (np.arange(len(record.u)) == 500)[:, None])
    resting = replace(record, q_l=0 * record.q_l, q_m=0 * record.q_m)
    for slides in (False, True):
        robot = replace(fjr.single_link(31.0), prismatic=(slides,))
        said.append([findings(each, robot)[0].sentence for each in (jumping, resting)])
    revolute, prismatic = said
    assert "q_l of joint1 jumps by" in revolute[0]
    assert "moves by more than 0 rad" in revolute[1]
    assert prismatic == [each.replace(" rad", " m") for each in revolute]


def test_smooth_peaks_of_a_coarse_effort_are_not_clipped() -> None:
    table = two_joints().of(*BOTH)
    slow = 40.0 * np.sin(2 * np.pi * 0.25 * table.t)[:, None]
    coarse = table.with_signal("effort", np.round(table.signals["effort"] + slow, 1))
    found = findings(coarse.record, table.guess, ("sign", "effort_scale", "joint_order"))
    assert "clipped" not in [finding.kind for finding in found]


def test_a_joint_at_rest_next_to_a_moving_one_is_listed() -> None:
    table = two_joints().of(*BOTH)
    rest = table.with_joint("link", 1, 0 * table.t).with_joint("motor", 1, 0 * table.t)
    assert rest.record.still == ("elbow",)
    with pytest.raises(RecordError, match="has 2 joints; expected 1, as the robot"):
        findings(table.record, fjr.single_link())


@pytest.mark.parametrize(("factor", "with_effort"), [(0.01, False), (0.5, True), (2.0, False)])
def test_a_wrong_gear_ratio_of_the_only_side_is_found(factor: float, with_effort: bool) -> None:
    table = one_joint().of(*MOTOR)
    wrong = scaled(motor=factor, effort=1 / factor if with_effort else 1.0)(table)
    found = findings(wrong.record, table.guess)
    assert {finding.kind for finding in found} <= {"gear_ratio", "effort_scale"}
    assert [finding.joint for finding in found] == ["joint1"]


def test_the_minute_of_a_long_record_is_compared_in_which_the_joint_moves() -> None:
    """Rows of ten minutes would be too far apart for accelerations."""
    right = one_joint().of(*MOTOR).record
    rest = [np.repeat(getattr(right, name)[[0]], round(300.0 / right.dt), 0) for name in SIGNALS]
    long = {name: np.vstack([still, getattr(right, name), still]) for name, still in zip(SIGNALS, rest, strict=True)}
    compared = _most_moving(replace(right, **long))
    assert len(compared.u) * right.dt == pytest.approx(LONGEST, abs=right.dt)
    assert np.ptp(compared.q_m) == np.ptp(right.q_m)
    assert _most_moving(right) is right


def rows(record: MotionRecord, part: slice, **changes: float) -> MotionRecord:
    return replace(record, **{name: getattr(record, name)[part] for name in SIGNALS}, **changes)


def test_errors_of_one_side_are_found_from_a_factor_on() -> None:
    table = one_joint().of(*MOTOR)
    robot, record = table.guess, table.record
    ratio, _ = least_seen(record, robot)["joint1"]
    assert ratio > 1.25
    assert least_seen(one_joint().of(*BOTH).record, robot) == {}
    slightly_wrong = replace(record, q_m=1.01 * record.q_m)
    assert findings(slightly_wrong, robot) == ()
    assert least_seen(slightly_wrong, robot).keys() == {"joint1"}
    assert least_seen(rows(record, slice(210)), robot) == {}  # too short
    assert least_seen(rows(record, slice(0, 25 * 18, 25), dt=25 * record.dt), robot) == {}  # too few samples


@pytest.mark.parametrize(
    ("n", "measured"),
    [(1, "link-torque"), (1, "motor-torque"), pytest.param(2, "motor-torque", marks=pytest.mark.full)],
)
def test_a_healthy_record_of_the_coverage_study_has_no_finding(n: int, measured: str) -> None:
    case = draw(n, 2, duration=4.0, measured=measured)
    guessed = {name: np.diag(case.prior[name]) for name in ("joint_stiffness", "motor_inertia")}
    robot = replace(case.robot, K=guessed["joint_stiffness"], M_m=guessed["motor_inertia"])
    assert findings(case.record, robot) == ()


DT, K = 2e-3, 2000
GRID = DT * np.arange(K)


def motion(t: Array) -> Array:
    return np.column_stack([np.sin(7 * t), np.full(len(t), np.nan)])


def effort(t: Array) -> Array:
    """Return an effort that changes at each nominal sample."""
    return np.cos(5 * DT * np.floor(t / DT + 1e-9))[:, None]


def put(t: Array) -> tuple[float, Array, Array, tuple[str, ...]]:
    return on_uniform_grid("run.csv", t, effort(t), motion(t))


def test_uniform_samples_are_left_as_they_are() -> None:
    _, held, sampled, notes = put(GRID)
    assert np.array_equal(sampled, motion(GRID), equal_nan=True)
    assert np.array_equal(held, effort(GRID))
    assert notes == put(np.round(GRID, 5))[3] == ()


def test_jitter_is_interpolated_and_reported() -> None:
    t = GRID + DT * 0.3 * np.random.default_rng(1).uniform(-1, 1, K)
    t[0], t[-1] = 0.0, GRID[-1]
    dt, held, sampled, (note,) = on_uniform_grid("run.csv", t, np.ones((K, 1)), motion(t))
    assert dt == pytest.approx(DT)
    assert np.max(np.abs(sampled[:, 0] - motion(dt * np.arange(K))[:, 0])) < 1e-6
    assert np.all(np.isnan(sampled[:, 1]))
    assert held == pytest.approx(1.0)
    assert "interpolated to 2 ms: samples are up to 0.6" in note


def test_lost_samples_are_interpolated_and_counted() -> None:
    kept = np.delete(np.arange(K), [500, 501, 900])
    _, held, sampled, (note,) = put(GRID[kept])
    assert len(sampled) == K
    assert note.endswith("3 are missing")
    assert np.max(np.abs(sampled[:, 0] - motion(GRID)[:, 0])) < 1e-6
    still = np.delete(np.arange(K - 1), [500, 501, 899, 900])
    assert held[still] == pytest.approx(effort(GRID)[still], abs=1e-9)


def test_mean_of_a_held_effort_is_its_integral() -> None:
    t = GRID + 0.25 * DT * (np.arange(K) % 2)
    u = np.random.default_rng(2).standard_normal((K, 1))
    dt, held, _, _ = on_uniform_grid("run.csv", t, u, motion(t))
    widths = np.append(np.diff(t), dt * len(held) - (t[-1] - t[0]))
    assert dt * held.sum() == pytest.approx(float(widths @ u[:, 0]), abs=1e-2 * DT * K)


REFUSED = {
    "time jumps by 0.502 s at sample 501": np.where(GRID > 1.0, GRID + 0.5, GRID),
    "time runs back by 0.498 s at sample 501": np.where(GRID > 1.0, GRID - 0.5, GRID),
    "time stands still at sample 1": np.maximum(GRID, 0.1),
    "is the unit of the time right?": GRID * 1e-6,
    "expected 1e-05 to 0.1 s (is the unit of the time right?)": GRID * 1e3,
    "expected one sample period": np.where(GRID > 1.0, 2 * GRID - 1.0, GRID),
    "the time of sample 7 is not finite": np.where(GRID[7] == GRID, np.nan, GRID),
    "of the steps are longer than the usual 2 ms; expected at most 1 %": GRID[np.arange(K) % 10 > 0],
    "has 1 samples; expected at least 2": GRID[:1],
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_other_times_are_refused_in_one_sentence(sentence: str) -> None:
    t = REFUSED[sentence]
    with pytest.raises(RecordError, match="^run.csv") as caught:
        on_uniform_grid("run.csv", t, np.zeros((len(t), 1)), np.zeros((len(t), 1)))
    assert sentence in str(caught.value)


def lines() -> RigidMotion:
    """Return the motion of a joint whose record does not matter to the lines."""
    q = np.sin(3 * GRID)[:, None]
    return rigid_motion(MotionRecord("r", ("a",), GRID[1], q, q, 1.01 * q, np.full_like(q, np.nan)), fjr.single_link())


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e3])
def test_a_regressor_that_the_others_explain_has_no_slope_and_one_with_a_share_of_its_own_has(scale: float) -> None:
    other, own = np.sin(3 * GRID), np.sin(7 * GRID)
    noise = 1e-9 * np.random.default_rng(0).standard_normal(len(GRID))
    for x in (2 * other + 3, np.full_like(GRID, 3.3), 0 * GRID):
        found = lines().line(scale * x, 0.5 * other + noise, other)
        assert (found.slope, found.deviation) == (0.0, np.inf)
    found = lines().line(scale * (2 * other + 3 + 1e-2 * own), 0.5 * other + 4e-2 * own + noise, other)
    assert found.slope * scale == pytest.approx(4.0, rel=1e-6)
    assert found.unexplained < 1e-9
