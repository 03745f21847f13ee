# SPDX-License-Identifier: Apache-2.0
"""Trajectory.plot draws what the run holds, and says what is missing where Matplotlib is not installed."""

from __future__ import annotations

import sys
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.model.robot import PRISMATIC, REVOLUTE
from fjr_core.simulation.plot import PlotError

mpl.use("Agg")


@pytest.fixture(scope="module")
def run() -> fjr.Trajectory:
    arm = fjr.planar_two_link()
    law = fjr.TrackingLaw(arm, fjr.PAPER_GAINS)
    return fjr.simulate(fjr.Plant(arm), law, fjr.Sine([0.1, 0.2], 1.0), arm.state(*np.zeros((4, 2))), 0.05, 1e-3)


def test_lines_are_the_arrays_of_the_run(run: fjr.Trajectory) -> None:
    axes = {each.get_ylabel(): each for each in run.plot().axes}
    drawn = {label: np.array([line.get_ydata() for line in each.lines]).T for label, each in axes.items()}
    q_l, q_ld = run.x[:, :2], run.jets[:, 0]
    np.testing.assert_array_equal(drawn["q_l [rad]"], np.hstack([q_l, q_ld]))
    np.testing.assert_array_equal(drawn["q_l - q_ld [rad]"], q_l - q_ld)
    np.testing.assert_array_equal(drawn["u [N m]"], run.u)
    np.testing.assert_array_equal(drawn["V [J]"], run.V[:, None])
    assert all(np.array_equal(line.get_xdata(), run.t) for each in axes.values() for line in each.lines)


def test_labels_name_the_units_of_all_joints(run: fjr.Trajectory) -> None:
    lift = replace(run, units=(PRISMATIC, REVOLUTE))
    labels = {each.get_ylabel() for each in lift.plot().axes}
    assert labels == {"q_l [m, rad]", "q_l - q_ld [m, rad]", "u [N, N m]", "V [J]"}


def test_missing_matplotlib_is_one_sentence(run: fjr.Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(PlotError, match="pip install matplotlib"):
        run.plot()
