# SPDX-License-Identifier: Apache-2.0
"""The robot that differs from its model: the posterior of an identification, loops of drawn plants."""
