# SPDX-License-Identifier: Apache-2.0
"""Stiffnesses come with the deflections that were driven; of a joint too stiff for its encoders, a bound that holds."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fjr_design.uncertainty.posterior import IDENTIFIED, LOG, UNKNOWN, Estimate, Identification
from fjr_identification.estimation.estimation_problem import Estimation
from fjr_identification.estimation.filtered_fit import filtered_fit
from fjr_identification.estimation.lack_of_fit import Seen, deflections, seen, withheld
from fjr_identification.estimation.parameters import IdentifyOptions, Prior
from fjr_identification.estimation.verdicts import Estimates
from fjr_identification.page import springs_seen as lines
from physics.coverage import read
from physics.draws import Case, Draws, drawn
from physics.sensors import Encoder, Sensors

DRAWS = 3
STIFFER, NOISE = 1e5, 1e-5  # times as stiff; rad of the encoders


@cache
def draws() -> Draws:
    """Return draws of one joint, whose sides are read at once by exact encoders."""
    exact = Sensors(Encoder(0.0), Encoder(0.0))
    return drawn(Case(largest_skew=0.0, duration=4.0, sensors=exact), 1, DRAWS, 41)


def of_draw(i: int, stiffer: float = 1.0) -> Estimation:
    """Return the record of a draw, whose deflection is smaller by a factor, with noise of encoders."""
    record, nominal = read(draws(), i)
    offset, noise = draws().arm.offset[i], np.random.default_rng(i).normal(0.0, NOISE, (2, *record.q_l.shape))
    q_m = record.q_l + (record.q_m - record.q_l - offset) / stiffer + offset
    record = replace(record, q_l=record.q_l + noise[0], q_m=q_m + noise[1])
    return Estimation([record], nominal.robot, Prior.of(nominal.robot), IdentifyOptions(threads=1))


def bound(i: int, stiffer: float) -> float:
    """Return what the stiffness of a draw exceeds, 0 if it is known from both sides."""
    setup = of_draw(i, stiffer)
    return seen(setup, filtered_fit(setup, setup.coordinates.mean))["joint0"].at_least


@pytest.mark.parametrize("i", range(DRAWS))
def test_a_stiffness_comes_with_the_deflections_that_were_driven(i: int) -> None:
    setup, driven = of_draw(i), np.quantile(draws().deflections(i)[0], (0.01, 0.99))
    z = setup.coordinates.of_values({**setup.values, **draws().truth(i)})
    np.testing.assert_allclose(deflections(setup, z, 0), driven, atol=2 * NOISE)


@pytest.mark.parametrize("i", range(DRAWS))
def test_of_a_stiff_joint_a_lower_bound_is_known(i: int) -> None:
    K = float(draws().arm.stiffness[i, 0])
    assert 1e3 * K < bound(i, STIFFER) < STIFFER * K


@pytest.mark.parametrize("stiffer", [1e2, 1e3])
def test_a_compliance_is_right_though_it_deflects_by_less_than_linear_interpolation_errs(stiffer: float) -> None:
    assert all(bound(i, stiffer) == 0.0 for i in range(DRAWS))


def test_the_result_says_where_a_stiffness_was_seen_and_what_an_unknown_one_exceeds() -> None:
    setup, told = of_draw(0), []
    for verdict, least in ((IDENTIFIED, 1.5), (UNKNOWN, 2e7), (UNKNOWN, 0.0)):
        K = Estimate("joint_stiffness", "joint0", "N m/rad", 2.0, 1.0, 3.0, 2.0, verdict)
        z = setup.coordinates.of_values({**setup.values, **draws().truth(0)})
        told += withheld(setup, Estimates((K,), z, np.eye(1)), {"joint0": Seen("", least)}).estimates
    result = Identification(("joint0",), tuple(told), (0,), (LOG,), np.zeros(1), np.eye(1))
    again = Identification.from_dict(json.loads(json.dumps(result.as_dict())))
    low, high = (f"{1e3 * end:.3g}" for end in deflections(setup, z, 0))
    where = f"seen at deflections of {low} to {high} mrad"
    assert lines(again) == [f"joint_stiffness of joint0: {bound}{where}" for bound in ("", "at least 2e+07 N m/rad, ")]
