# SPDX-License-Identifier: Apache-2.0
"""MuJoCo and Drake in place of the integrator of the plant; arms read and written as MJCF; films."""
