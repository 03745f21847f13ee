# SPDX-License-Identifier: Apache-2.0
"""Packages that may be left out: everything else runs, and what needs one of them names it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from time_limits import HANG

pytestmark = pytest.mark.system


def without(*packages: str) -> dict[str, str]:
    """Return the environment variables without the folders of packages on the Python path."""
    paths = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    kept = [path for path in paths if not any(package in Path(path).parts for package in packages)]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(kept)}


def python(code: str, env: dict[str, str], folder: Path) -> tuple[int, str]:
    """Return exit code and output of a program."""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=env, cwd=folder, capture_output=True, text=True, timeout=HANG, check=False)
    return done.returncode, done.stdout + done.stderr


def fjr(folder: Path, *arguments: str) -> tuple[int, str]:
    """Return exit code and output of a command without identification and proofs."""
    code = f"import sys; from fjr_bringup.cli.app import main; sys.exit(main({list(arguments)!r}))"
    return python(code, without("fjr_identification", "fjr_proofs"), folder)


def test_commands_run_without_identification_and_proofs(tmp_path: Path) -> None:
    status, said = fjr(tmp_path, "check", "arm7")
    assert status == 0, said
    assert "near the reference" not in said  # nothing is proven
    status, said = fjr(tmp_path, "gains", "two_link", "--beta", "1")
    assert status == 0, said
    status, said = fjr(tmp_path, "--help")
    assert (status, " identify " in said, " check " in said) == (0, False, True)


@pytest.mark.parametrize(
    ("arguments", "status", "package"),
    [
        (("identify", "record.csv"), 2, "fjr_identification"),
        (("excite", "two_link"), 2, "fjr_identification"),
        (("check", "two_link", "--certificate", "rate.json"), 1, "fjr_proofs"),
        (("check", "paper_k31", "--error", "payload=0.1"), 1, "fjr_proofs"),
        (("check", "paper_k31", "--prove-sampled"), 1, "fjr_proofs"),
        (("gains", "two_link", "--beta", "1", "--proven"), 1, "fjr_proofs"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else str(value),
)
def test_what_needs_a_package_names_it(arguments: tuple[str, ...], status: int, package: str, tmp_path: Path) -> None:
    seen, said = fjr(tmp_path, *arguments)
    assert (seen, f"needs the package {package}, which is not installed" in said) == (status, True), said


def test_the_core_runs_alone_and_names_the_package_of_a_name(tmp_path: Path) -> None:
    code = """
import fjr_core as fjr
from fjr_core.extensions.law_registry import LAWS
robot = fjr.single_link(stiffness=31.0)
law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
fjr.simulate(fjr.Plant(robot), law, fjr.Sine(1.0, 1.0), robot.state(0.5, 0.5, 0, 0), 0.1)
print(law.rate().proven, fjr.check(law, 1e-3).stable, list(LAWS))
for name in ("synthesize", "diagnose", "Record", "Diagnosis"):
    try:
        getattr(fjr, name)
    except fjr.FjrError as error:
        print(name, error)
try:
    law.proven_rate()
except fjr.FjrError as error:
    print("proven_rate", error)
"""
    above = ("fjr_design", "fjr_monitor", "fjr_identification", "fjr_proofs", "fjr_bringup")
    status, said = python(code, without(*above), tmp_path)
    assert status == 0, said
    lines = said.splitlines()
    assert lines[0] == "True True ['v_dpbc']"
    packages = {"synthesize": "fjr_design", "proven_rate": "fjr_proofs"}
    for name, line in zip(("synthesize", "diagnose", "Record", "Diagnosis", "proven_rate"), lines[1:], strict=True):
        package = packages.get(name, "fjr_monitor")
        assert line == f"{name} this needs the package {package}, which is not installed; expected it beside fjr_core"
