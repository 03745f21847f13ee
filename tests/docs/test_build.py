# SPDX-License-Identifier: Apache-2.0
"""The pages and the API reference build without warnings, and the reference is complete."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import pytest

import fjr_core
from docs.pages import PAGES, ROOT
from isolation import CACHE
from time_limits import HANG

PUBLIC_NODES = ("fjr_plant.plant_node.PlantNode", "fjr_controller.controller_node.ControllerNode")


def build(folder: Path, builder: str) -> None:
    command = [sys.executable, str(ROOT / "tools" / "docs" / "build_docs.py"), str(folder), builder]
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANG, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""


def test_every_reference_is_resolved_and_every_public_name_is_in_the_api_reference() -> None:
    build(CACHE / "docs", "dummy")
    environment = pickle.loads((CACHE / "docs" / "cache" / "environment.pickle").read_bytes())
    assert {str(page.relative_to(ROOT).with_suffix("")) for page in PAGES} <= set(environment.all_docs)
    homes = [(getattr(getattr(fjr_core, name), "__module__", ""), name) for name in fjr_core.__all__]
    wanted = {f"{home}.{name}" for home, name in homes if home.startswith("fjr_core")}
    wanted |= {"fjr_core.law.gains.PAPER_GAINS", "fjr_msgs_py.names.LATEST", *PUBLIC_NODES}
    assert wanted <= set(environment.domaindata["py"]["objects"])


@pytest.mark.full
def test_make_docs_writes_every_page(tmp_path: Path) -> None:
    build(tmp_path, "html")
    for page in PAGES:
        assert (tmp_path / "html" / page.relative_to(ROOT)).with_suffix(".html").is_file()
