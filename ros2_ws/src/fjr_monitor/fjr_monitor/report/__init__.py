# SPDX-License-Identifier: Apache-2.0
"""Reports of recorded runs: report.json, overview.png and HTML pages."""
