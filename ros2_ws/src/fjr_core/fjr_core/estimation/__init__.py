# SPDX-License-Identifier: Apache-2.0
"""Measurement model, and the observer that estimates velocities from positions."""
