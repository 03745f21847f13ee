# SPDX-License-Identifier: Apache-2.0
"""The baselines by name (docs/compare.md), for the entry points of the group `fjr.laws`."""

from __future__ import annotations

from fjr_core.law.registry import LawKind

from . import backstepping, feedback_linearisation, lqr, pd_gravity, singular_perturbation, torque_feedback

_AT_REST = "decays for a constant reference"
BASELINES = (
    LawKind(
        "pd_gravity",
        "motor PD + gravity",
        "Tomei 1991",
        pd_gravity.PdGravity,
        pd_gravity.standard,
        "motor side",
        _AT_REST,
    ),
    LawKind(
        "pd_feedforward",
        "motor PD + feedforward",
        "De Luca 2000",
        pd_gravity.PdFeedforward,
        pd_gravity.standard,
        "motor side",
        _AT_REST,
        adds="inverse dynamics of the reference",
    ),
    LawKind(
        "singular_perturbation",
        "computed torque, singular perturbation",
        "Spong 1987",
        singular_perturbation.SingularPerturbation,
        singular_perturbation.standard,
        "link side, motor velocity",
        storage="",
        scaled=("K_v",),
    ),
    LawKind(
        "feedback_linearisation",
        "feedback linearisation",
        "Spong 1987, De Luca 2000",
        feedback_linearisation.FeedbackLinearisation,
        feedback_linearisation.standard,
        usual=1.0,
        scaled=("A_1", "A_2", "A_3"),
    ),
    LawKind(
        "backstepping",
        "integrator backstepping",
        "Brogliato, Ortega, Lozano 1995",
        backstepping.Backstepping,
        backstepping.standard,
        usual=1.0,
        damping=(0.3, 2.0),
        scaled=("K_1", "c_2"),
    ),
    LawKind(
        "torque_feedback",
        "torque feedback",
        "Albu-Schaeffer, Ott, Hirzinger 2007",
        torque_feedback.TorqueFeedback,
        torque_feedback.standard,
        "motor side, spring torque",
        _AT_REST,
        scaled=("M_theta",),
    ),
    LawKind(
        "torque_feedback_feedforward",
        "torque feedback + feedforward",
        "Albu-Schaeffer, Ott, Hirzinger 2007",
        torque_feedback.TorqueFeedbackFeedforward,
        torque_feedback.standard,
        "motor side, spring torque",
        _AT_REST,
        adds="inverse dynamics of the reference",
        scaled=("M_theta",),
    ),
    LawKind(
        "lqr",
        "LQR",
        "scipy.linalg.solve_continuous_are",
        lqr.Lqr,
        lqr.standard,
        storage="decays for small errors about one equilibrium",
        usual=1.0,
        damping=(0.5**0.5, 2.0),
        scaled=("R",),
    ),
)
