# SPDX-License-Identifier: Apache-2.0
"""Parameters of both nodes: declarations, parameter files, scenarios, and builders of the objects they describe."""
