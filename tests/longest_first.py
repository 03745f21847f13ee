# SPDX-License-Identifier: Apache-2.0
"""Files that take long. They start first, so that no worker is left alone with one: a file runs on one worker.

The two files that need the clock begin; files of the mathematics, which start no node, run beside them (conftest.py).
The others follow by length.
"""

LONGEST_FIRST = (
    "faults/test_faults.py",
    "system/test_real_time.py",
    "proofs/error_bound/test_error_bound.py",
    "core/runtime/test_step.py",
    "design/exports/test_export_c.py",
    "design/tuning/test_gain_synthesis.py",
    "monitor/diagnosis/test_diagnosis.py",
    "proofs/error_bound/test_contraction.py",
    "docs/test_blocks.py",
    "system/test_labelled_set.py",
    "system/test_fjr_check.py",
    "system/test_wiring_faults.py",
    "docs/test_build.py",
    "system/test_fjr_command.py",
    "system/test_pages.py",
    "design/exports/ros2_control/test_plugins.py",
    "system/test_closed_loop.py",
    "design/exports/ros2_control/test_package.py",
    "system/test_records.py",
    "core/stability/test_sampled_loop.py",
    "hosts/test_hosts.py",
    "system/test_compare.py",
    "core/simulation/test_batch_control.py",
    "nodes/test_other_laws.py",
    "design/tuning/test_equal_bandwidth.py",
    "core/robust/test_robust.py",
    "core/numerics/test_jit.py",
    "system/test_executables.py",
    "system/test_fjr_tune.py",
    "system/test_fjr_sweep.py",
    "system/test_fjr_report.py",
    "core/numerics/test_fused_code.py",
    "nodes/test_malformed.py",
    "system/test_identify_measurements.py",
    "nodes/test_hostile_requests.py",
    "system/test_echo_and_record.py",
    "system/test_wiring_oracle.py",
)
