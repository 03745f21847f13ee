# SPDX-License-Identifier: Apache-2.0
"""The closed loop of many runs as one C program: what CasADi writes of law and plant, and loop.c round it."""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from ...control.sampled_law import ARGUMENTS, SampledLaw
from ...numerics.casadi_function import dense_function
from ...numerics.jit import loaded
from ...numerics.jit_cache import program_digest
from ...robot.robot import Robot
from .uncertain_robot import UncertainPlant, size

LANES = 4
"""Runs that the program works on at once."""
SOURCES = ("noise.c", "loop.c")
_DOUBLES, _INTEGERS = ctypes.POINTER(ctypes.c_double), ctypes.POINTER(ctypes.c_longlong)


class Campaign(ctypes.Structure):
    """struct campaign of loop.c."""

    _fields_ = (
        *((name, ctypes.c_longlong) for name in ("samples", "first", "last_second", "ring")),
        *((name, ctypes.c_double) for name in ("period", "lost", "band")),
        *((name, _DOUBLES) for name in ("jets", "target", "gains", "memory", "position", "velocity")),
        *((name, _DOUBLES) for name in ("parameters", "sensing", "limit")),
        ("full", ctypes.POINTER(ctypes.c_ubyte)),
        ("segments", _INTEGERS),
        ("dt", _DOUBLES),
        ("seeds", ctypes.POINTER(ctypes.c_uint64)),
        *((name, _DOUBLES) for name in ("rows", "trace")),
    )


def campaign(**values: object) -> Campaign:
    """The structure from numbers and contiguous arrays, which must live as long as it is used; None: no array."""
    kinds: dict[str, Any] = {field[0]: field[1] for field in Campaign._fields_}
    filled = {
        name: value.ctypes.data_as(kinds[name]) if isinstance(value, np.ndarray) else value
        for name, value in values.items()
    }
    return Campaign(**filled)


@dataclass(frozen=True, eq=False)
class Program:
    """Law and plants of a loop as CasADi functions without V, and the library made of them."""

    robot: Robot
    law: SampledLaw

    @cached_property
    def functions(self) -> Mapping[str, ca.Function]:
        """By the names that loop.c calls them."""
        plants = {"plain": UncertainPlant(self.robot, False, False), "full": UncertainPlant(self.robot, True, True)}
        made = [self._law()]
        for name, plant in plants.items():
            made += [plant.step(f"{name}_step"), plant.velocity(f"{name}_velocity"), plant.state(f"{name}_state")]
        return {function.name(): function for function in made}

    @cached_property
    def fingerprint(self) -> str:
        """Tells apart programs whose numbers may differ, also those with and without machine code."""
        around = program_digest(self.library is not None)
        parts = [function.serialize() for function in self.functions.values()] + [around]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

    @cached_property
    def library(self) -> ctypes.CDLL | None:
        """The machine code; None without a C compiler."""
        library = loaded("campaign", list(self.functions.values()), self._around)
        if library is not None:
            library.run_campaign.argtypes = [ctypes.POINTER(Campaign), ctypes.c_longlong, ctypes.c_longlong, _DOUBLES]
            library.run_campaign.restype = None
        return library

    def _law(self) -> ca.Function:
        """step_function without V, as one list of operations where that is possible."""
        step = self.law.step_function
        arguments = dict(zip(ARGUMENTS, step.mx_in(), strict=True))
        u, _, following = step(*arguments.values())
        law = dense_function("law", arguments, {"u": u, "next": following})
        try:
            return law.expand("law", {"cse": True})
        except RuntimeError:  # it solves for something
            return law

    def _around(self, code: str) -> str:
        functions = self.functions.values()
        sizes = {
            "N": self.robot.n,
            "PARAMETERS": size(self.robot.n),
            "MEMORY": len(self.law.memory),
            "LANES": LANES,
            **{
                key.upper(): max(1, *(getattr(f, f"sz_{key}")() for f in functions))
                for key in ("arg", "res", "iw", "w")
            },
        }
        lines = [f"#define {name} {value}" for name, value in sizes.items()]
        return "\n".join(
            ["#define CASADI_SYMBOL_EXPORT static __attribute__((noinline))", code, *lines, *map(_text, SOURCES)]
        )


def _text(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")
