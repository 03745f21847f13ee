# SPDX-License-Identifier: Apache-2.0
"""The checker accepts certificates of proven rates, and refuses claims above the true rate and changed files."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr
from functools import cache, reduce
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tools.check_certificate import MATRICES, RefusedError, checked, main

from docs.pages import ROOT
from fjr_proofs.rate.proof_of_rate import proof_of_rate
from fjr_proofs.rate.rate_certificate import digest, rate_certificate
from proofs.rate.test_proven_rate import law_of

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


def beta_as_text(content: Certificate) -> None:
    content["beta"] = str(content["beta"])


def beta_true(content: Certificate) -> None:
    content["beta"] = True


def bodies_without_mass(content: Certificate) -> None:
    for body in content["bodies"]:
        body["mass"], body["inertia"] = 0.0, np.zeros((3, 3)).tolist()


def last_body_without_mass(content: Certificate) -> None:
    content["bodies"][-1] |= {"mass": 0.0, "inertia": np.zeros((3, 3)).tolist()}


def reflect(content: Certificate) -> None:
    content["bodies"][1]["rotation"] = (-np.array(content["bodies"][1]["rotation"])).tolist()


def escape_in_a_name(content: Certificate) -> None:
    content["joints"][0] = "joint\x1b[2J"


def entry_of_another_program(content: Certificate) -> None:
    content["\x1b[2J"] = 1.0


def twelve_joints(content: Certificate) -> None:
    content["bodies"] *= 4
    content["joints"] = [f"joint{k}" for k in range(12)]
    content["lower"], content["upper"] = content["lower"] * 4, content["upper"] * 4
    for name, value in content.items():
        if name in MATRICES:
            content[name] = np.kron(np.eye(4), np.array(value)).tolist()


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
    beta_as_text,
    beta_true,
    bodies_without_mass,
    last_body_without_mass,
    reflect,
    escape_in_a_name,
    entry_of_another_program,
    twelve_joints,
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


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths to all values in nested lists and objects."""
    for key in value if isinstance(value, dict) else range(len(value) if isinstance(value, list) else 0):
        yield (*path, key)
        yield from places(value[key], (*path, key))


@given(data=st.data())
def test_no_value_of_another_type_is_accepted_and_every_refusal_is_one_line(data: st.DataObject) -> None:
    content = certificate(2, 1)
    *path, last = data.draw(st.sampled_from([path for path in places(content) if path[0] != "sha256"]))
    owner = reduce(lambda value, key: value[key], path, content)
    others = [True, None, "1.0", "\x1b[2J", [], {}, float("nan"), float("inf"), -(10**400), [[1.0]], {"a": 1.0}]
    value = data.draw(st.sampled_from([each for each in others if type(each) is not type(owner[last]) or each != each]))
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
    body = {"prismatic": False, "rotation": np.eye(3).tolist(), "translation": [0.0, 0.0, 0.0], "com": [0.0, 0.0, 0.0]}
    turned = {**body, "rotation": [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]}
    sphere = {"mass": 1.0, "inertia": (0.1 * np.eye(3)).tolist()}
    unit, zero = np.eye(2).tolist(), np.zeros((2, 2)).tolist()
    content = {
        "format": "rate certificate 1",
        "joints": ["a", "b"],
        "bodies": [{**body, "mass": 0.0, "inertia": np.zeros((3, 3)).tolist()}, {**turned, **sphere}],
        **dict.fromkeys(("M_m", "Lambda_l", "Pi_l", "K_ld", "Lambda_m", "Pi_m", "K_md"), unit),
        **dict.fromkeys(("D_l", "D_m", "Gamma_l", "Gamma_m"), zero),
        "lower": [-1.0, -1.0],
        "upper": [1.0, 1.0],
        "beta": 0.9,
        "boxes": [0],
    }
    assert checked(sealed(content)) == 1


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
