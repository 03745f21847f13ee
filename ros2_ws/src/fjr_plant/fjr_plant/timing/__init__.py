# SPDX-License-Identifier: Apache-2.0
"""Time bases of the plant: real time, or lock-step with commands."""
