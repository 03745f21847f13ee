# SPDX-License-Identifier: Apache-2.0
"""What a page draws of an arm: the joints and shapes of its URDF."""
