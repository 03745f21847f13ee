# SPDX-License-Identifier: Apache-2.0
"""The checker accepts certificates of proven rates, and refuses claims above the true rate and changed files."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tools.check_certificate import RefusedError, checked

from core.control.test_proven_rate import law_of
from docs.pages import ROOT
from fjr_core.control.vdpbc.proof_of_rate import proof_of_rate
from fjr_core.control.vdpbc.rate_certificate import digest, rate_certificate

CHECKER = ROOT / "tools" / "check_certificate.py"
CHAINS = [(1 + k % 3, k) for k in range(20)]
Certificate = dict[str, Any]


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


@pytest.mark.parametrize("chain", CHAINS)
def test_a_claim_two_percent_above_the_attained_rate_is_refused(chain: tuple[int, int]) -> None:
    content, attained = certificate(*chain), certificate_text(*chain)[1]
    assert content["beta"] <= attained
    content["beta"] = 1.02 * attained
    with pytest.raises(RefusedError, match="not proven positive definite"):
        checked(sealed(content))


def raise_beta(content: Certificate) -> None:
    content["beta"] *= 1.02


def drop_a_box(content: Certificate) -> None:
    content["boxes"].remove(0)


def drop_all_boxes(content: Certificate) -> None:
    content["boxes"] = [0]


def move_a_cut_outside(content: Certificate) -> None:
    split = next(entry for entry in content["boxes"] if entry)
    split[1] = content["upper"][split[0]] + 1.0


def add_a_box(content: Certificate) -> None:
    content["boxes"].append(0)


def add_mass(content: Certificate) -> None:
    content["bodies"][-1]["mass"] *= 1.2


def add_inertia(content: Certificate) -> None:
    content["bodies"][-1]["inertia"] = (np.array(content["bodies"][-1]["inertia"]) + np.eye(3)).tolist()


def shear_a_rotation(content: Certificate) -> None:
    content["bodies"][1]["rotation"][0][0] += 0.1


def lower_K_ld(content: Certificate) -> None:
    content["K_ld"] = (0.9 * np.array(content["K_ld"])).tolist()


def skew_K_ld(content: Certificate) -> None:
    content["K_ld"][0][1] += 0.01


def lower_motor_damping(content: Certificate) -> None:
    content["K_md"] = (1e-3 * np.array(content["K_md"])).tolist()


def lower_Lambda_m(content: Certificate) -> None:
    content["Lambda_m"] = (1e-3 * np.array(content["Lambda_m"])).tolist()


def negative_motor_inertia(content: Certificate) -> None:
    content["M_m"] = (-np.array(content["M_m"])).tolist()


def negative_Gamma_l(content: Certificate) -> None:
    content["Gamma_l"] = (-np.eye(3)).tolist()


def nan_in_the_range(content: Certificate) -> None:
    content["upper"][1] = float("nan")


def integer_beyond_all_doubles(content: Certificate) -> None:
    content["upper"][1] = 10**400


def remove_gains(content: Certificate) -> None:
    del content["Pi_l"]


def words_for_numbers(content: Certificate) -> None:
    content["bodies"] = ["body"] * 3


CHANGES = [
    raise_beta,
    drop_a_box,
    drop_all_boxes,
    move_a_cut_outside,
    add_a_box,
    add_mass,
    add_inertia,
    shear_a_rotation,
    lower_K_ld,
    skew_K_ld,
    lower_motor_damping,
    lower_Lambda_m,
    negative_motor_inertia,
    negative_Gamma_l,
    nan_in_the_range,
    integer_beyond_all_doubles,
    remove_gains,
    words_for_numbers,
]


@pytest.mark.parametrize("change", CHANGES)
def test_changed_certificates_are_refused_by_digest_and_proof(
    change: Callable[[Certificate], None],
) -> None:
    content = certificate()
    change(content)
    with pytest.raises(RefusedError):
        checked(sealed(content))
    with pytest.raises(RefusedError, match="sha256"):
        checked(content)


@pytest.mark.parametrize("value", [None, "text", [], {}, [None], -1.0, [[0.5, 0.1]], [[1.0, 0.1], 0, 0]])
def test_values_of_a_wrong_kind_are_refused(value: object) -> None:
    for name in certificate():
        with pytest.raises(RefusedError):
            checked(sealed(certificate() | {name: value}) if name != "sha256" else certificate() | {name: value})
    for name in certificate()["bodies"][0]:
        content = certificate()
        if value is not content["bodies"][0][name]:
            content["bodies"][0][name] = value
            with pytest.raises(RefusedError):
                checked(sealed(content))


def test_a_wider_joint_range_is_refused() -> None:
    content = certificate()
    content["upper"] = [end + 0.3 for end in content["upper"]]
    content["lower"] = [end - 0.3 for end in content["lower"]]
    with pytest.raises(RefusedError, match="not proven positive definite"):
        checked(sealed(content))


def test_the_program_prints_one_sentence_and_returns_whether_the_rate_is_proven(tmp_path: Path) -> None:
    file = tmp_path / "rate.json"
    for content, code, said in (
        (certificate_text(2, 1)[0], 0, "proven: beta = "),
        ("{}", 1, "refused: sha256 is not the digest"),
        ("no JSON", 1, "refused: "),
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
