# SPDX-License-Identifier: Apache-2.0
"""Diagnose a running or recorded loop: does V decay, and if not, why."""
