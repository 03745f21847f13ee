# SPDX-License-Identifier: Apache-2.0
"""Prove the rate of a scenario over the joint range; keep the proof in the cache of compiled code."""

from __future__ import annotations

import hashlib
import json
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.errors import FjrError, RobotError
from fjr_core.files.text_file import write_text
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.configuration_sampling import bounds_of, sample_configurations
from fjr_core.motions.domain import GOAL, Domain, tube
from fjr_core.numerics.checks import Array
from fjr_core.numerics.code_cache import cache_folder, code_folder, is_intact, read, write
from fjr_core.numerics.jit import program_digest
from fjr_core.numerics.one_line import at_least
from fjr_msgs_py.console.output import heartbeat, tell

from .rate import proof_of_rate, rate_certificate
from .verification.inertia_bounds import is_provable

PACKAGE = Path(__file__).parent
SAMPLES = 512  # configurations
DEFAULT_RADIUS = 0.1  # rad or m, of the tube around the reference if the tracking error has no limit


class ProofError(FjrError):
    """A rate that cannot be proven, or whose certificate cannot be written."""


@dataclass(frozen=True)
class CertifiedRate:
    """beta [1/s], proven over the joint range; attained [1/s] at the configuration `at`.

    complete: beta is at least GOAL times the attained rate. certificate: see rate_certificate.
    """

    beta: float
    beta_paper: float
    attained: float
    at: list[float]
    complete: bool
    certificate: dict[str, Any]


def near_reference(scenario: Scenario) -> tuple[Domain, Array]:
    """Return the tube around the reference with the largest tracking error (n,) that the controller accepts."""
    limit = np.asarray(scenario.settings.tracking_error)
    radius = np.where(np.isfinite(limit), limit, DEFAULT_RADIUS)
    return tube(scenario.reference, radius), radius


def refuse_unprovable(scenario: Scenario) -> None:
    """Raise ProofError if nothing can be proven about the inertia of the robot."""
    if not is_provable(scenario.robot):
        raise ProofError(
            f"scenario {scenario.name} has {scenario.robot.n} joints; expected at most 8 revolute joints for a proof"
        )


def cached_rate(scenario: Scenario) -> CertifiedRate | None:
    """Return the proven rate that an earlier command has kept for this law and robot; None if there is none.

    A kept proof that is not as it was written is emptied; one sentence says that it is not used.
    """
    try:
        kept = code_folder() / _name(scenario)
    except OSError:
        return None
    content = read(kept)
    if not content:
        return None
    if is_intact(kept):
        return CertifiedRate(**json.loads(content))
    with suppress(OSError):
        write(kept, b"")
    place = cache_folder() / kept.name
    tell(f"the kept proof {place} is changed or damaged; expected it as written: --certificate proves again")
    return None


def certified_rate(scenario: Scenario, seconds: float) -> CertifiedRate:
    """Return the proven rate, kept or proven now; after `seconds`, what is proven by then. Raises ProofError."""
    law = scenario.law
    if not isinstance(law, TrackingLaw):
        raise ProofError(f"law.type is {scenario.controller_values['law.type']!r}; expected 'v_dpbc' for a certificate")
    refuse_unprovable(scenario)
    known = cached_rate(scenario)
    if known is not None and known.complete:
        return known
    rates = filter(None, (known, _proven_within(scenario, law, seconds)))  # the known one may have had more time
    rate = max(rates, key=lambda each: each.beta)
    with suppress(OSError):
        write(code_folder() / _name(scenario), json.dumps(vars(rate)).encode())
    return rate


def write_certificate(rate: CertifiedRate, path: Path) -> None:
    """Write the certificate. Raises ProofError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(rate.certificate) + "\n")
    except OSError as error:
        raise ProofError(f"{path} cannot be written ({error.strerror}); expected a file in a writable folder") from None


def _proven_within(scenario: Scenario, law: TrackingLaw, seconds: float) -> CertifiedRate:
    """Prove the rate; report the number that is proven so far on standard error."""
    robot, state = scenario.robot, {"text": "proving a rate over the joint range"}
    end = time.monotonic() + seconds

    def watch(boxes: int, bound: float, attained: float) -> bool:
        state["text"] = f"proven {at_least(1 / bound)} of {1 / attained:.4g} 1/s for the links, {boxes} boxes"
        return time.monotonic() < end

    with heartbeat(lambda: state["text"]):
        try:
            proof = proof_of_rate(robot, law.gains, samples=sample_configurations(robot, SAMPLES), watch=watch)
        except RobotError as error:
            raise ProofError(str(error)) from None
    attained = float(proof.rate.attained or np.nan)
    return CertifiedRate(
        beta=proof.rate.beta,
        beta_paper=proof.rate.beta_paper,
        attained=attained,
        at=proof.inertia.at.tolist(),
        complete=proof.rate.beta >= GOAL * (1 - 1e-6) * attained,
        certificate=rate_certificate(robot, law.gains, proof, scenario.joints),
    )


def _name(scenario: Scenario) -> str:
    """Return the name of the kept file: a digest of program, robot, gains and joint range."""
    inputs = hashlib.sha256(program_digest(PACKAGE).encode() + scenario.robot.fingerprint())
    law = scenario.law
    assert isinstance(law, TrackingLaw)
    for array in (*law.gains.arrays().values(), *bounds_of(scenario.robot)):
        inputs.update(np.ascontiguousarray(array).tobytes())
    inputs.update(repr(scenario.joints).encode())
    return f"rate-{inputs.hexdigest()[:32]}.json"
