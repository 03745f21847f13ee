# SPDX-License-Identifier: Apache-2.0
"""`make docs` builds without warnings, and the API reference is complete."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import fjr_core
from docs.pages import PAGES, ROOT
from time_limits import HANG

PUBLIC_NODES = ("fjr_plant.plant_node.PlantNode", "fjr_controller.controller_node.ControllerNode")


@pytest.fixture(scope="module")
def html(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("docs")
    command = [sys.executable, str(ROOT / "tools" / "docs" / "build_docs.py"), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANG, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return folder / "html"


def test_every_page_is_built(html: Path) -> None:
    for page in PAGES:
        assert (html / page.relative_to(ROOT)).with_suffix(".html").is_file()


def test_public_names_and_nodes_are_in_the_reference(html: Path) -> None:
    pages = "".join(path.read_text("utf-8") for path in (html / "api").glob("*.html"))
    homes = [(getattr(getattr(fjr_core, name), "__module__", ""), name) for name in fjr_core.__all__]
    wanted = [f"{home}.{name}" for home, name in homes if home.startswith("fjr_core")]
    for name in (*wanted, "fjr_core.law.gains.PAPER_GAINS", "fjr_msgs_py.names.LATEST", *PUBLIC_NODES):
        assert f'id="{name}"' in pages, name
