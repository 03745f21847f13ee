# SPDX-License-Identifier: Apache-2.0
"""The robot that differs from its model: stated distributions, posteriors, loops of drawn plants."""
