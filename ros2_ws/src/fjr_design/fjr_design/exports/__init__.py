# SPDX-License-Identifier: Apache-2.0
"""Export of a closed loop as plain C99: control step and plant for C and C++ programs, with a replay case."""
