# SPDX-License-Identifier: Apache-2.0
"""Files that take long. They start first, so that no worker is left alone with one: each runs on one, unless DIVIDED.

The two files that need the clock begin; files of the mathematics, which start no node, run beside them (conftest.py).
The others follow by length.
"""

from __future__ import annotations

DIVIDED = ("tests/docs/test_blocks.py::test_blocks_of_a_page", "tests/physics/test_physics.py::test_friction")
"""Beginnings of tests that are long and share no set-up: each of them runs on any worker."""

LONGEST_FIRST = (
    "faults/test_faults.py",
    "system/test_real_time.py",
    "proofs/error_bound/test_error_bound.py",
    "core/runtime/test_step.py",
    "design/exports/test_export_c.py",
    "design/tuning/test_gain_synthesis.py",
    "monitor/diagnosis/test_diagnosis.py",
    "proofs/error_bound/test_contraction.py",
    "design/stability/test_complete_loop_check.py",
    "physics/test_physics.py",
    "monitor/diagnosis/test_storage_growth.py",
    "design/batch/test_batch.py",
    "design/batch/test_batch_control.py",
    "design/scaffold/test_first_loop.py",
    "system/test_fjr_command.py",
    "docs/test_build.py",
    "docs/test_blocks.py",
    "engines/test_contact.py",
    "system/test_watch.py",
    "system/test_pages.py",
    "system/test_fjr_check.py",
    "engines/test_contact_nodes.py",
    "system/test_labelled_set.py",
    "system/test_fjr_tune.py",
    "system/test_closed_loop.py",
    "engines/test_film.py",
    "engines/test_mjcf_export.py",
    "system/test_identify_measurements.py",
    "system/test_compare.py",
    "system/test_records.py",
    "system/test_identify.py",
    "identification/records/test_checks.py",
    "system/test_limited_resources.py",
    "system/test_wiring_faults.py",
    "design/exports/ros2_control/test_plugins.py",
    "hosts/test_hosts.py",
    "system/test_new_command.py",
    "system/test_export_commands.py",
    "system/test_results.py",
    "system/test_fjr_report.py",
    "system/test_wheels.py",
    "system/test_other_joints.py",
    "design/exports/ros2_control/test_package.py",
    "monitor/diagnosis/test_fault_isolation.py",
    "design/stability/test_sampled_loop.py",
    "design/baselines/test_baseline_identities.py",
    "identification/estimation/test_identify.py",
    "core/robust/test_loaded_law.py",
    "design/tuning/test_equal_bandwidth.py",
    "core/robust/test_robust.py",
    "core/numerics/test_jit.py",
    "system/test_executables.py",
    "system/test_fjr_sweep.py",
    "core/numerics/test_fused_code.py",
    "nodes/test_native_loop.py",
    "system/test_running_nodes.py",
)


def unit(nodeid: str) -> str:
    """Return what runs on one worker: a test that is DIVIDED, else its file."""
    return nodeid if nodeid.startswith(DIVIDED) else nodeid.partition("::")[0]
