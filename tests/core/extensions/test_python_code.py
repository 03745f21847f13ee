# SPDX-License-Identifier: Apache-2.0
"""Laws and plants in Python: the results of the same ones made of expressions, and refusals in one sentence."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest

import fjr_core as fjr
import own_code
from fjr_core.extensions.law_registry import law_kind
from fjr_core.extensions.python_code import own_law, own_plant
from fjr_core.files.importing import load, source_digest
from fjr_core.robust.law import Robust, sampled_law
from fjr_core.simulation.imperfections import Imperfections
from fjr_core.simulation.nonideal_plant import NonidealPlant
from fjr_core.stability.linear_controller import slope_at_rest
from fjr_design.batch import ClosedLoop, Draws
from fuzzing import refused

JOINT, ARM = fjr.single_link(stiffness=31.0), fjr.planar_two_link()
VDPBC = fjr.TrackingLaw(ARM, fjr.PAPER_GAINS)
OWN = fjr.PythonLaw(own_code.Wrapped(ARM), ARM)
MOTION = fjr.Sine([0.3, 0.2], [1.0, 2.0])
START = ARM.state([0.1, 0.0], [0.1, 0.0], [0.0, 0.0], [0.0, 0.0])
REACH = 0.05  # s


PLANT = own_plant("own_code:Ideal", ARM, {})


@pytest.mark.parametrize("period", [None, 1e-3])
@pytest.mark.parametrize(("plant", "law"), [(fjr.Plant(ARM), OWN), (PLANT, VDPBC)], ids=["law", "plant"])
def test_a_run_is_that_of_the_same_equations_made_of_expressions(
    plant: fjr.Plant, law: fjr.TrackingLaw, period: float | None
) -> None:
    expressions = fjr.Plant(ARM), VDPBC
    runs = [fjr.simulate(*loop, MOTION, START, REACH, period) for loop in (expressions, (plant, law))]
    for name in ("x", "u", "V"):
        np.testing.assert_allclose(getattr(runs[1], name), getattr(runs[0], name), rtol=1e-9, atol=1e-12)


def test_with_a_prediction_over_the_delay_a_run_is_that_of_the_same_law() -> None:
    robust = Robust(delay=1.3e-3, hold=1e-3)
    laws = [sampled_law(law, robust) for law in (VDPBC, OWN)]
    runs = [fjr.simulate(fjr.Plant(ARM), law, MOTION, START, REACH, 1e-3, delay=1.3e-3) for law in laws]
    np.testing.assert_allclose(runs[1].u, runs[0].u, rtol=1e-9, atol=1e-12)


def test_slopes_and_spectral_radius_are_those_of_the_same_law() -> None:
    q_l = np.array([0.3, -0.4])
    for own, exact in zip(slope_at_rest(OWN, q_l), slope_at_rest(VDPBC, q_l), strict=True):
        np.testing.assert_allclose(own, exact, rtol=1e-5, atol=1e-5 * np.abs(exact).max())
    radii = [fjr.spectral_radius(law, 1e-3, 5e-4, [q_l]) for law in (OWN, VDPBC)]
    np.testing.assert_allclose(radii[0], radii[1], rtol=1e-6)


@pytest.mark.parametrize(
    ("law", "plant", "changes"),
    [(OWN, None, {"stiffness": [1.0, 0.8, 1.2]}), (VDPBC, PLANT, {"link_torque": [0.0, 1.0, 0.5]})],
    ids=["law", "plant"],
)
def test_runs_of_a_study_are_those_of_the_compiled_loop(
    law: fjr.TrackingLaw, plant: fjr.Plant | None, changes: dict[str, list[float]]
) -> None:
    draws = Draws(3, delay=[0.0, 5e-4, 1.2e-3], coulomb_l=[0.0, 0.0, 0.05], **changes)
    loops = [
        ClosedLoop(ARM, sampled_law(of), MOTION, START, REACH, 1e-3, settle_after=0.01, plant=under)
        for of, under in ((VDPBC, None), (law, plant))
    ]
    compiled, own = (loop.run(draws) for loop in loops)
    assert [loop.in_python for loop in loops] == [False, True]
    for name in ("rms", "peak", "effort_peak", "power"):
        np.testing.assert_allclose(getattr(own, name), getattr(compiled, name), rtol=1e-8)
    if plant is not None:
        with pytest.raises(fjr.ParameterError, match="stiffness of a run is not nominal; expected the nominal value"):
            loops[1].run(Draws(1, stiffness=1.1))


def test_results_of_another_version_of_the_module_have_another_fingerprint(tmp_path, monkeypatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    fingerprints = []
    for gain in (1.0, 2.0):
        (tmp_path / f"versions_{gain:.0f}.py").write_text(
            "class Law:\n    def __init__(self, robot): pass\n"
            f"    def effort(self, q, v, jets): return -{gain} * q[1:]\n"
        )
        law = sampled_law(own_law(f"versions_{gain:.0f}:Law", JOINT, {}))
        loop = ClosedLoop(JOINT, law, fjr.Sine(0.1, 1.0), JOINT.state(0, 0, 0, 0), REACH, 1e-3, settle_after=0.01)
        fingerprints.append(loop.fingerprint)
    assert len(set(fingerprints)) == 2


def test_an_edit_of_what_the_module_imports_changes_the_digest_of_a_class(tmp_path, monkeypatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    package = tmp_path / "package_of_laws"
    package.mkdir()
    texts = {
        "package_of_laws/__init__.py": "",
        "package_of_laws/law.py": "from . import base\n\nclass Law(base.Base): pass\n",
        "package_of_laws/base.py": "from fjr_numbers_of_laws import K_p\n\nclass Base: pass\n",
        "fjr_numbers_of_laws.py": "K_p = 1.0\n",
        "other_law.py": "class Other: pass\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    kind, _ = load("package_of_laws.law:Law"), load("other_law:Other")
    before = {name: source_digest(kind) for name in ("", *texts)}
    for name, text in texts.items():
        (tmp_path / name).write_text(f"{text}# edited\n")
        before[name] = source_digest(kind)
    assert before["other_law.py"] == before["fjr_numbers_of_laws.py"]
    assert len(set(before.values())) == len(texts)


FAILS = fjr.PythonLaw(own_code.Fails(JOINT), JOINT)
FAR = fjr.Sine(1.0, 1.0), JOINT.state(0.8, 0.8, 0, 0), REACH
PLANT_FAILS = own_plant("own_code:PlantFails", JOINT, {})
FAILURES: dict[str, Callable[[], object]] = {
    "run": lambda: fjr.simulate(fjr.Plant(JOINT), FAILS, *FAR),
    "sampled run": lambda: fjr.simulate(fjr.Plant(JOINT), FAILS, *FAR, 1e-3),
    "study": lambda: ClosedLoop(JOINT, sampled_law(FAILS), *FAR, 1e-3, settle_after=0.01).run(Draws(1)),
    "stability check": lambda: fjr.spectral_radius(FAILS, 1e-3, 0.0, [[0.9]]),
    "plant": lambda: fjr.simulate(PLANT_FAILS, fjr.TrackingLaw(JOINT, fjr.PAPER_GAINS), *FAR, 1e-3),
}


@pytest.mark.parametrize("where", FAILURES)
def test_a_failure_is_one_sentence_with_file_and_line_and_reported_once(where: str) -> None:
    failure = r"Fails raises (ZeroDivision|Value)Error: too far \(own_code.py, line \d+\)"
    with pytest.raises(fjr.UserCodeError, match=rf"^(Plant)?{failure}"):
        FAILURES[where]()
    FAILS.raise_failure()


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Let SIGINT raise KeyboardInterrupt, whatever an earlier test of this process has set."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_ends_a_study_in_python_soon() -> None:
    class Interrupts:
        calls = 0

        def effort(self, position, velocity, jets):
            self.calls += 1
            if self.calls == 10:
                signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
            return 0 * position[:1]

    own, runs, duration = Interrupts(), 100, 10.0
    law = sampled_law(fjr.PythonLaw(own, JOINT))
    loop = ClosedLoop(JOINT, law, fjr.Sine(0.1, 1.0), JOINT.state(0, 0, 0, 0), duration, 1e-3)
    with pytest.raises(KeyboardInterrupt):
        loop.run(Draws(runs))
    assert own.calls < 0.1 * runs * duration / 1e-3


REFUSED = {
    "WrongShape": "u of WrongShape has shape (2,); expected (1,)",
    "Text": "u of Text is 'much'; expected numbers of shape (1,)",
    "Complex": "u of Complex is complex; expected real numbers of shape (1,)",
    "Counts": "u of Counts differs in a second evaluation; expected a pure function, without memory",
    "Noisy": "u of Noisy differs in a second evaluation",
    "Exits": "Exits raises SystemExit: enough (own_code.py, line",
    "NotFinite": "u of NotFinite is [inf] at rest at 0; expected finite numbers",
    "Changes": "Changes raises ValueError: output array is read-only (own_code.py, line",
    "WrongArguments": "WrongArguments.effort takes (x: ",
    "NoMethod": "NoMethod has no method effort; expected effort(position, velocity, jets)",
    "NoRobot": "NoRobot takes () ",
    "Refuses": "Refuses(...) raises KeyError: 'K_p' (own_code.py, line",
    "Missing": "module own_code has no class Missing; expected one",
    "Array": "module own_code has no class Array; expected one",
}


@pytest.mark.parametrize(("name", "sentence"), REFUSED.items(), ids=REFUSED)
def test_what_is_no_law_is_refused_in_one_sentence(name: str, sentence: str) -> None:
    assert refused(fjr.FjrError, lambda: own_law(f"own_code:{name}", JOINT, {})).startswith(sentence)


def test_a_law_may_stop_the_arm_by_an_exception_near_rest() -> None:
    assert isinstance(own_law("own_code:Stops", JOINT, {}), fjr.PythonLaw)


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        ("def f(:\n", "module {name} raises SyntaxError: invalid syntax"),
        ("import not_there_at_all\n", "module {name} cannot be imported: No module named 'not_there_at_all'"),
        ("1 / 0\n", "module {name} raises ZeroDivisionError: division by zero ({name}.py, line 1)"),
        (None, "module {name} of '{name}:Law' is not found; expected it on the Python path (PYTHONPATH) or in "),
    ],
    ids=["syntax", "missing import", "exception", "no file"],
)
def test_a_module_that_cannot_be_imported_is_refused_in_one_sentence(
    source: str | None, sentence: str, tmp_path, monkeypatch, request: pytest.FixtureRequest
) -> None:
    name = "module_" + request.node.callspec.id.replace(" ", "_")
    monkeypatch.chdir(tmp_path)
    if source is not None:
        (tmp_path / f"{name}.py").write_text(source)
    said = refused(fjr.ParameterError, lambda: own_law(f"{name}:Law", JOINT, {}))
    assert said.startswith(sentence.format(name=name))


def test_a_class_made_of_expressions_is_used_as_it_is() -> None:
    law = own_law("own_code:Symbolic", ARM, {"K_p": 50.0}, compile=True)
    assert isinstance(law, own_code.Symbolic)
    assert law.compiles
    assert not law.in_python


def test_the_registry_describes_a_law_of_the_user() -> None:
    kind = law_kind("own_code:Wrapped")
    assert (kind.name, kind.title, kind.storage) == ("own_code:Wrapped", "Wrapped", "given by the law")
    assert isinstance(kind.make(ARM, {"claimed": 0.5}), fjr.PythonLaw)
    with pytest.raises(fjr.GainsError, match="Wrapped has no tuning rule"):
        kind.tuning_rule(ARM, np.zeros(2), 20.0, 1.0)


def test_the_stop_policy_has_the_damping_of_the_law_or_of_the_springs() -> None:
    law = fjr.PythonLaw(own_code.Pd(ARM), ARM)
    np.testing.assert_allclose(law.hold_damping, np.sqrt(ARM.K * ARM.M_m))
    law.own.hold_damping = [1.0, 2.0]
    np.testing.assert_array_equal(fjr.PythonLaw(law.own, ARM).hold_damping, np.diag([1.0, 2.0]))
    law.own.hold_damping = [1.0, 2.0, 3.0]
    with pytest.raises(fjr.ParameterError, match=r"Pd.hold_damping has shape \(3,\); expected a scalar"):
        _ = fjr.PythonLaw(law.own, ARM).hold_damping


# The plant.


def test_options_change_the_motion_and_not_the_stability_check_which_is_that_of_the_model() -> None:
    damped = own_plant("own_code:Ideal", ARM, {"damping": 5.0})
    x, u = ARM.state([0.1, 0.2], [0.1, 0.2], [1.0, -1.0], [0.0, 0.0]), np.zeros(2)
    change = damped.derivative(x, u) - PLANT.derivative(x, u)
    np.testing.assert_allclose(change, [0, 0, 0, 0, -5.0, 5.0, 0, 0], atol=1e-12)
    at = [[0.3, 0.2]]
    assert fjr.spectral_radius(VDPBC, 1e-3, 0.0, at, damped) == fjr.spectral_radius(VDPBC, 1e-3, 0.0, at)


def test_friction_ripple_and_external_torques_act_as_on_the_same_equations() -> None:
    errors = Imperfections(
        2, coulomb_l=[0.1, 0.2], coulomb_m=0.05, ripple=0.01, ripple_periods=4.0, lag=1e-3, hysteresis=0.3
    )
    state = np.concatenate([START + 0.1, [1.0, 2.0], [5e-4, -2e-3]])
    plants = [NonidealPlant(plant) for plant in (fjr.Plant(ARM), PLANT)]
    steps = [plant.step(state, [3.0, 4.0], [0.5, 0.0], errors.vector, 2.5e-4) for plant in plants]
    np.testing.assert_allclose(steps[1], steps[0], rtol=1e-12, atol=1e-14)


def test_what_is_part_of_the_plant_itself_is_refused() -> None:
    for name in ("payload_mass", "cubic"):
        with pytest.raises(fjr.ParameterError, match=f"{name} is not 0 for a plant in Python"):
            NonidealPlant(PLANT).check(Imperfections(2, **{name: 1.0}))
    with pytest.raises(fjr.ParameterError, match="'implicit_midpoint'; expected 'rk4' for the plant Ideal"):
        own_plant("own_code:Ideal", ARM, {}, "implicit_midpoint")
    with pytest.raises(fjr.UserCodeError, match="dx of PlantCounts differs in a second evaluation; expected a pure"):
        own_plant("own_code:PlantCounts", ARM, {})
