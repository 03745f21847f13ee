# SPDX-License-Identifier: Apache-2.0
"""Robots in MuJoCo's format."""
