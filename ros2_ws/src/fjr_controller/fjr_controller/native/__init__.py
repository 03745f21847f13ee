# SPDX-License-Identifier: Apache-2.0
"""The command loop as a thread in C: state in, control step, effort out."""
