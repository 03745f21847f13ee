# SPDX-License-Identifier: Apache-2.0
"""While and after the arm moves: diagnosis, recording, metrics, reports and displays.

From a bag to its verdict: `report.write.report_bag` reads the bag (`recording.bag`, `recording.run`), `report.metrics`
passes it to `diagnosis.diagnosis` part by part in two passes, where `diagnosis.causes` predicts what each cause
explains and `diagnosis.fault_isolation` compares the hypotheses; `report.write` writes report.json and the page.
"""
