# SPDX-License-Identifier: Apache-2.0
"""Installed scenarios and parameter changes from the command line."""
