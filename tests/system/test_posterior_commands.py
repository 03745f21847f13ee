# SPDX-License-Identifier: Apache-2.0
"""`fjr gains --from` and `fjr sweep` with the posterior of an identification."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fjr_design.uncertainty.posterior import IDENTIFIED, LOG, UNKNOWN, Estimate, Identification
from fjr_msgs_py.console.ending import Exit
from system.executables import fjr_here

pytestmark = pytest.mark.system
STIFFNESS, INERTIA = 31.0, 0.004


@pytest.fixture
def identified(tmp_path: Path) -> Path:
    """Write the posterior of the paper's joint, with a damping that is not identifiable."""
    values = {"joint_stiffness": STIFFNESS, "motor_inertia": INERTIA}
    estimates = [Estimate(k, "joint1", "", v, 0.9 * v, 1.1 * v, v, IDENTIFIED) for k, v in values.items()]
    estimates.append(Estimate("link_damping", "joint1", "", 0.2, 0.0, 1.0, 0.2, UNKNOWN, "the joint stands still"))
    mean, covariance = np.log([STIFFNESS, INERTIA]), np.array([[4e-4, 1e-4], [1e-4, 4e-4]])
    found = Identification(("joint1",), tuple(estimates), (0, 1), (LOG, LOG), mean, covariance)
    path = tmp_path / "identification.json"
    path.write_text(json.dumps(found.as_dict()), encoding="utf-8")
    return path


def test_gains_are_confirmed_on_fresh_draws_of_the_posterior(identified: Path) -> None:
    shown = fjr_here("gains", "paper_k31", "--beta", "5", "--from", f"{identified}", "--json")
    values, _ = json.JSONDecoder().raw_decode(shown)
    assert (values["fresh_draws"], values["lost_draws"], values["confidence"]) == (4603, 0, 0.99)
    assert values["largest_lost_share"] == pytest.approx(1e-3, rel=1e-3)
    assert values["not_drawn"] == ["link_damping of joint1"]
    assert "not identifiable, so not drawn: link_damping of joint1" in shown


def test_an_identification_of_other_joints_is_refused(identified: Path) -> None:
    shown = fjr_here("gains", "two_link", "--beta", "5", "--from", f"{identified}", code=Exit.NOT_UNDERSTOOD)
    assert "is of joints joint1; expected those of the scenario" in shown


def test_a_sweep_draws_from_the_posterior_next_to_it(identified: Path, tmp_path: Path) -> None:
    study = tmp_path / "study.yaml"
    study.write_text("{scenario: paper_k31, posterior: identification.json, runs: 20, duration: 1.5}", encoding="utf-8")
    shown = fjr_here("sweep", f"{study}", "--output", f"{tmp_path / 'sweeps'}")
    assert "20 runs succeed" in shown or "of 20 succeed" in shown
    assert "stiffness.joint1" in shown
