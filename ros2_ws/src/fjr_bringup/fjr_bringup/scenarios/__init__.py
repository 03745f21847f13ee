# SPDX-License-Identifier: Apache-2.0
"""Installed scenarios and their overrides."""
