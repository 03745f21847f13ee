# SPDX-License-Identifier: Apache-2.0
"""Export of a closed loop as plain C99: control step and plant for C and C++ programs, with a replay case."""

from .c_code import prefix_of
from .exported_loop import Loop, loop_of
from .project import ExportError, export, write

__all__ = ["ExportError", "Loop", "export", "loop_of", "prefix_of", "write"]
