# SPDX-License-Identifier: Apache-2.0
"""The wheels of `make wheels` require what they import, hold what colcon installs, and run without a workspace."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import sysconfig
import venv
from email.parser import Parser
from pathlib import Path
from zipfile import ZipFile

import pytest

from build_wheels import PACKAGES, build
from envsetup import environment
from fjr_monitor.report.html import SCRIPT, STYLE, TEMPLATES
from time_limits import HANG

ROOT = Path(__file__).resolve().parents[2]
DISTRIBUTIONS = {"yaml": "pyyaml", "_cffi_backend": "cffi"}
"""Distributions of imported modules, where the names differ."""


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return all wheels by distribution."""
    return {path.name.partition("-")[0]: path for path in build(tmp_path_factory.mktemp("wheels"))}


def requirements(wheel: Path) -> tuple[list[str], list[str]]:
    """Return the requirements of a wheel without and with an extra."""
    with ZipFile(wheel) as archive:
        name = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        found = Parser().parsestr(archive.read(name).decode()).get_all("Requires-Dist", [])
    return [each for each in found if "extra ==" not in each], [each for each in found if "extra ==" in each]


def contents(wheel: Path) -> set[str]:
    """Return the files of a wheel by their place in an environment, without metadata."""
    with ZipFile(wheel) as archive:
        names = (re.sub(r"^[^/]+\.data/data/", "prefix/", name) for name in archive.namelist())
        return {name for name in names if ".dist-info/" not in name}


def top_level_imports(folder: Path) -> set[str]:
    """Return the first names of all absolute imports in a package, outside its own and the standard library."""
    found = set()
    for file in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
                found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names) - {folder.name}


def test_fjr_core_requires_what_it_imports(wheels: dict[str, Path]) -> None:
    always, extra = requirements(wheels["fjr_core"])
    imports = top_level_imports(ROOT / "ros2_ws" / "src" / "fjr_core" / "fjr_core")
    required = {environment.requirement_name(each) for each in always}
    assert required == {DISTRIBUTIONS.get(name, name) for name in imports} - {"matplotlib", "pyarrow"}
    assert {re.sub(r".*extra == [\"'](\w+)[\"']", r"\1", each) for each in extra} == {
        "sweep",
        "tables",
        "plot",
        "compiler",
        "all",
    }


def test_fjr_holds_the_files_of_all_packages_and_requires_what_they_do(wheels: dict[str, Path]) -> None:
    assert set(wheels) == {"fjr", *PACKAGES}
    held = contents(wheels["fjr"])
    assert held == set().union(*(contents(wheels[name]) for name in PACKAGES)) - {"prefix/bin/fjr"}  # pip writes it
    assert {f"fjr_monitor/{TEMPLATES}/{name}" for name in (SCRIPT, STYLE)} <= held  # of uPlot, without its wheel
    always, extra = requirements(wheels["fjr"])
    required = {environment.requirement_name(each): each for each in always}
    pinned = environment.pins((ROOT / "constraints.txt").read_text(encoding="utf-8"))
    ros = [name for name in required if name.startswith("ros-")]
    assert len(ros) == 2
    assert all(required[name].endswith(f"=={pinned[name]}") for name in ros)
    assert required.keys().isdisjoint({"uplot-python", "ipython", "ziglang", "pyarrow"})
    assert "jupyter-threejs-sage" in required
    for name, distribution in (("compiler", "ziglang"), ("tables", "pyarrow")):  # large: only with an extra
        assert [environment.requirement_name(each) for each in extra if f'"{name}"' in each] == [distribution]


@pytest.fixture(scope="module")
def installed(wheels: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an environment with the wheel `fjr`, which sees the other distributions of this environment."""
    path = tmp_path_factory.mktemp("environment")
    venv.create(path, with_pip=False, symlinks=True)
    packages = path / "lib" / f"python{sysconfig.get_python_version()}" / "site-packages"
    (packages / "tested.pth").write_text("\n".join(p for p in sys.path if p.endswith("-packages")), encoding="utf-8")
    options = ["--no-deps", "--no-index", "--quiet", "--disable-pip-version-check"]
    command = [sys.executable, "-m", "pip", "--python", str(path / "bin" / "python"), "install", *options]
    subprocess.run([*command, str(wheels["fjr"])], check=True, timeout=HANG)
    return path


def without_workspace() -> dict[str, str]:
    """Return the environment variables without the folders of the colcon workspace."""
    env = dict(os.environ)
    for name in ("AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH", "PATH", "PYTHONPATH"):
        kept = [path for path in env.pop(name, "").split(os.pathsep) if path and not path.startswith(str(ROOT))]
        if kept:
            env[name] = os.pathsep.join(kept)
    return env


@pytest.mark.system
@pytest.mark.slow
def test_command_and_nodes_run_from_the_wheel_alone(installed: Path, tmp_path: Path) -> None:
    def fjr(*arguments: str) -> str:
        command = [str(installed / "bin" / "fjr"), *arguments]
        done = subprocess.run(
            command, cwd=tmp_path, env=without_workspace(), capture_output=True, text=True, timeout=HANG, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    assert "paper_k31" in fjr("scenarios")
    assert fjr("--version").startswith("fjr ")
    fjr("run", "paper_k31", "--lockstep", "--duration", "0.2")
    report = tmp_path / "runs" / "paper_k31"
    assert (report / "report.json").is_file()
    assert (report / "report.html").is_file()
