# SPDX-License-Identifier: Apache-2.0
"""Running a scenario with both nodes as processes."""
