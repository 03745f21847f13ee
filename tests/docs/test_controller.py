# SPDX-License-Identifier: Apache-2.0
"""The C++ controller of docs/export_c.md tracks the exported plant like the Python controller, and stops."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from core.codegen.c_program import C99, CPP, SCENARIOS, built, exported, loop, program_output
from docs.pages import ROOT, Block, blocks
from fjr_core.config.scenario import load_scenario

HERE = Path(__file__).with_name("ros2_control")
PAGE = ROOT / "docs" / "export_c.md"


def block_of(file: str) -> Block:
    return next(block for block in blocks(PAGE) if block.marks.get("file") == f"my_controller/{file}")


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the output of the driver of the controller."""
    folder = exported(loop("paper_k31"), tmp_path_factory.mktemp("controller") / "paper_k31")
    source = folder.with_name("controller.cpp")
    source.write_text(block_of("flexible_joint_controller.cpp").text, encoding="utf-8")
    where = f"-I{HERE / 'include'}", f"-I{folder}", "-c"
    objects = [built(C99, [file], file.with_suffix(".o"), "-c") for file in folder.glob("paper_k31*.c")]
    seam = "-Dpaper_k31_reference=reference_of_the_test"
    objects += [built(CPP, [source], source.with_suffix(".o"), *where, seam)]
    objects += [built(CPP, [HERE / "drive.cpp"], folder.with_name("drive.o"), *where)]
    return program_output(built(CPP, objects, folder.with_name("drive")))


@pytest.fixture(scope="module")
def values(driven: str) -> dict[str, float]:
    """Return the numbers of the output by name."""
    pairs = (line.split() for line in driven.splitlines())
    return {pair[0]: float(pair[1]) for pair in pairs if len(pair) == 2}


def test_tracks_like_the_python_controller(values: dict[str, float]) -> None:
    run = load_scenario(SCENARIOS / "paper_k31.yaml").simulate(4.0)
    late = run.t >= 2.0
    assert values["first_effort"] == pytest.approx(run.u[0, 0], rel=1e-12)
    assert values["worst_error"] == pytest.approx(np.abs(run.x[late, 0] - run.jets[late, 0, 0]).max(), rel=1e-3)


@pytest.mark.parametrize("way", ["deactivated", "error", "shutdown"])
def test_effort_is_cleared_on_deactivation(way: str, values: dict[str, float]) -> None:
    assert abs(values["effort_before"]) > 0.1
    assert values[way] == 0.0


@pytest.mark.parametrize("fault", ["reference_fails", "state_not_finite", "state_unread"])
def test_failed_update_sends_no_effort(fault: str, values: dict[str, float]) -> None:
    assert values[fault] == 0.0


def test_configures_only_at_the_rate_of_the_export(driven: str, values: dict[str, float]) -> None:
    assert [values[f"configures_at_{rate}"] for rate in (0, 500, 1000, 2000)] == [0, 0, 1, 0]
    assert "update_rate is 500 Hz; expected 1000 Hz, the rate of the exported law" in driven


def test_plugin_description_package_and_build_files_agree() -> None:
    description = ElementTree.fromstring(block_of("flexible_joint_controller.xml").text)
    package = ElementTree.fromstring(block_of("package.xml").text)
    build, source = block_of("CMakeLists.txt").text, block_of("flexible_joint_controller.cpp").text
    plugin = description.find("class").attrib
    assert f"PLUGINLIB_EXPORT_CLASS({plugin['type']}, {plugin['base_class_type']})" in source
    assert f"add_library({description.get('path')} SHARED" in build
    for tag in package.findall("buildtool_depend") + package.findall("depend"):
        assert f"find_package({tag.text} REQUIRED)" in build
    assert "pluginlib_export_plugin_description_file(controller_interface flexible_joint_controller.xml)" in build
    assert build.rstrip().endswith("ament_package()")
    manager = next(block for block in blocks(PAGE) if block.marks.get("for") == "ros2_control").text
    assert f"type: {plugin['name']}" in manager
