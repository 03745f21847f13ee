# SPDX-License-Identifier: Apache-2.0
"""The layout: imports run one way without circles, packages keep their budget, a module is one subject."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from docs.pages import ROOT

SOURCES = ROOT / "ros2_ws" / "src"
PACKAGES = (
    "fjr_core",
    "fjr_msgs_py",
    "fjr_monitor",
    "fjr_plant fjr_controller",
    "fjr_design",
    "fjr_identification fjr_proofs fjr_engines",
    "fjr_bringup",
)
"""Packages from the bottom up; packages in one entry do not import each other."""
LAYERS = {
    "fjr_core": (
        "errors version",
        "files",
        "numerics",
        "model",
        "urdf motions",
        "law",
        "robust extensions",
        "runtime",
        "stability simulation",
        "monitoring",
        "config",
    ),
    "fjr_msgs_py": ("names", "messages", "native", "node", "console", "scenarios"),
    "fjr_monitor": ("diagnosis scene", "recording", "report", "watch", "cli"),
    "fjr_plant": (
        "native",
        "channel engine",
        "simulated_robot",
        "host",
        "time_base",
        "lock_step",
        "plant_node",
        "executable",
    ),
    "fjr_controller": (
        "native reports",
        "certificate planner",
        "host trajectory_interface",
        "command_loop follow_action",
        "components",
        "controller_node",
        "executable",
    ),
    "fjr_design": (
        "batch testing",
        "stability baselines",
        "uncertainty",
        "tuning",
        "exports studies",
        "scaffold",
        "cli",
    ),
    "fjr_identification": (
        "estimation",
        "records excitation page robot_file",
        "cli",
    ),
    "fjr_proofs": ("verification", "rate error_bound", "kept_rate check_rows"),
    "fjr_engines": ("mjcf", "mujoco drake", "drawing", "film viewer"),
    "fjr_bringup": ("node_process clients", "runner", "cli"),
}
"""Folders and files of each package from the bottom up; a layer imports lower layers only, not its own neighbours."""


BUDGETS = {
    "fjr_core": 13_160,
    "fjr_msgs_py": 3_650,
    "fjr_monitor": 7_910,
    "fjr_plant": 1_380,
    "fjr_controller": 1_775,
    "fjr_design": 9_040,
    "fjr_identification": 6_000,
    "fjr_proofs": 4_020,
    "fjr_engines": 1_240,
    "fjr_bringup": 1_200,
}
"""Most lines of Python of each package. What needs more raises its budget in the same commit and says why."""
SUBJECT = (60, 390)
"""Least and most lines of a module."""
SHORT = {"errors", "executable", "version"}
"""Modules that are one thought; so are those in which a package begins (`__init__`)."""


def level(layers: tuple[str, ...], name: str) -> int | None:
    return next((i for i, entry in enumerate(layers) if name in entry.split()), None)


def modules(package: str) -> Iterator[tuple[str, Path]]:
    """Yield dotted name and file of each module of a package."""
    for file in sorted((SOURCES / package / package).rglob("*.py")):
        parts = file.relative_to(SOURCES / package).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), file


@cache
def imported(name: str, file: Path) -> list[str]:
    """Return the dotted names that a module imports, including names imported from a package."""
    package = name.split(".") if file.stem == "__init__" else name.split(".")[:-1]
    found: list[str] = []
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            found += (f"{module}.{alias.name}" for alias in node.names)
    return found


def upwards(layers: tuple[str, ...], importer: str, name: str) -> str | None:
    """Return a sentence if both names have a layer and the import does not run downwards."""
    here, there = level(layers, importer), level(layers, name)
    if here is None or there is None or importer == name or there < here:
        return None
    return f"{importer} (L{here}) imports {name} (L{there})"


def violations(package: str) -> list[str]:
    """Return one sentence for each import of a package that does not run downwards."""
    found = []
    for module, file in modules(package):
        for target in imported(module, file):
            top, _, rest = target.partition(".")
            if top == package and rest and "." in module:
                sentence = upwards(LAYERS[package], module.split(".")[1], rest.split(".")[0])
            else:
                sentence = upwards(PACKAGES, package, top)
            found += [f"{module}: {sentence}"] if sentence else []
    return found


@pytest.mark.parametrize("package", LAYERS)
def test_imports_run_downwards(package: str) -> None:
    assert violations(package) == []


@pytest.mark.parametrize("package", LAYERS)
def test_no_modules_import_each_other_in_a_circle(package: str) -> None:
    files = dict(modules(package))
    arrows: dict[str, set[str]] = {}
    for module, file in files.items():
        targets = {name if name in files else name.rpartition(".")[0] for name in imported(module, file)}
        arrows[module] = targets & files.keys() - {module}
    TopologicalSorter(arrows).prepare()  # raises CycleError with the circle


@pytest.mark.parametrize("package", LAYERS)
def test_every_module_has_a_layer(package: str) -> None:
    tops = {module.split(".")[1] for module, _ in modules(package) if "." in module}
    assert {top for top in tops if level(LAYERS[package], top) is None} == set()
    assert {name for entry in LAYERS[package] for name in entry.split()} == tops


def size(file: Path) -> int:
    return len(file.read_text(encoding="utf-8").splitlines())


@pytest.mark.parametrize("package", BUDGETS)
def test_a_package_keeps_its_budget(package: str) -> None:
    assert sum(size(file) for _, file in modules(package)) <= BUDGETS[package]


def test_a_module_is_one_subject() -> None:
    divided = ((name, file) for package in BUDGETS for name, file in modules(package))
    sizes = {name: size(file) for name, file in divided if file.stem not in SHORT | {"__init__"}}
    assert {name: lines for name, lines in sizes.items() if not SUBJECT[0] <= lines <= SUBJECT[1]} == {}


def test_no_two_public_classes_share_a_name() -> None:
    found: dict[str, list[str]] = {}
    for package in BUDGETS:
        for name, file in modules(package):
            for node in ast.parse(file.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    found.setdefault(node.name, []).append(name)
    assert {name: homes for name, homes in found.items() if len(homes) > 1} == {}
