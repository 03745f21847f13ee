# SPDX-License-Identifier: Apache-2.0
"""The commands that check a scenario, synthesise gains, write files and study a loop by simulation."""
