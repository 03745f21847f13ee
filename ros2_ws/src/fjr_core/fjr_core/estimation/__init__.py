# SPDX-License-Identifier: Apache-2.0
"""What is measured, and the observer that estimates velocities from positions."""
