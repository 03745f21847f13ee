# SPDX-License-Identifier: Apache-2.0
"""Scenarios, launch files, runner and the `fjr` command."""
