# SPDX-License-Identifier: Apache-2.0
"""Identify stiffness, rotor inertia, friction, inertia of the links and timing of an elastic arm from records."""
