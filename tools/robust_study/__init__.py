# SPDX-License-Identifier: Apache-2.0
"""The study of the robust action in docs/robust.md."""
