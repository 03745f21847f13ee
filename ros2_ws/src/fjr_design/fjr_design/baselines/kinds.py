# SPDX-License-Identifier: Apache-2.0
"""The baselines by name (docs/compare.md), for the entry points of the group `fjr.laws`."""

from __future__ import annotations

from dataclasses import replace

from fjr_core.extensions.law_registry import LawKind

from .active_disturbance import ActiveDisturbanceGains, ActiveDisturbanceRejection
from .backstepping import Backstepping, BacksteppingGains
from .elastic_structure import ElasticStructureGains, ElasticStructurePreserving
from .feedback_linearisation import CompositeGains, FeedbackLinearisation, LinearErrorGains, SingularPerturbation
from .friction_observer import FrictionObserver, FrictionObserverGains
from .lqr import Lqr, LqrGains
from .pd_gravity import PdFeedforward, PdGains, PdGravity
from .torque_feedback import TorqueFeedback, TorqueFeedbackFeedforward, TorqueFeedbackGains

_AT_REST, _FEEDFORWARD = "decays for a constant reference", "inverse dynamics of the reference"
_PD = LawKind("pd_gravity", "motor PD + gravity", "Tomei 1991", PdGravity, PdGains.standard, "motor side", _AT_REST)
_TORQUE_FEEDBACK = LawKind(
    name="torque_feedback",
    title="torque feedback",
    paper="Albu-Schaeffer, Ott, Hirzinger 2007",
    make=TorqueFeedback,
    tuning_rule=TorqueFeedbackGains.standard,
    measures="motor side, spring torque",
    storage=_AT_REST,
    scaled=("M_theta",),
)
BASELINES = (
    _PD,
    replace(
        _PD,
        name="pd_feedforward",
        title="motor PD + feedforward",
        paper="De Luca 2000",
        make=PdFeedforward,
        extension=_FEEDFORWARD,
    ),
    LawKind(
        name="singular_perturbation",
        title="computed torque, singular perturbation",
        paper="Spong 1987",
        make=SingularPerturbation,
        tuning_rule=CompositeGains.standard,
        measures="link side, motor velocity",
        storage="",
        scaled=("K_v",),
    ),
    LawKind(
        name="feedback_linearisation",
        title="feedback linearisation",
        paper="Spong 1987, De Luca 2000",
        make=FeedbackLinearisation,
        tuning_rule=LinearErrorGains.standard,
        default_damping=1.0,
        scaled=("A_1", "A_2", "A_3"),
    ),
    LawKind(
        name="backstepping",
        title="integrator backstepping",
        paper="Brogliato, Ortega, Lozano 1995",
        make=Backstepping,
        tuning_rule=BacksteppingGains.standard,
        default_damping=1.0,
        damping_range=(0.3, 2.0),
        scaled=("K_1", "c_2"),
    ),
    _TORQUE_FEEDBACK,
    replace(
        _TORQUE_FEEDBACK,
        name="torque_feedback_feedforward",
        title="torque feedback + feedforward",
        make=TorqueFeedbackFeedforward,
        extension=_FEEDFORWARD,
    ),
    LawKind(
        name="lqr",
        title="LQR",
        paper="Anderson, Moore 1990",
        make=Lqr,
        tuning_rule=LqrGains.standard,
        storage="decays for small errors about one equilibrium",
        default_damping=1.0,
        damping_range=(0.5**0.5, 2.0),
        scaled=("R",),
    ),
    LawKind(
        name="elastic_structure",
        title="elastic structure preserving",
        paper="Keppler, Lakatos, Ott, Albu-Schaeffer 2018",
        make=ElasticStructurePreserving,
        tuning_rule=ElasticStructureGains.standard,
        damping_range=(0.2, 2.0),
        scaled=("D_eta",),
    ),
    LawKind(
        name="friction_observer",
        title="friction observer",
        paper="Kim, Beck, Ott, Albu-Schaeffer 2019",
        make=FrictionObserver,
        tuning_rule=FrictionObserverGains.standard,
        measures="motor side, spring torque",
        storage=_AT_REST,
        extension=_FEEDFORWARD,
        scaled=("L", "L_p"),
    ),
    LawKind(
        name="active_disturbance",
        title="active disturbance rejection",
        paper="Han 2009, Gao 2003",
        make=ActiveDisturbanceRejection,
        tuning_rule=ActiveDisturbanceGains.standard,
        measures="positions of both sides",
        storage="",
        extension=_FEEDFORWARD,
        default_damping=1.0,
        scaled=("A_1", "A_2", "A_3", "bandwidth"),
    ),
)
