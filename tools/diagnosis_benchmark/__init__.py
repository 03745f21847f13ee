# SPDX-License-Identifier: Apache-2.0
"""The labelled runs that the diagnosis is measured on, and its tables."""
