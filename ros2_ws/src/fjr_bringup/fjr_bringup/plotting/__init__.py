# SPDX-License-Identifier: Apache-2.0
"""Matplotlib figures of a run."""
