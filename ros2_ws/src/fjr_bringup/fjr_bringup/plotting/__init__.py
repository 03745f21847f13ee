# SPDX-License-Identifier: Apache-2.0
"""Matplotlib pictures of a run."""
