# SPDX-License-Identifier: Apache-2.0
"""Proven rates equal the closed forms, are never above a rate that an adversarial search finds, and are close to it.

The checker accepts their certificates, and refuses claims above the true rate and changed files.
"""

from __future__ import annotations

import ast
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import redirect_stderr
from functools import cache, reduce
from io import StringIO
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import differential_evolution
from tools.check_certificate import MATRICES, RefusedError, checked, main

import fjr_core as fjr
from core.oracles.chains import arm7, random_chain, scaled_gains
from docs.pages import ROOT
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import JointLimits
from fjr_core.motions.domain import Domain, tube
from fjr_proofs.rate import digest, proof_of_rate, rate_certificate
from fuzzing import changed, places

CHECKER = ROOT / "tools" / "check_certificate.py"
Certificate = dict[str, Any]


def law_of(n: int, seed: int) -> TrackingLaw:
    """Return v-dPBC for a random chain: ranges up to the circle, gains in the shape of the inertia at one position."""
    links, rng = random_chain(n, seed).links, np.random.default_rng((n, seed, 3))
    half = np.array([0.4 if body.prismatic else rng.uniform(0.3, np.pi) for body in links.bodies])
    middle, free = rng.uniform(-1, 1, n), np.full(n, np.inf)
    limits = JointLimits(middle - half, middle + half, free, free)
    M = links.M_l(middle).full()
    one = np.eye(n)
    prismatic = tuple(body.prismatic for body in links.bodies)
    robot = fjr.Robot(links, one, 1e3 * one, 0.1 * np.diag(np.diag(M)), 0 * one, one, limits, prismatic)
    K_ld = 5 * (M + np.diag(np.diag(M)) * rng.uniform(0, 1))
    gains = fjr.Gains(Lambda_l=500.0, Pi_l=20.0, K_ld=K_ld, Lambda_m=500.0, Pi_m=60.0, K_md=500.0)
    return TrackingLaw(robot, gains)


def smallest_rate(law: TrackingLaw) -> float:
    """Return the smallest rate that a global search over the joint range finds."""
    limits = law.robot.limits
    assert limits is not None
    found = differential_evolution(
        lambda q: law.rate([q]).beta,
        list(zip(limits.lower, limits.upper, strict=True)),
        seed=0,
        popsize=5,
        maxiter=10 * law.robot.n,
        tol=1e-8,
    )
    return float(found.fun)


def test_proven_rates_are_never_above_those_of_an_adversarial_search_and_close_to_them() -> None:
    laws = [law_of(1 + k, k) for k in range(5)]
    proven = np.array([law.proven_rate(goal=0.9, most_boxes=200).beta for law in laws])
    found = np.array([smallest_rate(law) for law in laws])
    assert np.all(proven > 0)
    assert np.all(proven <= found)
    assert np.median(proven / found) >= 0.8


def test_rates_of_closed_forms_are_proven_with_their_value() -> None:
    for robot in (fjr.single_link(), fjr.planar_two_link()):
        law = fjr.TrackingLaw(robot, fjr.Gains(30.0, 20.0, 0.6, 30.0, 60.0, 0.3))
        exact, proven = law.rate(), law.proven_rate(goal=1 - 1e-8)
        assert exact.proven
        assert proven.proven
        for name in ("beta", "beta_paper", "beta_sigma_l"):
            assert getattr(exact, name) * (1 - 1e-6) <= getattr(proven, name) <= getattr(exact, name)


def test_rate_of_the_arm_is_proven_in_a_tube_around_a_motion() -> None:
    arm = arm7()
    law = fjr.TrackingLaw(arm.robot, scaled_gains(arm).gains)
    reference = fjr.Sine(0.3, np.pi, offset=[0.0, 0.5, 0.2, -1.2, -0.2, 0.8, 0.4])
    proven = law.proven_rate(tube(reference, 0.05), most_boxes=3)
    q_ld = reference.jets(np.linspace(0, 2, 50))[:, 0]
    inside = np.random.default_rng(0).uniform(q_ld - 0.05, q_ld + 0.05)
    assert proven.proven
    assert 0.5 * law.rate(q_ld).beta < proven.beta <= law.rate(inside).beta
    assert law.rate().proven is False


def test_an_early_end_returns_the_number_that_is_proven_by_then() -> None:
    law = law_of(3, 3)
    rates = [law.proven_rate(goal=0.99, most_boxes=boxes) for boxes in (1, 20, 400)]
    assert rates[0].beta <= rates[1].beta <= rates[2].beta
    assert all(rate.beta <= (rate.attained or 0) for rate in rates)


@pytest.mark.parametrize("bad", [Domain(np.ones(2), np.zeros(2)), Domain(np.zeros(3), np.ones(3))])
def test_a_bad_domain_is_refused(bad: Domain) -> None:
    with pytest.raises(fjr.StateError, match="expected"):
        fjr.TrackingLaw(fjr.planar_two_link(), fjr.PAPER_GAINS).proven_rate(bad)


