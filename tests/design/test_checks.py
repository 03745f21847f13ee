# SPDX-License-Identifier: Apache-2.0
"""The test kit finds each fault of a law or a plant, in one sentence, and none in what is correct."""

from __future__ import annotations

import pytest

import fjr_core as fjr
import own_code
from fjr_core.extensions.law_registry import LAWS

JOINT, ARM = fjr.single_link(stiffness=31.0), fjr.planar_two_link()
DECAYS = "V decays at least as exp(-2 rate t), rate "


@pytest.mark.parametrize("robot", [JOINT, ARM], ids=["one joint", "two joints"])
def test_a_correct_law_passes_with_its_certificate(robot: fjr.Robot) -> None:
    for law in (fjr.TrackingLaw(robot, fjr.PAPER_GAINS), own_code.Wrapped(robot)):
        holds = fjr.testing.check_law(law, robot)
        assert holds[0] == f"u ({robot.n},) is finite at 64 states"
        assert holds[1:3] == ("the result depends on the arguments only", "V is 0 or more")
        assert holds[3].startswith(DECAYS)
    assert len(fjr.testing.check_law(own_code.Pd(robot))) == 2  # without a storage


def test_built_in_laws_pass() -> None:
    for name, kind in LAWS.items():
        law = kind.make(JOINT, kind.tuning_rule(JOINT, [0.0], 20.0, kind.default_damping, 1e-3))
        assert len(fjr.testing.check_law(law)) == (4 if name == "v_dpbc" else 3 if kind.storage else 2)


class Rising(own_code.Pd):
    rate = 1.0

    def storage(self, position, velocity, jets) -> float:
        return float(position @ position)


class Negative(own_code.Pd):
    def storage(self, position, velocity, jets) -> float:
        return float(position[0])


class Infinite(Rising):
    def storage(self, position, velocity, jets) -> float:
        return float("inf")


class BadRate(Rising):
    rate = -1.0


class FastExpressions(own_code.Symbolic):
    rate = 100.0


class Driving(own_code.Wrapped):
    hold_damping = -0.3


class NoDamping(own_code.Wrapped):
    hold_damping = "some"


FAULTY_LAWS = {
    "a damping that drives": (Driving(JOINT), "hold_damping is [[-0.3]]; expected no negative eigenvalue"),
    "no damping": (NoDamping(JOINT), "NoDamping.hold_damping is 'some'; expected numbers"),
    "a rate too high": (own_code.Wrapped(JOINT, claimed=100.0), "expected at most -2 rate V = "),
    "a rate too high of a law of expressions": (FastExpressions(JOINT), "expected at most -2 rate V = "),
    "V that rises": (Rising(JOINT), "dV/dt is "),
    "V without a rate of change": (Infinite(JOINT), "dV/dt is nan W at q_l = "),
    "V below 0": (Negative(JOINT), "expected 0 or more"),
    "a rate below 0": (BadRate(JOINT), "rate is -1.0; expected a positive number"),
    "memory": (own_code.Counts(JOINT), "expected a pure function, without memory"),
    "not finite": (own_code.NanBeyond(JOINT), "u is not finite at q_l = "),
    "an exception": (own_code.Fails(JOINT), "Fails raises ZeroDivisionError: too far (own_code.py, line "),
    "no law": (own_code.WrongShape(JOINT), "u of WrongShape has shape (2,); expected (1,)"),
}


@pytest.mark.parametrize(("law", "words"), FAULTY_LAWS.values(), ids=FAULTY_LAWS)
def test_each_fault_of_a_law_is_one_sentence(law: object, words: str) -> None:
    with pytest.raises(fjr.testing.CheckError) as found:
        fjr.testing.check_law(law, JOINT)
    (fault,) = found.value.faults
    assert words in fault
    assert str(found.value) == f"{type(law).__name__}: {fault}"


def test_a_correct_plant_passes_with_its_power_balance() -> None:
    for plant in (fjr.Plant(ARM), own_code.Ideal(ARM), own_code.Ideal(ARM, damping=2.0)):
        holds = fjr.testing.check_plant(plant)
        assert holds[0] == "dx (8,) is finite at 64 states"
        assert holds[-1] == "dH/dt is at most the power of the motors"


FAULTY_PLANTS = {
    "energy from nothing": (own_code.Ideal(ARM, damping=-20.0), "where the motors supply "),
    "momenta as velocities": (own_code.OtherVelocities(ARM), "from the velocities of x at q_l = "),
    "an exception": (own_code.PlantFails(ARM), "PlantFails raises ValueError: too far (own_code.py, line "),
    "no plant": (own_code.NoMethod(ARM), "NoMethod has no method derivative; expected derivative(x, u)"),
}


@pytest.mark.parametrize(("plant", "words"), FAULTY_PLANTS.values(), ids=FAULTY_PLANTS)
def test_each_fault_of_a_plant_is_one_sentence(plant: object, words: str) -> None:
    with pytest.raises(fjr.testing.CheckError, match="^" + type(plant).__name__) as found:
        fjr.testing.check_plant(plant, ARM)
    (fault,) = found.value.faults
    assert words in fault


def test_without_a_robot_nothing_is_checked() -> None:
    with pytest.raises(fjr.ParameterError, match=r"object has no robot; expected check_law\(law, robot\)"):
        fjr.testing.check_law(object())
    with pytest.raises(fjr.ParameterError, match=r"object has no robot; expected check_plant\(plant, robot\)"):
        fjr.testing.check_plant(object())
