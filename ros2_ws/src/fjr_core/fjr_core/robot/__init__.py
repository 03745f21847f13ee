# SPDX-License-Identifier: Apache-2.0
"""The robot as a model: rigid arm, joints, eq. (36), virtual system, equilibrium and URDF."""
