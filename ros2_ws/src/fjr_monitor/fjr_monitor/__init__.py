# SPDX-License-Identifier: Apache-2.0
"""While and after the arm moves: diagnosis, recording, metrics, reports and displays.

From a bag to its verdict: `recording.files` reads messages, `recording.bag` makes arrays of them, `recording.signals`
finds the states of the run with their commands, `recording.run` keeps all signals in `recording.columns` and gives them
in parts. `diagnosis.diagnosis` takes the parts in two passes: first innovations, from which
`diagnosis.delay_estimation` finds how late efforts acted, then what `diagnosis.causes` predicts of each cause.
`diagnosis.fault_isolation` checks signals, `diagnosis.torque_faults` compares the hypotheses. `report.metrics` adds V
and powers as columns, `report.performance` computes all numbers of report.json from columns.
"""
