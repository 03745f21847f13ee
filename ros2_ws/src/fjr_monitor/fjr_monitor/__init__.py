# SPDX-License-Identifier: Apache-2.0
"""While and after the arm moves: diagnosis, recording, metrics, reports and displays.

From a bag to its verdict: `recording.files` reads messages, `recording.bag` makes arrays of them, `recording.signals`
states with their commands, `recording.run` the run in parts. `diagnosis.diagnosis` takes the parts in two passes: first
innovations, from which `diagnosis.delay_estimation` finds how late efforts acted, then what `diagnosis.causes` predicts
of each cause. `diagnosis.fault_isolation` checks signals, `diagnosis.torque_faults` compares the hypotheses, and
`report.metrics` writes the verdict into report.json.
"""