def test_a_tube_contains_the_reference_and_its_radius() -> None:
    for reference in (
        fjr.Sine([0.3, 0.2], [1.0, 2.0]),
        fjr.Sine([0.3, 0.2], [1.0, np.sqrt(2)]),
        fjr.PointToPoint([0.0, 1.0], [1.0, -1.0], 1.0, 2.0),
    ):
        domain = tube(reference, 0.1)
        for q in reference.jets(np.linspace(0, 40, 400))[:, 0]:
            for corner in (q - 0.1, q + 0.1):
                assert np.all((domain.lower <= corner) & (corner <= domain.upper))
                near = [domain.lower, domain.upper] if domain.near is None else domain.near
                boxes = np.reshape(near, (-1, 2, 2))
                assert np.any(np.all((boxes[:, 0] <= corner) & (corner <= boxes[:, 1]), axis=1))


@cache
def certificate_text(n: int, seed: int) -> tuple[str, float]:
    """Return the certificate of a random chain as text, and the rate that a configuration attains [1/s]."""
    law = law_of(n, seed)
    proof = proof_of_rate(law.robot, law.gains, goal=0.99)
    names = [f"joint{k}" for k in range(n)]
    return json.dumps(rate_certificate(law.robot, law.gains, proof, names)), float(proof.rate.attained or 0)


def certificate(n: int = 3, seed: int = 2) -> Certificate:
    found: Certificate = json.loads(certificate_text(n, seed)[0])
    return found


def sealed(content: Certificate) -> Certificate:
    """Return a changed certificate with the digest of its content."""
    content = {name: value for name, value in content.items() if name != "sha256"}
    return {**content, "sha256": digest(content)}


@pytest.mark.parametrize("chain", [(1, 0), (2, 1), (3, 2), (3, 5), (4, 3)])
def test_certificates_of_proven_rates_are_accepted(chain: tuple[int, int]) -> None:
    content = certificate(*chain)
    leaves = sum(entry == 0 for entry in content["boxes"])
    assert checked(content) == leaves


@pytest.mark.parametrize("chain", [(1 + k % 3, k) for k in range(6)])
def test_a_claim_two_percent_above_the_attained_rate_is_refused(chain: tuple[int, int]) -> None:
    content, attained = certificate(*chain), certificate_text(*chain)[1]
    assert content["beta"] <= attained
    content["beta"] = 1.02 * attained
    with pytest.raises(RefusedError, match="not proven positive definite"):
        checked(sealed(content))


def times(factor: float) -> Callable[[Any], Any]:
    return lambda value: (factor * np.array(value)).tolist()


def with_a_cut_outside(content: Certificate) -> Certificate:
    split = next(entry for entry in content["boxes"] if entry)
    split[1] = content["upper"][split[0]] + 1.0
    return content


def of_twelve_joints(content: Certificate) -> Certificate:
    four = {name: np.kron(np.eye(4), np.array(content[name])).tolist() for name in MATRICES}
    repeated = {name: content[name] * 4 for name in ("bodies", "lower", "upper")}
    return content | four | repeated | {"joints": [f"joint{k}" for k in range(12)]}


MASSLESS = {"mass": 0.0, "inertia": np.zeros((3, 3)).tolist()}
CHANGES: dict[str, tuple[list[Any], Callable[[Any], Any]]] = {
    "a box less": (["boxes"], lambda boxes: [box for i, box in enumerate(boxes) if i != boxes.index(0)]),
    "one box": (["boxes"], lambda boxes: [0]),
    "a box more": (["boxes"], lambda boxes: [*boxes, 0]),
    "nothing and a box more": (["boxes"], lambda boxes: [*boxes, None, 0]),
    "a cut outside": ([], with_a_cut_outside),
    "a heavier body": (["bodies", -1, "mass"], times(1.2)),
    "a larger inertia": (["bodies", -1, "inertia"], lambda inertia: (np.array(inertia) + np.eye(3)).tolist()),
    "no mass": (["bodies"], lambda bodies: [body | MASSLESS for body in bodies]),
    "no mass at the tip": (["bodies", -1], lambda body: body | MASSLESS),
    "words for bodies": (["bodies"], lambda bodies: ["body"] * 3),
    "a sheared rotation": (["bodies", 1, "rotation", 0, 0], lambda value: value + 0.1),
    "a reflection": (["bodies", 1, "rotation"], times(-1.0)),
    "a lower K_ld": (["K_ld"], times(0.9)),
    "a skew K_ld": (["K_ld", 0, 1], lambda value: value + 0.01),
    "a lower K_md": (["K_md"], times(1e-3)),
    "a lower Lambda_m": (["Lambda_m"], times(1e-3)),
    "a negative Gamma_l": (["Gamma_l"], lambda Gamma: (-np.eye(3)).tolist()),
    "a cubic gain off a zero diagonal": (["Gamma_l"], lambda Gamma: [[1e12, 1.0, 0.0], [0.0] * 3, [0.0] * 3]),
    "a negative M_m": (["M_m"], times(-1.0)),
    "no Pi_l": ([], lambda content: {name: value for name, value in content.items() if name != "Pi_l"}),
    "nan in the range": (["upper", 1], lambda end: float("nan")),
    "an integer beyond all doubles": (["upper", 1], lambda end: 10**400),
    "a wider range": ([], lambda content: content | {"upper": [2.0 + end for end in content["upper"]]}),
    "an escape in a name": (["joints", 0], lambda name: "joint\x1b[2J"),
    "two joints of one name": (["joints", 1], lambda name: "joint0"),
    "an entry of another program": ([], lambda content: content | {"\x1b[2J": 1.0}),
    "twelve joints": ([], of_twelve_joints),
}


