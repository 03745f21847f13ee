# SPDX-License-Identifier: Apache-2.0
"""Labelled runs for the diagnosis, and its confusion tables."""
