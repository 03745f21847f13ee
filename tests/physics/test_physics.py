# SPDX-License-Identifier: Apache-2.0
"""The physics of the test bench is right by itself; identification finds friction that turns over anywhere."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp, trapezoid

from bench.identification_peers import NAMES, theirs
from fjr_design.uncertainty.posterior import IDENTIFIED, UNKNOWN, WEAK
from fjr_identification.estimation.parameters import IdentifyOptions
from fjr_identification.estimation.verdicts import SHAPED
from isolation import ROOT
from physics import causes, laws
from physics.__main__ import main
from physics.arm import Arm, Array, G, Motion, simulated
from physics.coverage import CASES, Interval, head, identified, line
from physics.draws import Case, Draws, drawn
from physics.sensors import Encoder, Sensors, sampled
from physics.sysid import case_of

DRAWS = 3
FRICTION = [
    pytest.param(laws.coulomb(1e-4), id="coulomb"),
    pytest.param(laws.root(1e-3), id="root", marks=pytest.mark.full),
    pytest.param(laws.stribeck(1e-3), id="stribeck", marks=pytest.mark.full),
    pytest.param(laws.loaded(1e-3, 0.1), id="loaded", marks=pytest.mark.full),
    pytest.param(laws.dahl(1e-4), id="dahl", marks=pytest.mark.full),
    pytest.param(laws.lugre(1e-4), id="lugre"),
]
"""`make test` integrates a law without a state and one with a state, `make test-all` the others too."""
SPRINGS = {
    "linear": laws.linear(),
    "cubic": laws.cubic(0.3, 5e-3),
    "backlash": laws.backlash(5e-4),
    "hysteresis": laws.hysteresis(0.3, 1e-3),
    "kinematic error": laws.kinematic_error(1e-4),
}


def arm_of(n: int, **changes: object) -> Arm:
    """Return different draws of an arm without friction and damping."""
    random, shape = np.random.default_rng(n), (DRAWS, n)
    values = [random.uniform(low, high, shape) for low, high in ((0.5, 2), (0.1, 0.2), (0.2, 0.4), (5e-3, 2e-2))]
    none = np.zeros(shape)
    arm = Arm(*values, 80.0 + none, 0.02 + none, none, none, none, none, 2e-3 + none)
    return replace(arm, tip_mass=np.full(DRAWS, 0.3), tilt=np.full(DRAWS, 0.1), **changes)


def swung(arm: Arm, dt: float = 2e-3, samples: int = 200, u: float = 0.0) -> tuple[Array, Array]:
    """Return times and states of an arm that is released from rest away from its balance."""
    n = arm.mass.shape[1]
    x = np.zeros((DRAWS, arm.rows, n))
    x[:, :2] = 0.7
    t = np.tile(dt * np.arange(samples + 1)[:, None], (1, DRAWS))
    return t, simulated(arm, x, t, lambda k, i, at: np.full((len(i), n), u)).x


def test_energy_is_conserved_without_friction() -> None:
    arm = arm_of(3)
    _, x = swung(arm)
    assert np.ptp(x[:, :, 0], axis=0).min() > 0.05
    energy = arm.energy(x)
    np.testing.assert_allclose(energy, np.broadcast_to(energy[0], energy.shape), rtol=0, atol=2e-5)


def test_work_of_efforts_and_friction_is_the_change_of_energy() -> None:
    none = np.zeros((DRAWS, 2))
    arm = arm_of(2, link_damping=none + 0.1, motor_friction=none + 0.2, link_friction=none + 0.1)
    t, x = swung(arm, dt=1e-3, samples=400, u=0.5)
    v_l, v_m = x[:, :, 2], x[:, :, 3]
    power = np.sum(v_m * (0.5 - 0.2 * np.tanh(v_m / 0.01)) - v_l * (0.1 * v_l + 0.1 * np.tanh(v_l / 0.01)), axis=-1)
    np.testing.assert_allclose(arm.energy(x[-1]) - arm.energy(x[0]), trapezoid(power, t, axis=0), rtol=2e-3)


def test_inertia_and_weight_equal_those_of_positions_in_the_plane() -> None:
    arm, random, step = arm_of(3), np.random.default_rng(0), 1e-6
    q, v = random.normal(size=(2, DRAWS, 3))

    def bodies(q: Array) -> Array:
        """Return the positions (2, DRAWS, 4) of all bodies: centres of mass, then the tip."""
        theta = np.cumsum(q, axis=1) + arm.tilt[:, None]
        ends = np.cumsum([arm.length * np.sin(theta), -arm.length * np.cos(theta)], axis=2)
        starts = np.concatenate([np.zeros((2, DRAWS, 1)), ends[:, :, :2]], axis=2)
        centres = starts + np.array([arm.com * np.sin(theta), -arm.com * np.cos(theta)])
        return np.concatenate([centres, ends[:, :, 2:]], axis=2)

    mass = np.hstack([arm.mass, np.full((DRAWS, 1), 0.3)])
    speed = (bodies(q + step * v) - bodies(q - step * v)) / (2 * step)
    kinetic = np.sum(mass * np.sum(speed**2, axis=0), axis=1) + np.sum(arm.inertia * np.cumsum(v, axis=1) ** 2, axis=1)
    np.testing.assert_allclose(np.einsum("di,dij,dj->d", v, arm.link_inertia(q), v), kinetic, rtol=1e-6)
    for j in range(3):
        moved = step * np.eye(3)[j]
        slope = G * np.sum(mass * (bodies(q + moved)[1] - bodies(q - moved)[1]), axis=1) / (2 * step)
        np.testing.assert_allclose(arm.link_torque(q, 0 * q)[:, j], slope, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("friction", FRICTION)
def test_motion_equals_that_of_scipy(friction: laws.Friction) -> None:
    level = np.full((DRAWS, 2), 0.2)
    arm = arm_of(2, friction=friction, link_friction=level, motor_friction=level)
    t, x = swung(arm, samples=60, u=0.3)
    alone = replace(arm, **{name: value[:1] for name, value in vars(arm).items() if isinstance(value, np.ndarray)})

    def rates(_: float, y: Array) -> Array:
        return alone.rates(y.reshape(1, arm.rows, 2), np.full((1, 2), 0.3)).ravel()

    found = solve_ivp(rates, (0, t[-1, 0]), x[0, 0].ravel(), "Radau", rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(x[-1, 0].ravel()[:4], found.y[:4, -1], rtol=0, atol=3e-7)


@pytest.mark.parametrize("spring", SPRINGS.values(), ids=list(SPRINGS))
def test_a_spring_in_a_closed_cycle_gives_back_at_most_its_work(spring: laws.Spring) -> None:
    steps = 2000
    q_m = 5e-3 * np.sin(np.linspace(0, 4 * np.pi, 2 * steps + 1))
    w, torques = 0.0, []
    for before, after in pairwise(q_m):
        tau, tau_m, dw = spring.law(np.float64(200.0), 0.0, (before + after) / 2, 0.0, after - before, np.float64(w))
        torques.append(tau_m)
        w += float(dw)
    work = float(np.sum(np.array(torques[steps:]) * np.diff(q_m[steps:])))
    assert work > -1e-6
    assert (work > 1e-4) == spring.has_state


def test_breakaway_levels_and_secants_are_as_named() -> None:
    one, rest = np.ones(1), np.zeros(1)
    for friction in (laws.coulomb(1e-3), laws.root(1e-5), laws.stribeck(1e-3)):
        assert friction.law(one, 0.3 * one, rest, rest)[0] == pytest.approx(0.3, rel=1e-3)
    assert laws.loaded(1e-3, 0.1).law(one, 0.3 * one, rest, -2 * one)[0] == pytest.approx(0.5)
    for friction in (laws.dahl(1e-4), laws.lugre(1e-4)):
        sliding = np.full(1, 1e-4)
        torque, dw = friction.law(one, 0.3 * one, sliding, rest)
        assert (torque, dw) == (pytest.approx(0.3, rel=1e-3), pytest.approx(0.0, abs=1e-3))
    K = 200 * one
    assert laws.cubic(0.3, 5e-3).law(K, rest, 5e-3 * one, rest, rest, rest)[0] == pytest.approx(1.3)
    assert laws.backlash(5e-4).law(K, rest, 2e-4 * one, rest, rest, rest)[0] == 0.0
    assert laws.backlash(5e-4).law(K, rest, 5e-3 * one, rest, rest, rest)[0] == pytest.approx(200 * 4.75e-3)


def test_samples_are_read_late_lost_and_rounded() -> None:
    dt, phase = 2e-3, np.array([[0.3, 0.5], [0.7, 0.9]])
    t = np.tile(dt * np.arange(301)[:, None] + 3e-4, (1, 2))
    angle = t[:, :, None] + phase
    motion = Motion(t, np.stack([np.sin(angle), 2 * np.sin(angle), np.cos(angle), 2 * np.cos(angle)], 2), 0 * angle[1:])
    skew = np.array([[1e-3, -2e-3], [3e-3, 0.0]])
    for i, samples in enumerate(sampled(motion, dt, skew, Sensors(Encoder(0.0), Encoder(0.0)))):
        np.testing.assert_allclose(samples.q_m, 2 * np.sin(samples.t[:, None] + phase[i]), atol=1e-12)
        np.testing.assert_allclose(samples.q_l, np.sin(samples.t[:, None] + skew[i] + phase[i]), atol=1e-12)
    whole, coarse = (sampled(motion, dt, skew, sensors)[1] for sensors in (Sensors(), Sensors(Encoder(1e-3), lost=0.2)))
    assert 0.7 < len(coarse.t) / len(whole.t) < 0.9
    np.testing.assert_allclose(coarse.q_l / 1e-3, np.round(coarse.q_l / 1e-3), atol=1e-9)


FREED = {
    "Stribeck": ("link_static_friction", "motor_static_friction", "stribeck_velocity"),
    "load": ("link_load_friction", "motor_load_friction"),
}
"""What is estimated only where friction falls with speed or grows with load."""


@pytest.mark.parametrize("turning", [3e-4, pytest.param(1e-3, marks=pytest.mark.full), 2e-2])
@pytest.mark.parametrize("joints", [1, pytest.param(2, marks=pytest.mark.full)])
def test_friction_is_identified_wherever_it_turns_over(turning: float, joints: int) -> None:
    found = identified(drawn(Case(laws.coulomb(turning), duration=2.0), joints, 2, 3), 0, IdentifyOptions())
    assert found is not None
    seen = [each for each in found if each.verdict != UNKNOWN]
    assert max(each.away for each in seen) < 5
    assert all(each.error < 2e-3 for each in seen if each.kind == "joint_stiffness")
    assert all(each.error < 0.3 for each in found if each.kind == "friction_smoothing_velocity")


@pytest.mark.parametrize(
    ("friction", "freed"),
    [(laws.stribeck(1e-3), FREED["Stribeck"]), (laws.loaded(1e-3, 0.03), FREED["load"])],
    ids=list(FREED),
)
def test_friction_that_falls_with_speed_or_grows_with_load_is_found_where_it_is(
    friction: laws.Friction, freed: tuple[str, ...]
) -> None:
    found = identified(drawn(Case(friction, duration=1.5), 1, 2, 1), 1, IdentifyOptions()) or []
    assert set(freed) <= {each.kind for each in found}
    assert max(each.away for each in found if each.verdict != UNKNOWN) < 4


STRAIGHT, LOOSE, STIFFENING, LOOP, GEAR = (
    Case(friction, spring, duration=2.0)
    for friction, spring in (
        (laws.coulomb(1e-3), laws.linear()),
        (laws.coulomb(0.01), laws.backlash(5e-4)),
        (laws.coulomb(0.01), laws.cubic(0.3, 5e-3)),
        (laws.coulomb(0.01), laws.hysteresis(0.3, 1e-3)),
        (laws.coulomb(0.01), laws.kinematic_error(1e-4)),
    )
)
HEAVY = Case(stated_mass=1.3, duration=2.0, cause="the links of the robot file")


@cache
def one_joint_of(case: Case) -> Draws:
    """Return four draws of one joint."""
    return drawn(case, 1, 4, 1)


@pytest.mark.parametrize(
    ("case", "draw", "said"),
    [
        (STRAIGHT, 1, ""),
        (LOOSE, 1, "backlash of about 0.48 mrad"),
        (LOOSE, 0, ""),  # its torque keeps its sign, so that the dead zone is never passed
        (STIFFENING, 1, "the spring is not linear: 20.9 N m/rad at 2.5 mrad, 35"),
        (LOOP, 1, "hysteresis"),
        (GEAR, 1, "kinematic error of about 0.1 mrad, 200"),
        (HEAVY, 1, "the links of the robot file do not fit: a factor of 0.77"),
    ],
)
def test_what_the_model_of_a_joint_lacks_is_named(case: Case, draw: int, said: str) -> None:
    named = causes.named(one_joint_of(case), draw)
    assert named is not None
    ((reason, *_),) = named
    assert " ".join(said.split()[:2]) in reason
    assert bool(reason) == bool(said)
    numbers = [float(word) for word in reason.replace(",", "").split() if word.replace(".", "").isdigit()]
    expected = [float(word) for word in said.replace(",", "").split() if word.replace(".", "").isdigit()]
    assert numbers[: len(expected)] == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("case", "cause"),
    [
        (STRAIGHT, ""),
        (LOOSE, "backlash"),
        pytest.param(STIFFENING, "not linear", marks=pytest.mark.full),
        pytest.param(LOOP, "hysteresis", marks=pytest.mark.full),
        pytest.param(GEAR, "kinematic error", marks=pytest.mark.full),
        pytest.param(HEAVY, "the links of the robot file", marks=pytest.mark.full),
    ],
)
def test_a_stiffness_is_called_identified_only_where_the_model_lacks_nothing(case: Case, cause: str) -> None:
    found = identified(one_joint_of(case), 1, IdentifyOptions())
    assert found is not None
    assert {each.kind for each in found}.isdisjoint(sum(FREED.values(), ())) or cause
    (K,) = (each for each in found if each.kind == "joint_stiffness")
    assert (K.verdict == IDENTIFIED) == (not cause)
    assert cause in K.reason


BRISTLES = CASES["Dahl, 0.1 mrad"]


@pytest.mark.parametrize(
    ("case", "count", "seed"),
    [
        (replace(BRISTLES, duration=2.0), 1, 1),
        pytest.param(BRISTLES, 5, 2026, marks=pytest.mark.full),  # the first ones of docs/tables/identification.md
    ],
)
def test_intervals_hold_with_friction_of_bristles(case: Case, count: int, seed: int) -> None:
    draws = drawn(case, 1, count, seed)
    found = [identified(draws, i, IdentifyOptions()) or [] for i in range(count)]
    known = [each for intervals in found for each in intervals if each.verdict != UNKNOWN]
    assert np.mean([each.inside for each in known]) > 0.8
    assert max(each.away for each in known) < 6
    for each in known:
        if each.kind in SHAPED:  # friction of another shape acts like these, unseen
            assert each.verdict == WEAK
            assert "bristles" in each.reason


def test_a_row_of_the_table_counts_what_is_inside() -> None:
    whys = {0.5: "", 3.0: "backlash of about 1 mrad"}
    intervals = [
        Interval("joint_stiffness", away, 0.01, "identified", why, meets=not why, width=0.02)
        for away, why in whys.items()
    ]
    row = line("a case", [[intervals, None]])
    assert len(row.split("|")) == len(head().splitlines()[0].split("|"))
    assert row.startswith("| a case | 2 (1 refused) | 50.0% | 1/2 |")
    assert row.endswith("| 3.0 | 2 of 2 | 1 of 2 | 0.01 | 0.02 | 1/2 |")


def test_a_row_of_causes_counts_what_is_named_of_joints_that_pass_the_dead_zone() -> None:
    said = "backlash of about 0.5 mrad: the deflection jumps where the torque changes sign"
    right, missed = (said, True, False, False), ("", False, True, True)
    two = [right, ("hysteresis, loop of about 1 mrad", True, False, False)]
    row = causes.line("backlash 0.5 mrad", [[[right], [missed]], [two, None]])
    assert row == "| backlash 0.5 mrad | 1 of 2 | 1 of 2 | 2 of 3 | 1 | 1 | 1 hysteresis, 1 records refused |"
    assert len(row.split("|")) == len(causes.head([1, 2]).splitlines()[0].split("|"))


def test_a_torque_changes_its_sign_if_both_ends_of_its_deflections_do() -> None:
    draws = one_joint_of(LOOSE)
    samples = draws.records[0]
    for shift in (0.0, 0.02):
        q_l = samples.q_m - draws.arm.offset[0] - shift - 5e-3 * np.sin(40.0 * samples.t)[:, None]
        still = replace(draws, records=[replace(samples, q_l=q_l)], skew=0.0 * draws.skew)
        assert still.changes_sign(0, 0.05).tolist() == [shift == 0.0]


def test_the_command_adds_to_a_file_and_prints_what_it_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(CASES, "links 30 % too heavy in the robot file", HEAVY)  # shorter
    given = ["--causes", "--draws", "1", "--joints", "1", "--out", str(tmp_path / "done"), "too heavy"]

    def said(processes: int) -> list[str]:
        assert main([*given, "--processes", str(processes)]) == 0
        return capsys.readouterr().out.splitlines()

    lines = said(1)
    assert lines[2].startswith("| links 30 % too heavy in the robot file | ")
    assert said(0) == lines
    other = json.loads((tmp_path / "done").read_text(encoding="utf-8")) | {"code": "of another estimator"}
    (tmp_path / "done").write_text(json.dumps(other), encoding="utf-8")
    command = [sys.executable, "-m", "tests.physics", *given, "--processes", "0"]
    head_alone = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    assert head_alone.splitlines() == lines[:2]  # this estimator has done nothing


def test_mujoco_finds_a_joint_without_dry_friction_in_a_record_of_this_simulator() -> None:
    none = np.zeros((1, 1))
    smooth = Case(varied=lambda arm: replace(arm, link_friction=none, motor_friction=none), duration=1.5)
    case = case_of(drawn(smooth, 1, 1, seed=2), 0)
    truth, start = ({name: known[name] for name in NAMES} for known in (case.truth, case.start))
    found = theirs(replace(case, truth=truth, start=start), pieces=3)
    np.testing.assert_allclose(found.values[:2], [truth[name] for name in NAMES[:2]], rtol=1e-3)
