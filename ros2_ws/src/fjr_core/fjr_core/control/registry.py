# SPDX-License-Identifier: Apache-2.0
"""Control laws by name: v-dPBC and the baselines it is compared with (docs/baselines.md)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..errors import ParameterError
from .baselines import backstepping, feedback_linearisation, lqr, pd_gravity, singular_perturbation, torque_feedback
from .static_law import StaticLaw
from .vdpbc import two_scale_gains
from .vdpbc.law import TrackingLaw

Standard = Callable[..., Any]
V_DPBC = "v_dpbc"


@dataclass(frozen=True)
class LawKind:
    """A control law by name.

    make: (robot, gains, compile=False) -> law. measures: the joint signals the law needs.
    standard: tuning rule (robot, configuration (n,), natural frequency [rad/s], damping ratio, sample period [s])
    -> gains. usual: default damping ratio; damping: its range.
    storage: description of V, "" if the law has no storage (V is nan). adds: extension that the paper does not have.
    """

    name: str
    title: str
    paper: str
    make: Callable[..., StaticLaw]
    measures: str
    storage: str
    standard: Standard
    usual: float = 0.7
    damping: tuple[float, float] = (0.5, 2.0)
    adds: str = ""


_ALL = "both sides"
_KINDS = (
    LawKind(
        V_DPBC,
        "v-dPBC",
        "Reyes-Baez, van der Schaft, Jayawardhana 2018",
        TrackingLaw,
        _ALL,
        "decays along every reference",
        two_scale_gains.standard,
        0.3,
        (0.1, 0.5),
    ),
    LawKind(
        "pd_gravity",
        "motor PD + gravity",
        "Tomei 1991",
        pd_gravity.PdGravity,
        "motor side",
        "decays for a constant reference",
        pd_gravity.standard,
    ),
    LawKind(
        "pd_feedforward",
        "motor PD + feedforward",
        "De Luca 2000",
        pd_gravity.PdFeedforward,
        "motor side",
        "decays for a constant reference",
        pd_gravity.standard,
        adds="inverse dynamics of the reference",
    ),
    LawKind(
        "singular_perturbation",
        "computed torque, singular perturbation",
        "Spong 1987",
        singular_perturbation.SingularPerturbation,
        "link side, motor velocity",
        "",
        singular_perturbation.standard,
    ),
    LawKind(
        "feedback_linearisation",
        "feedback linearisation",
        "Spong 1987, De Luca 2000",
        feedback_linearisation.FeedbackLinearisation,
        _ALL,
        "decays along every reference",
        feedback_linearisation.standard,
        1.0,
    ),
    LawKind(
        "backstepping",
        "integrator backstepping",
        "Brogliato, Ortega, Lozano 1995",
        backstepping.Backstepping,
        _ALL,
        "decays along every reference",
        backstepping.standard,
        1.0,
        (0.3, 2.0),
    ),
    LawKind(
        "torque_feedback",
        "torque feedback",
        "Albu-Schaeffer, Ott, Hirzinger 2007",
        torque_feedback.TorqueFeedback,
        "motor side, spring torque",
        "decays for a constant reference",
        torque_feedback.standard,
    ),
    LawKind(
        "torque_feedback_feedforward",
        "torque feedback + feedforward",
        "Albu-Schaeffer, Ott, Hirzinger 2007",
        torque_feedback.TorqueFeedbackFeedforward,
        "motor side, spring torque",
        "decays for a constant reference",
        torque_feedback.standard,
        adds="inverse dynamics of the reference",
    ),
    LawKind(
        "lqr",
        "LQR",
        "scipy.linalg.solve_continuous_are",
        lqr.Lqr,
        _ALL,
        "decays for small errors about one equilibrium",
        lqr.standard,
        1.0,
        (0.5**0.5, 2.0),
    ),
)
LAWS: dict[str, LawKind] = {kind.name: kind for kind in _KINDS}


def law_kind(name: str) -> LawKind:
    """Return the law of this name; raise ParameterError if unknown."""
    if name not in LAWS:
        raise ParameterError(f"law is {name!r}; expected one of {', '.join(LAWS)}")
    return LAWS[name]
