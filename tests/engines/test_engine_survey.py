# SPDX-License-Identifier: Apache-2.0
"""The survey of engines moves the robots as the nodes do in lock-step, and every engine as the others."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import engine_survey
from system.shared_runs import record

pytestmark = pytest.mark.system
without_drake = pytest.mark.skipif(find_spec("pydrake") is None, reason="drake is not installed")


@pytest.mark.parametrize("engine", ["mujoco", pytest.param("drake", marks=without_drake)])
def test_loop_of_the_survey_is_lock_step_to_the_last_bit(engine: str, tmp_path: Path) -> None:
    run = record("two_link", 0.5, tmp_path, f"engine:={engine}", "compile:=false")
    motion = engine_survey.motion("two_link", engine, inner_steps=4, duration=0.5)
    samples = min(len(run.t), len(motion.positions))
    assert samples > 400
    assert np.array_equal(run.q_l[:samples], motion.positions[:samples, :2])


@without_drake
def test_table_counts_the_scenarios_in_which_all_engines_agree() -> None:
    found = engine_survey.compared("paper_k3p1", duration=0.1)
    other = {**found, "differences": [1e-9, 1e-9, 1.1e-6]}
    said, *_, row = engine_survey.table({"paper_k3p1": found, "other": other})
    assert "In 1 of 2 scenarios" in said
    assert row.startswith("| other | 1 | 4 | 1.0e-09 | 1.0e-09 | 1.1e-06 |")
    assert row.endswith("| 255.762 |")
