# SPDX-License-Identifier: Apache-2.0
"""Studies of many runs in parallel, with their reports."""
