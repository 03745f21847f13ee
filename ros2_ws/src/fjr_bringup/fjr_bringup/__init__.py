# SPDX-License-Identifier: Apache-2.0
"""Scenarios, launch files, recording, reports, studies and the `fjr` command."""
