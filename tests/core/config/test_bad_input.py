# SPDX-License-Identifier: Apache-2.0
"""Invalid input, also files of any content, raises an FjrError whose sentence names value and expectation."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import fjr_core as fjr
from fjr_core.config import robot_file, ros_yaml
from fjr_core.config.scenario import load_scenario
from fjr_core.files import text_file
from fjr_core.law.interfaces import SampledLaw
from fjr_core.monitoring.external_torque import ExternalTorqueObserver, StatedErrors
from fjr_core.robust.law import Robust, RobustLaw
from fjr_core.simulation.imperfections import Imperfections
from fjr_core.stability.linear_controller import Sensing
from fuzzing import answer, bytes_of, documents, fuzzed, refused, texts
from two_link_urdf import JOINTS, MOTOR_INERTIA, STIFFNESS, two_link_urdf

NAN, INF = float("nan"), float("inf")
PAPER = {"Lambda_l": 10.0, "Pi_l": 20.0, "K_ld": 0.6, "Lambda_m": 15.0, "Pi_m": 60.0, "K_md": 0.3}
ROBOT = fjr.planar_two_link()
LAW = fjr.TrackingLaw(ROBOT, fjr.PAPER_GAINS)
X, JETS, U, ROWS = np.zeros(8), np.zeros((5, 2)), np.zeros(2), np.zeros((2, 3, 4))


def run(**overrides: object) -> fjr.Trajectory:
    values = {
        "plant": fjr.Plant(ROBOT),
        "law": LAW,
        "reference": fjr.Sine((1.0, 1.0), 1.0),
        "x0": X,
        "duration": 0.01,
        "sample_period": 1e-3,
    }
    return fjr.simulate(**{**values, **overrides})


BODY = {"rotation": np.eye(3), "translation": np.zeros(3), "axis": (0, 0, 1), "mass": 1.0, "com": np.zeros(3)}
LIMITS = {"lower": [-1.0, -1.0], "upper": [0.5, 0.5], "velocity": [1.0, 1.0], "effort": [1.0, 1.0]}
MAKE: dict[str, tuple[type[fjr.FjrError], Callable[..., object]]] = {
    "single_link": (fjr.RobotError, fjr.single_link),
    "planar_two_link": (fjr.RobotError, fjr.planar_two_link),
    "robot": (fjr.RobotError, partial(replace, ROBOT)),
    "body": (fjr.RobotError, lambda **values: fjr.Body(**{**BODY, "inertia": np.eye(3), **values})),
    "chain": (fjr.RobotError, fjr.serial_chain),
    "limits": (fjr.RobotError, lambda **values: fjr.JointLimits(**{**LIMITS, **values})),
    "gains": (fjr.GainsError, lambda **values: fjr.TrackingLaw(ROBOT, fjr.Gains(**{**PAPER, **values}))),
    "robust": (fjr.GainsError, lambda **values: RobustLaw(LAW, Robust(**values))),
    "imperfections": (fjr.ParameterError, partial(Imperfections, 2)),
    "observer": (fjr.ParameterError, partial(fjr.VelocityObserver, ROBOT)),
    "torque observer": (fjr.ParameterError, partial(ExternalTorqueObserver, ROBOT)),
    "stated errors": (fjr.ParameterError, partial(StatedErrors, 2)),
    "sensing": (fjr.StateError, Sensing),
    "simulation": (fjr.StateError, run),
    "plant": (fjr.ParameterError, partial(fjr.Plant, ROBOT)),
}
VALUES = [
    ("single_link", {"stiffness": -31.0}, "K", "-31", "positive definite"),
    ("single_link", {"stiffness": NAN}, "K", "nan", "finite"),
    ("single_link", {"motor_inertia": 0.0}, "M_m", "positive definite"),
    ("single_link", {"link_inertia": 0.0}, "link_inertia", "positive"),
    ("single_link", {"motor_damping": -0.007}, "D_m", "-0.007", "semidefinite"),
    ("single_link", {"gravity_torque": NAN}, "gravity_torque", "nan", "finite"),
    ("single_link", {"gravity_torque": "heavy"}, "gravity_torque", "heavy", "numbers"),
    ("planar_two_link", {"stiffness": [1.0, 2.0, 3.0]}, "K", "(3,)", "(2,)"),
    ("planar_two_link", {"stiffness": np.eye(3)}, "K", "(3, 3)", "(2, 2)"),
    ("planar_two_link", {"stiffness": [[30, 1], [2, 20]]}, "K", "symmetric"),
    ("planar_two_link", {"link_damping": [[0.1, 0.2], [0.2, 0.1]]}, "D_l", "-0.1", "semidefinite"),
    ("planar_two_link", {"input_gain": [[1, 2], [2, 4]]}, "B_m", "invertible"),
    ("planar_two_link", {"link_mass": (1.0, -0.1)}, "link_mass", "-0.1", "positive"),
    ("planar_two_link", {"link_length": (1.0, 1.0, 1.0)}, "link_length", "(3,)", "(2,)"),
    ("planar_two_link", {"gravity": (9.81, 9.81)}, "gravity", "(2,)"),
    ("robot", {"cubic": [-1.0, 2.0]}, "cubic is [-1.0, 2.0] N m/rad^3; expected 0 or more"),
    ("robot", {"limits": fjr.JointLimits([-1.0], [1.0], [1.0], [1.0])}, "limits are of 1 joints; expected 2"),
    ("body", {"mass": -1.0}, "mass is -1.0 kg; expected 0 or more"),
    ("body", {"mass": NAN}, "mass is nan"),
    ("body", {"mass": [1.0, 2.0]}, "mass is [1.0, 2.0] kg; expected 0 or more"),
    ("body", {"rotation": np.diag([1.0, 1.0, -1.0])}, "expected a rotation matrix"),
    ("body", {"rotation": np.eye(2)}, "rotation has shape (2, 2)"),
    ("body", {"axis": (0, 0, 0)}, "axis is zero; expected a direction"),
    ("body", {"axis": (0, 1)}, "axis has shape (2,)"),
    ("body", {"com": (0, INF, 0)}, "com is ", "expected finite numbers"),
    ("body", {"translation": "here"}, "translation is 'here'; expected numbers"),
    ("body", {"inertia": np.diag([1.0, 1.0, -0.1])}, "inertia has smallest eigenvalue -0.1"),
    ("body", {"inertia": [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]}, "inertia is not symmetric"),
    ("chain", {"bodies": []}, "expected at least one"),
    ("chain", {"bodies": ROBOT.links.bodies, "order": [1, 1]}, "order is [1, 1]; expected each of 0 to 1 once"),
    ("chain", {"bodies": ROBOT.links.bodies, "gravity": (0, -9.81)}, "gravity has shape (2,)"),
    ("limits", {"lower": [1.0, 0.0]}, "expected lower <= upper"),
    ("limits", {"effort": [0.0, 1.0]}, "effort limit is ", "expected positive numbers"),
    ("limits", {"velocity": [1.0]}, "velocity limit is [1.0]; expected a number or 2, one per joint"),
    ("limits", {"upper": [1.0, NAN]}, "upper limit is ", "expected a number or 2, one per joint"),
    ("limits", {"upper": "high"}, "upper limit is 'high'; expected numbers"),
    ("gains", {"Pi_l": 0.0}, "Pi_l", "positive definite"),
    ("gains", {"Pi_m": -60.0}, "Pi_m", "-60", "positive definite"),
    ("gains", {"K_ld": 0.0}, "K_ld", "positive definite"),
    ("gains", {"K_md": -0.3}, "K_md", "-0.3", "positive definite"),
    ("gains", {"Lambda_l": 0.0}, "Lambda_l", "(32)", "positive definite"),
    ("gains", {"Lambda_m": -15.0}, "Lambda_m", "-15", "(41)", "positive definite"),
    ("gains", {"Gamma_l": -1.0}, "Gamma_l", "-20", "(32)", "nonnegative"),
    ("gains", {"Gamma_m": -1.0}, "Gamma_m", "-60", "(41)", "nonnegative"),
    ("gains", {"Lambda_m": INF}, "Lambda_m", "inf", "finite"),
    ("gains", {"Pi_m": [[60, 1], [0, 60]]}, "Pi_m", "symmetric"),
    ("robust", {"residual_gain": -1.0}, "residual_gain is [-1.0, -1.0] 1/s; expected 0 to 10000"),
    ("robust", {"motor_integral_gain": 1e200}, "motor_integral_gain is [1e+200, 1e+200] 1/s; expected 0 to 10000"),
    ("robust", {"integral_gain": 1.0, "hold": 0.0}, "hold is 0.0 s with an integral; expected more than 0"),
    ("robust", {"integral_gain": [1.0] * 3}, "integral_gain has shape (3,); expected a scalar or (2,)"),
    ("robust", {"motor_integral_gain": NAN}, "motor_integral_gain is nan; expected finite numbers"),
    ("robust", {"delay": -1e-3}, "delay is -0.001 s; expected 0 or more"),
    ("robust", {"delay": "late"}, "delay is 'late'; expected numbers"),
    ("robust", {"delay": 1.0}, "delay is 1.0 s with a hold of 0.001 s; expected at most 32 holds"),
    ("robust", {"delay": 1e-3, "hold": INF}, "hold is inf s; expected 0 or more"),
    ("imperfections", {"coulomb_l": -0.1}, "coulomb_l is ", "expected"),
    ("imperfections", {"static_m": NAN}, "static_m is ", "expected finite"),
    ("imperfections", {"effort_limit": NAN}, "effort_limit is ", "expected"),
    ("imperfections", {"slip": 0.0}, "slip is ", "expected"),
    ("imperfections", {"cubic": [1.0, 2.0, 3.0]}, "cubic has shape (3,); expected a scalar or (2,)"),
    ("imperfections", {"payload_position": (1.0, 2.0)}, "payload_position has shape (2,); expected a scalar or (3,)"),
    ("imperfections", {"ripple": "much"}, "ripple is 'much'", "expected"),
    ("observer", {"bandwidth": 0.0}, "expected a positive finite number"),
    ("observer", {"bandwidth": INF}, "expected a positive finite number"),
    ("observer", {"bandwidth": "fast"}, "bandwidth is 'fast'; expected numbers"),
    ("sensing", {"bandwidth": -150.0}, "bandwidth is -150.0 rad/s; expected a positive finite number"),
    ("torque observer", {"bandwidth": -1.0}, "bandwidth is -1.0 1/s; expected a positive finite number"),
    ("stated errors", {"link_mass": -0.1}, "link_mass is [-0.1, -0.1]; expected 0.0 to"),
    ("stated errors", {"torque_noise": 0.0}, "torque_noise is [0.0, 0.0] N m; expected 1e-09 to"),
    ("stated errors", {"joint_stiffness": [0.1] * 3}, "joint_stiffness has shape (3,); expected a scalar or (2,)"),
    ("stated errors", {"link_torque": NAN}, "link_torque is nan; expected finite"),
    ("plant", {"integrator": "euler"}, "euler", "rk4", "implicit_midpoint"),
    ("simulation", {"x0": X[:4]}, "x0", "(4,)", "(8,)"),
    ("simulation", {"x0": np.full(8, NAN)}, "x0", "nan", "finite"),
    ("simulation", {"x0": X + 0.1j}, "x0", "complex", "real"),
    ("simulation", {"duration": 0.0}, "duration", "0.0", "positive"),
    ("simulation", {"duration": "long"}, "duration is 'long'; expected numbers"),
    ("simulation", {"duration": None}, "duration is None s; expected a positive finite number"),
    ("simulation", {"duration": [1.0, 2.0]}, "duration is [1.0, 2.0] s; expected a positive finite number"),
    ("simulation", {"sample_period": INF}, "sample_period", "inf", "positive"),
    ("simulation", {"inner_step": NAN}, "nan", "positive"),
    ("simulation", {"delay": NAN}, "delay", "nan", "0 or more"),
    ("simulation", {"delay": 1e-3, "sample_period": None}, "delay", "0.001", "continuous"),
    ("simulation", {"reference": fjr.Sine(1.0, 1.0)}, "joints", "2", "1"),
    ("simulation", {"plant": ROBOT}, "plant is a Robot; expected a plant, e.g. fjr.Plant(robot)"),
    ("simulation", {"plant": fjr.Plant(fjr.single_link())}, "x0", "(8,)", "(4,)"),
    ("simulation", {"plant": fjr.Plant(fjr.single_link()), "x0": np.zeros(4)}, "joints", "1", "2"),
]


@pytest.mark.parametrize(("what", "values", "words"), [(k, v, w) for k, v, *w in VALUES])
def test_invalid_values_are_rejected(what: str, values: dict[str, object], words: list[str]) -> None:
    error, make = MAKE[what]
    refused(error, lambda: make(**values), *words)


FULL_PI = [[20.0, 18.0], [18.0, 20.0]]


@pytest.mark.parametrize(("side", "equation"), [("l", "(32)"), ("m", "(41)")])
def test_monotone_phi_is_not_sufficient_with_a_full_metric(side: str, equation: str) -> None:
    """Lambda = diag(20, 1) is monotone and passes with Pi = 20; sym(Pi Lambda) is indefinite with FULL_PI."""
    Lambda = {f"Lambda_{side}": [20.0, 1.0]}
    product = np.array(FULL_PI) @ np.diag([20.0, 1.0])
    assert np.min(np.linalg.eigvalsh(product + product.T)) < 0
    assert fjr.TrackingLaw(ROBOT, fjr.Gains(**{**PAPER, **Lambda})).rate().beta > 0
    gains = fjr.Gains(**{**PAPER, **Lambda, f"Pi_{side}": FULL_PI})
    refused(fjr.GainsError, lambda: fjr.TrackingLaw(ROBOT, gains), f"Lambda_{side}", f"Pi_{side}", equation)


@pytest.mark.parametrize(("side", "equation"), [("l", "(32)"), ("m", "(41)")])
def test_a_cubic_phi_needs_a_diagonal_product_with_the_metric(side: str, equation: str) -> None:
    """Pi dphi is indefinite for a large error otherwise."""
    full = {**PAPER, f"Pi_{side}": FULL_PI}
    gains = fjr.Gains(**{**full, f"Gamma_{side}": 1.0})
    refused(fjr.GainsError, lambda: fjr.TrackingLaw(ROBOT, gains), f"Gamma_{side}", equation)
    Gamma = np.linalg.inv(FULL_PI) @ np.diag([3.0, 5.0])
    assert fjr.TrackingLaw(ROBOT, fjr.Gains(**{**full, f"Gamma_{side}": Gamma})).rate().beta > 0


@pytest.mark.parametrize(("first", "second"), [(3.0, 0.0), (0.0, 5.0), (0.1, 0.7)])
def test_rounding_of_the_product_with_a_full_metric_is_tolerated(first: float, second: float) -> None:
    for seed in range(20):
        root = np.random.default_rng(seed).uniform(-1, 1, (2, 2))
        Pi = 20 * (root @ root.T + 0.1 * np.eye(2))
        Gamma = np.linalg.inv(Pi) @ np.diag([first, second])
        fjr.TrackingLaw(ROBOT, fjr.Gains(**{**PAPER, "Pi_l": Pi, "Gamma_l": Gamma}))


SHAPES: dict[str, tuple[Callable[[], object], tuple[str, ...]]] = {
    "effort-x_v": (lambda: LAW.effort(np.zeros(7), X, JETS), ("x_v", "(7,)", "(8,)")),
    "effort-jets-transposed": (lambda: LAW.effort(X, X, JETS.T), ("jets", "(2, 5)", "(5, 2)")),
    "effort-ragged-jets": (lambda: LAW.effort(X, X, [[0.0], [0.0, 0.0]]), ("jets",)),
    "effort-complex": (lambda: LAW.effort(X + 0.1j, X, JETS), ("x_v is complex", "real numbers")),
    "effort-text": (lambda: LAW.effort("here", X, JETS), ("x_v",)),
    "rate": (lambda: LAW.rate(np.zeros((3, 5))), ("configurations", "(3, 5)", "2")),
    "rate-nan": (lambda: LAW.rate([[NAN, 0.0]]), ("configurations", "nan", "finite")),
    "certificate-jets": (lambda: fjr.Certificate(LAW).along(*ROWS, np.zeros((3, 4, 2))), ("(3, 4, 2)", "(3, 5, 2)")),
    "certificate-u": (lambda: fjr.Certificate(LAW).along(*ROWS, np.zeros((3, 5, 2)), U), ("u has", "(2,)", "(3, 2)")),
    "step-dt": (lambda: fjr.Plant(ROBOT).step(X, U, [1e-3, 1e-3]), ("dt", "(2,)")),
    "hamiltonian": (lambda: ROBOT.hamiltonian(X[:4]), ("x ", "(4,)", "(8,)")),
    "hamiltonian-nan": (lambda: ROBOT.hamiltonian(np.full(8, NAN)), ("x ", "nan", "finite")),
    "state-q_l": (lambda: ROBOT.state([0, 0, 0], [0, 0], [0, 0], [0, 0]), ("q_l", "(3,)", "(2,)")),
    "state-nan": (lambda: ROBOT.state([0, NAN], [0, 0], [0, 0], [0, 0]), ("q_l", "nan", "finite")),
    "velocities": (lambda: ROBOT.velocities(X[:6]), ("x ", "(6,)", "(8,)")),
    "M_l": (lambda: ROBOT.M_l([0.0, 0.0, 0.0]), ("q_l", "(3,)", "(2,)")),
    "P_l": (lambda: ROBOT.P_l([INF, 0.0]), ("q_l", "inf", "finite")),
    "coriolis": (lambda: ROBOT.coriolis([0.0, 0.0], [0.0], [0.0, 0.0]), ("dq_l", "(1,)", "(2,)")),
}


@pytest.mark.parametrize("name", SHAPES)
def test_states_inputs_and_jets_of_the_wrong_shape_are_rejected(name: str) -> None:
    call, words = SHAPES[name]
    refused(fjr.StateError, call, *words)


def test_a_law_is_of_a_robot_and_its_gains() -> None:
    refused(fjr.RobotError, lambda: fjr.TrackingLaw(fjr.Plant(ROBOT), fjr.PAPER_GAINS), "robot is a Plant; expected")
    refused(fjr.GainsError, lambda: fjr.TrackingLaw(ROBOT, PAPER), "gains is a dict; expected gains")


@pytest.mark.parametrize("exact", [np.float64, np.float32, np.array], ids=["double", "single", "array"])
@pytest.mark.parametrize("name", ["sample_period", "inner_step", "delay", "duration"])
def test_a_time_may_be_any_kind_of_number(name: str, exact: Callable[[float], float]) -> None:
    """Powers of two are exact in single precision, so the runs are the same."""
    values = {"sample_period": 2.0**-10, "inner_step": 2.0**-11, "delay": 2.0**-11, "duration": 2.0**-6, "x0": X + 0.1}
    assert np.array_equal(run(**values | {name: exact(values[name])}).x, run(**values).x)


@pytest.mark.parametrize("period", [1e-3, None])
def test_a_complex_reference_is_rejected(period: float | None) -> None:
    class Motion:
        n = 2

        def jets(self, t: np.ndarray) -> np.ndarray:
            return np.full((*np.shape(t), 5, 2), 0.1j)

    refused(fjr.TrajectoryError, lambda: run(reference=Motion(), sample_period=period), "jets", "complex", "real")


@pytest.mark.parametrize("law", [LAW, RobustLaw(LAW, Robust(delay=1e-3))], ids=["static", "with a lead"])
def test_a_reference_of_single_times_is_rejected(law: SampledLaw) -> None:
    class Motion:
        n = 2

        def jets(self, t: np.ndarray) -> np.ndarray:
            return np.array([[np.sin(t)] * 2, [np.cos(t)] * 2, [-np.sin(t)] * 2, [-np.cos(t)] * 2, [np.sin(t)] * 2])

    words = "jets of the reference have shape (5, 2, 11) at 11 times; expected (11, 5, 2)"
    refused(fjr.TrajectoryError, lambda: run(law=law, reference=Motion()), words)


def test_divergence_is_reported_with_its_time() -> None:
    """The gains are far too stiff for the sample period."""
    law = fjr.TrackingLaw(ROBOT, fjr.Gains(**{**PAPER, "K_md": 300.0, "Lambda_m": 2000.0}))
    refused(fjr.StateError, lambda: run(law=law, x0=np.full(8, 0.1), duration=1.0), "diverged", "t = ")


def test_implicit_step_without_convergence_raises_an_fjr_error() -> None:
    """A million turns from zero, rounding alone exceeds the solver's tolerance."""
    plant = fjr.Plant(ROBOT, "implicit_midpoint")
    x = ROBOT.state(*np.full((4, 2), 1e12))
    refused(fjr.StateError, lambda: plant.step(x, U, 1e-3), "implicit_midpoint", "converge")


