# SPDX-License-Identifier: Apache-2.0
"""Control laws by name: v-dPBC and the baselines it is compared with (docs/baselines.md)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainsError, ParameterError
from ..files.python_class import is_named, load
from .baselines import backstepping, feedback_linearisation, lqr, pd_gravity, singular_perturbation, torque_feedback
from .python_law import own_law
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
    -> gains. usual: default damping ratio; damping: its range. The gains of a law of the user are options: no rule.
    storage: description of V, "" if the law has no storage (V is nan). adds: extension that the paper does not have.
    scaled: gains, by their names, that `fjr tune` scales; for a law with a tuning rule in addition to its two numbers.
    """

    name: str
    title: str
    paper: str
    make: Callable[..., StaticLaw]
    standard: Standard
    measures: str = "both sides"
    storage: str = "decays along every reference"
    usual: float = 0.7
    damping: tuple[float, float] = (0.5, 2.0)
    adds: str = ""
    scaled: tuple[str, ...] = ()

    def scaled_gains(self, gains: Any, factors: ArrayLike) -> Any:
        """Return the gains with those of `scaled` multiplied by factors: one for all, or one for each.

        Raises GainsError for another number of factors or one that is not positive.
        """
        given = np.ravel(np.asarray(factors, dtype=float))
        if len(given) not in (1, len(self.scaled)) or not np.all(given > 0):
            names = ", ".join(self.scaled) or "no gain"
            raise GainsError(f"the gain factors are {given.tolist()}; expected 1, or positive ones for {names}")
        each = zip(self.scaled, np.broadcast_to(given, len(self.scaled)), strict=True)
        return replace(gains, **{name: factor * np.asarray(getattr(gains, name)) for name, factor in each})


_AT_REST = "decays for a constant reference"
_KINDS = (
    LawKind(
        V_DPBC,
        "v-dPBC",
        "Reyes-Baez, van der Schaft, Jayawardhana 2018",
        TrackingLaw,
        two_scale_gains.standard,
        usual=0.3,
        damping=(0.1, 0.5),
        scaled=("Lambda_l", "Pi_l", "K_ld", "Lambda_m", "Pi_m", "K_md"),
    ),
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


def _own_kind(name: str) -> LawKind:
    """Return the description of a law of the user, module:Class, whose gains are its options."""
    title, storage = load(name).__name__, "given by the law" if hasattr(load(name), "storage") else ""

    def not_tuned(*_: Any) -> Any:
        raise GainsError(f"{title} has no tuning rule; expected its options instead")

    return LawKind(name, title, "law of the user", partial(own_law, name), not_tuned, storage=storage)


LAWS: dict[str, LawKind] = {kind.name: kind for kind in _KINDS}


def law_kind(name: str) -> LawKind:
    """Return the law of this name, also of a class module:Class; raise ParameterError if unknown."""
    if is_named(name):
        return _own_kind(name)
    if name not in LAWS:
        raise ParameterError(f"law is {name!r}; expected one of {', '.join(LAWS)}")
    return LAWS[name]
