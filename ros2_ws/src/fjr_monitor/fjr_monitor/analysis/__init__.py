# SPDX-License-Identifier: Apache-2.0
"""Turn a recorded run into arrays and metrics."""