@pytest.mark.parametrize("change", CHANGES)
def test_changed_certificates_are_refused_by_digest_and_proof(change: str) -> None:
    path, new = CHANGES[change]
    content = changed(certificate(), path, new(reduce(getitem, path, certificate())))
    with pytest.raises(RefusedError):
        checked(sealed(content))
    with pytest.raises(RefusedError, match="sha256"):
        checked(content)


@given(data=st.data())
def test_no_value_of_another_type_is_accepted_and_every_refusal_is_one_line(data: st.DataObject) -> None:
    content = certificate(2, 1)
    *path, last = data.draw(st.sampled_from([path for path in places(content) if path[0] != "sha256"]))
    owner = reduce(getitem, path, content)
    others = [True, None, "1.0", "\x1b[2J", [], {}, float("nan"), float("inf"), -(10**400), [None], [[1.0]], {"a": 1.0}]
    value = data.draw(
        st.sampled_from([other for other in others if type(other) is not type(owner[last]) or other != other])
    )
    owner[last] = value
    with tempfile.TemporaryDirectory() as folder:
        file, said = Path(folder, "rate.json"), StringIO()
        file.write_text(json.dumps(sealed(content)))
        with redirect_stderr(said):
            assert main([str(file)]) == 1
    assert said.getvalue().rstrip("\n").isprintable()


def test_a_check_ends_after_its_time() -> None:
    with pytest.raises(RefusedError, match="not checked within 0 s"):
        checked(certificate(), seconds=0.0)


def test_a_body_without_inertia_is_accepted_where_the_others_prove_the_inertia_matrix() -> None:
    """A massless body between two joints whose axes cross, as of a universal joint; heavy and light parts differ."""
    sphere = {"mass": 1.0, "inertia": (0.1 * np.eye(3)).tolist()}
    assert checked(sealed(universal({"mass": 0.0, "inertia": np.zeros((3, 3)).tolist()}, sphere))) == 1


def test_an_inertia_that_is_negative_by_less_than_rounding_of_its_largest_entry_proves_no_inertia_matrix() -> None:
    """M_l is 0.5 - 1 where the second body turns about its axis of negative inertia."""
    first = {"mass": 1.0, "inertia": (0.5 * np.eye(3)).tolist()}
    second = {"mass": 1.0, "inertia": np.diag([2e12, -1.0, 2e12]).tolist()}
    content = universal(first, second) | {"beta": 0.5, "K_ld": np.diag([1e13, 1e13]).tolist()}
    with pytest.raises(RefusedError, match="M_l is not proven positive definite"):
        checked(sealed(content))


def universal(first: dict[str, Any], second: dict[str, Any]) -> Certificate:
    """Return the content of a certificate of two joints whose axes cross, with mass and inertia of the bodies."""
    body = {"prismatic": False, "rotation": np.eye(3).tolist(), "translation": [0.0, 0.0, 0.0], "com": [0.0, 0.0, 0.0]}
    turned = {**body, "rotation": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]}
    unit, zero = np.eye(2).tolist(), np.zeros((2, 2)).tolist()
    return {
        "format": "rate certificate 1",
        "joints": ["a", "b"],
        "bodies": [{**body, **first}, {**turned, **second}],
        **dict.fromkeys(("M_m", "Lambda_l", "Pi_l", "K_ld", "Lambda_m", "Pi_m", "K_md"), unit),
        **dict.fromkeys(("D_l", "D_m", "Gamma_l", "Gamma_m"), zero),
        "lower": [-1.0, -1.0],
        "upper": [1.0, 1.0],
        "beta": 0.9,
        "boxes": [0],
    }


def test_the_program_prints_one_sentence_and_returns_whether_the_rate_is_proven(tmp_path: Path) -> None:
    file = tmp_path / "rate.json"
    for content, code, said in (
        (certificate_text(2, 1)[0], 0, "proven: beta = "),
        ("{}", 1, "refused: sha256 is not the digest"),
        ("no JSON", 1, "refused: "),
        ('{"beta": 100.0, ' + certificate_text(2, 1)[0][1:], 1, "refused: an object has two entries of one name"),
    ):
        file.write_text(content)
        done = subprocess.run([sys.executable, CHECKER, file], capture_output=True, text=True)
        assert done.returncode == code
        assert said in done.stdout + done.stderr
        assert len((done.stdout + done.stderr).splitlines()) == 1


def test_the_checker_shares_no_code_with_the_prover() -> None:
    tree = ast.parse(CHECKER.read_text())
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    modules |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    assert not any("fjr" in (name or "fjr") for name in modules)