SCENARIO = """
/**:
  ros__parameters:
    joints: [joint1]
    robot: {model: single_link, joint_stiffness: [31.0], motor_inertia: [0.004], link_damping: [0.2]}
fjr_plant:
  ros__parameters: {publish_rate: 1000.0, initial_link_position: [0.5], compile: false, imperfections.state_delay: 0.0}
fjr_controller:
  ros__parameters:
    compile: false
    gains: {Lambda_l: [10.0], Pi_l: [20.0]}
    reference: {type: sine, amplitude: [1.0], frequency: [1.0]}
"""
ROBOT_FILE = (
    f"/**:\n  ros__parameters:\n    joints: {JOINTS}\n    robot: {{urdf: arm.urdf, joint_stiffness: {STIFFNESS}}}\n"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("hostile")
    assert load(made, SCENARIO) == "", "without a change the scenario must be valid"
    return made


def load(folder: Path, content: str | bytes) -> str:
    path = folder / "hostile.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))
    return answer(lambda: load_scenario(path))


@fuzzed(120)
@given(content=st.one_of(documents(yaml.safe_load(SCENARIO)), texts(SCENARIO)))
def test_scenarios_with_misplaced_values_or_arbitrary_bytes(folder: Path, content: str | bytes) -> None:
    load(folder, content)


@fuzzed(60)
@given(text=documents(yaml.safe_load(ROBOT_FILE)))
def test_robot_files(folder: Path, text: str) -> None:
    (folder / "arm.urdf").write_text(two_link_urdf())
    (folder / "robot.yaml").write_text(text)
    answer(lambda: robot_file.inlined(robot_file.merged({"robot.file": "robot.yaml"}, "fjr_plant", folder)))


HOSTILE = {
    "impossible date": ("a: 2024-13-45", ""),
    "tag without content": ("a: !!int", "line 1"),
    "timestamp without content": ("a: !!timestamp ''", "line 1"),
    "tag of another kind": ("a: !!bool maybe", "maybe"),
    "digits that are none": ("a: 0x_", "0x_"),
    "long integer": ("a: " + "9" * 5000, "5000 characters"),
    "long sexagesimal": ("a: " + ":".join(["59"] * 3000), "characters"),
    "open brackets": ("[" * 10_000, "nested"),
    "brackets": ("[" * 10_000 + "]" * 10_000, "nested"),
    "200 kB of levels": ("\n".join(" " * i + "a:" for i in range(630)), "nested"),
    "half a surrogate pair": (r'a: "\ud800"', "line 1, column 7"),
    "NUL": (r'a: "b\0c"', "U+0000"),
    "alias": ("a: &x [1.0]\nb: *x\n", "alias"),
    "twice": ("/**/fjr_controller: {a: 1}\n/**/fjr_controller: {b: 2}\n", "'/**/fjr_controller' twice"),
}


@pytest.mark.parametrize(("text", "words"), HOSTILE.values(), ids=HOSTILE)
def test_expensive_or_meaningless_yaml_is_rejected(text: str, words: str) -> None:
    sentence = answer(lambda: ros_yaml.parse(text))
    assert words in sentence
    assert bool(sentence) == bool(words)


def test_too_many_values_are_rejected_before_construction(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_yaml, "MAX_NODES", 100)
    assert "more than 100 values" in answer(lambda: ros_yaml.parse("[" + "1, " * 200 + "]"))


def test_a_special_file_does_not_block(folder: Path) -> None:
    os.mkfifo(folder / "pipe")
    for path in (folder / "pipe", "/dev/zero", folder, "a\0b", "\ud800", "x" * 5000):
        with pytest.raises(OSError, match=r".") as caught:
            text_file.read_text(path)
        assert caught.value.strerror
        assert answer(lambda path=path: fjr.robot_from_urdf(Path(path), ["a"], 1.0, 1.0))


def test_json_that_is_no_object_raises_value_error(folder: Path) -> None:
    for text in ("[" * 100_000, "[]", "{", '"a"', "\ud800"):
        path = folder / "some.json"
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        with pytest.raises(ValueError, match=r"."):
            text_file.read_json(path)


WORDS = ["0", "-1", "1e308", "nan", "inf", "", "1_0", "0x10", "a", "1 2", "prismatic", "floating", "\u0661", "x" * 999]


@st.composite
def urdfs(draw: st.DrawFn) -> str:
    """Return URDFs of the arm in which some attributes have another value."""
    pieces = two_link_urdf().split('"')
    for _ in range(draw(st.integers(1, 3))):
        place = 2 * draw(st.integers(0, len(pieces) // 2 - 1)) + 1
        pieces[place] = draw(st.sampled_from([*WORDS, *pieces[1::2]]))
    return '"'.join(pieces)


def build(urdf: object) -> str:
    return answer(lambda: fjr.robot_from_urdf(urdf, JOINTS, STIFFNESS, MOTOR_INERTIA))


@fuzzed(120)
@given(data=st.one_of(urdfs().map(str.encode), bytes_of(two_link_urdf().encode())))
def test_urdfs_with_misplaced_values_or_arbitrary_bytes(folder: Path, data: bytes) -> None:
    (folder / "some.urdf").write_bytes(data)
    build(folder / "some.urdf")


def test_xml_entity_expansion_is_rejected() -> None:
    entities = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(9))
    assert "document type" in build(f'<!DOCTYPE robot [<!ENTITY e0 "x">{entities}]><robot name="&e9;"/>')
    assert "nested" in build("<robot>" + "<a>" * 100_000)
