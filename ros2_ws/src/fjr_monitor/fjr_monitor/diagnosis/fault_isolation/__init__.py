# SPDX-License-Identifier: Apache-2.0
"""Isolation of a fault: the joint, the side and the kind, from the residuals of the model."""
