# SPDX-License-Identifier: Apache-2.0
"""Plots as values, and their drawing by Matplotlib."""
