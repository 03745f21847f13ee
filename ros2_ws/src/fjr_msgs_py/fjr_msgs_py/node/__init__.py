# SPDX-License-Identifier: Apache-2.0
"""Common parts of the nodes: parameters, process, scheduling, diagnostics."""
