# SPDX-License-Identifier: Apache-2.0
"""Parameters of both nodes and scenarios: their tables, their files, and what is built from their values."""
