# SPDX-License-Identifier: Apache-2.0
"""Stability of the sampled loop, modes that are too fast for it, and starts with springs that harden."""
