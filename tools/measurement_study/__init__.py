# SPDX-License-Identifier: Apache-2.0
"""The study of sensors and observers in docs/measurements.md."""
