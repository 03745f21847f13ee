# SPDX-License-Identifier: Apache-2.0
"""Robust extensions of the paper: disturbance feedforward, integral action, Smith predictor for the loop delay."""
