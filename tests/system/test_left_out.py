# SPDX-License-Identifier: Apache-2.0
"""What may be missing, a package, Matplotlib or the C compiler: everything else runs, and what needs it names it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from build_wheels import PACKAGES
from fjr_msgs_py.console.ending import Exit
from system.executables import Start, fjr_here
from time_limits import HANG
from two_link_urdf import two_link_urdf

pytestmark = pytest.mark.system


def without(*packages: str) -> dict[str, str]:
    """Return the environment variables without the folders of packages on the Python path."""
    paths = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    kept = [path for path in paths if not any(package in Path(path).parts for package in packages)]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(kept)}


def python(code: str, env: dict[str, str], folder: Path, *arguments: str) -> tuple[int, str]:
    """Return exit code and output of a program."""
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, env=env, cwd=folder, capture_output=True, text=True, timeout=HANG, check=False)
    return done.returncode, done.stdout + done.stderr


PROGRAM = """
import sys
from fjr_bringup.cli.app import main
sys.stderr = sys.stdout
for line in sys.argv[1:]:
    print("|", int(main(line.split())))
"""


def fjr(folder: Path, *lines: str) -> list[tuple[int, str]]:
    """Return exit code and output of commands without identification, proofs and engines, run in one process."""
    _, said = python(PROGRAM, without("fjr_identification", "fjr_proofs", "fjr_engines"), folder, *lines)
    found = re.findall(r"(.*?)^\| (\d)$", said, re.DOTALL | re.MULTILINE)
    assert len(found) == len(lines), said
    return [(int(code), text) for text, code in found]


NEEDS = {
    "identify record.csv": (2, "fjr_identification"),
    "excite two_link": (2, "fjr_identification"),
    "check two_link --certificate rate.json": (1, "fjr_proofs"),
    "check paper_k31 --error payload=0.1": (1, "fjr_proofs"),
    "check paper_k31 --prove-sampled": (1, "fjr_proofs"),
    "gains two_link --beta 1 --proven": (1, "fjr_proofs"),
    "export-mjcf two_link arm.xml": (1, "fjr_engines"),
}


def test_without_identification_and_proofs_what_needs_them_names_them_and_the_rest_runs(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(two_link_urdf(), encoding="utf-8")
    found = fjr(tmp_path, *NEEDS, "new arm.urdf", "check arm.yaml", "gains two_link --beta 1", "--help")
    for (code, said), (status, package) in zip(found, NEEDS.values(), strict=False):
        assert (code, f"needs the package {package}, which is not installed" in said) == (status, True), said
    _, check, _, shown = rest = found[len(NEEDS) :]
    assert [code for code, _ in rest] == [0, 0, 0, 0], rest
    assert "near the reference" not in check[1]  # nothing is proven
    assert (" identify " in shown[1], " check " in shown[1]) == (False, True)


def test_the_core_runs_alone_and_names_the_package_of_a_name(tmp_path: Path) -> None:
    code = """
import fjr_core as fjr
from fjr_core.extensions.law_registry import LAWS
robot = fjr.single_link(stiffness=31.0)
law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
fjr.simulate(fjr.Plant(robot), law, fjr.Sine(1.0, 1.0), robot.state(0.5, 0.5, 0, 0), 0.1)
print(law.rate().proven, fjr.spectral_radius(law, 1e-3, configurations=[[0.5]])[0] < 1, list(LAWS))
for name in ("check", "testing", "synthesize", "diagnose", "Record", "Diagnosis"):
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
    packages = dict.fromkeys(("check", "testing", "synthesize"), "fjr_design")
    packages |= dict.fromkeys(("diagnose", "Record", "Diagnosis"), "fjr_monitor") | {"proven_rate": "fjr_proofs"}
    sentence = "{} this needs the package {}, which is not installed; expected it beside fjr_core"
    assert lines[1:] == [sentence.format(*each) for each in packages.items()]


IMPORT_ALL = """
import importlib, importlib.util, pkgutil, sys
sys.modules["matplotlib"] = None
left_out = () if importlib.util.find_spec("pydrake") else ("fjr_engines.drake",)
for package in sys.argv[1:]:
    for each in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        if each.name not in left_out:
            importlib.import_module(each.name)
"""


def test_every_module_loads_without_matplotlib(tmp_path: Path) -> None:
    status, said = python(IMPORT_ALL, dict(os.environ), tmp_path, *PACKAGES)
    assert status == 0, said


SENTENCE = (
    "no C compiler (no-such-cc) is on the path; expected one: apt-get install gcc libc6-dev, or pip install ziglang"
)


def test_run_and_node_without_a_compiler_end_with_the_sentence_and_write_nothing(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "no-such-cc")
    said = fjr_here("run", "paper_k31", "--duration", "1", "--output", str(tmp_path), code=Exit.FAILED)
    assert said.splitlines()[-1] == f"fjr: {SENTENCE}"
    assert not list(tmp_path.iterdir())
    code, said = start("controller").end()
    assert code == 1
    assert SENTENCE in said
    assert "Traceback" not in said
