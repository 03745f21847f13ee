# SPDX-License-Identifier: Apache-2.0
"""Study of sensors and observers for docs/measurements.md."""
