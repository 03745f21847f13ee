# SPDX-License-Identifier: Apache-2.0
"""Modes that are too fast for the sample period or the integration step."""
