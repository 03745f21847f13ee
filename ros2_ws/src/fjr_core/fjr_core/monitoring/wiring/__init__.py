# SPDX-License-Identifier: Apache-2.0
"""Exchanged joints and wrong signs, found in the first samples of a run."""
