# SPDX-License-Identifier: Apache-2.0
"""Predict segments of a record with sensitivities: shooting.c compiled for an arm and its free parameters."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from fjr_core.numerics import jit
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import CFunction, WorkSpace, c_library_of

from .elastic_arm import ElasticArm, packed
from .parameters import LAG, SMOOTHING

VECTOR, LARGEST_BLOCK = 8, 4  # doubles in a vector of the C code, vectors in a row of a block of sensitivities

CREEP, STABLE = 0.5, 1.5  # decay of friction at rest in an integration step; of more than MOST_PARTS
MOST_PARTS = 16  # integration steps of a sample period, while a joint creeps
MOST_STIFF_PARTS = 1024  # of these, where the integration would be unstable; more are not tried
PASSAGE = 0.5  # change of a velocity near zero in an integration step, in smoothing velocities of the friction
IMPULSE = 1 / 3  # of a step, in which a change of the sign of friction may be missed
SLOW = 3.0  # smoothing velocities; friction is steep below


@dataclass(frozen=True, eq=False)
class HeldEffort:
    """Torques u (k, n) [N m] of the motors, each held for the sample period dt [s], and the steps of integration.

    parts: steps of a sample period. They are halved where a velocity may cross zero, as far as the turn of friction
    needs and a velocity may be wrong: mobility (2n,) [1 / (kg m^2)] of links and motors, accuracy (2n,) [rad/s].
    """

    u: Array
    dt: float
    parts: int
    mobility: Array
    accuracy: Array

    def steps(self, p: Mapping[str, Array]) -> dict[str, Array] | None:
        """Return what shooting.h limits steps by, (2n,) each; None: friction is too steep. p: parameters by name.

        Each side is given the friction of both, because a fit in progress does not know well how it is divided.
        """
        load = np.max(np.abs(self.u), axis=0)
        levels = [
            np.maximum(p[f"{side}_coulomb_friction"], p[f"{side}_static_friction"]) + load * p[f"{side}_load_friction"]
            for side in ("link", "motor")
        ]
        v_0, acceleration = np.tile(p[SMOOTHING], 2), np.tile(sum(levels), 2) * self.mobility
        creep = self.dt * acceleration / v_0
        if np.max(creep, initial=0.0) > STABLE * MOST_STIFF_PARTS:
            return None
        with np.errstate(divide="ignore", invalid="ignore"):
            rest = self.dt / np.minimum(creep / CREEP, np.maximum(creep / STABLE, MOST_PARTS))
            harmless = self.accuracy / (IMPULSE * acceleration)
        return {"slow": SLOW * v_0, "rest": rest, "passage": PASSAGE * v_0, "harmless": harmless}

    def struct(self, ffi: Any, lib: Any, first: int, p: Mapping[str, Array]) -> tuple[Any, ...] | None:
        """Return the structure of C, and what it refers to; None as `steps`."""
        steps = self.steps(p)
        if steps is None:
            return None
        delay, lag = p["effort_delay"] / self.dt, p[LAG] / self.dt
        u, du = behind(self, ffi, lib, lag.tobytes())
        values: dict[str, Any] = {
            name: ffi.from_buffer("double[]", np.ascontiguousarray(array, dtype=float))
            for name, array in {"u": u, "du": du, "delay": delay, "lag": lag, **steps}.items()
        }
        values |= {"parts": self.parts, "count": len(self.u), "first": first, "dt": self.dt}
        return ffi.new("struct fjr_input *", values), values


@lru_cache(maxsize=8)  # records of a fit: all segments of one need the same
def behind(effort: HeldEffort, ffi: Any, lib: Any, lag: bytes) -> Array:
    """Return efforts behind lags (n,) [samples] and their derivatives by the squares, (2, k, n)."""
    found = np.empty((2, *effort.u.shape))
    u, lags, out = (ffi.from_buffer("double[]", each) for each in (np.ascontiguousarray(effort.u), lag, found))
    lib.fjr_behind(u, lags, len(effort.u), out)
    return found


@dataclass(frozen=True, eq=False)
class Shooting:
    """Integrate the arm over segments. delays: joint j of each free effort delay, n + j of each free lag.

    A column of the sensitivities (4n, columns) is an entry of the initial state, a free parameter, a delay or a squared
    lag. Raises CompilerError on the first use.
    """

    arm: ElasticArm
    delays: tuple[int, ...]
    _local: threading.local = field(default_factory=threading.local, init=False)

    @property
    def columns(self) -> int:
        """Return the number of columns of the sensitivities."""
        return 4 * self.arm.robot.n + len(self.arm.free) + len(self.delays)

    @property
    def vectors(self) -> int:
        """Return the number of vectors of a row in a block: equally many in all, at most LARGEST_BLOCK."""
        blocks = -(-self.columns // (VECTOR * LARGEST_BLOCK))
        return -(-self.columns // (VECTOR * blocks))

    @property
    def padded(self) -> int:
        """Return the number of columns in memory, a multiple of the block's."""
        return -(-self.columns // (VECTOR * self.vectors)) * VECTOR * self.vectors

    def __call__(
        self, x0: Array, effort: HeldEffort, first: int, samples: int, p: Mapping[str, Array]
    ) -> tuple[Array, Array] | None:
        """Return states (samples + 1, 4n) and sensitivities (samples + 1, 4n, columns) from x0 (4n,) at sample `first`.

        p: all parameters by name. None if the state does not stay finite, or friction is too steep to integrate.
        """
        n, columns = self.arm.robot.n, self.columns
        X, S = np.empty((samples + 1, 4 * n)), np.empty((samples + 1, 4 * n, self.padded))
        X[0], S[0] = x0, np.eye(4 * n, self.padded)
        ffi, lib = self.library
        held = effort.struct(ffi, lib, first, p)
        if held is None:
            return None
        arrays = [ffi.from_buffer("double[]", array) for array in (packed(self.arm, p), X, S)]
        failed = lib.fjr_shoot(self._memory.arm, held[0], arrays[0], samples, *arrays[1:])
        return None if failed else (X, S[:, :, :columns])

    def normal_equations(self, J: Array, r: Array) -> tuple[Array, Array]:
        """Return J'J (m, m) and J'r (m,) of J (k, m) and r (k,), in this thread alone."""
        ffi, lib = self.library
        rows, columns = J.shape
        H, g = np.zeros((columns, columns)), np.zeros(columns)
        of_J, of_r, of_H, of_g = (ffi.from_buffer("double[]", array) for array in (J, r, H, g))
        lib.fjr_normal_equations(of_J, of_r, rows, columns, of_H, of_g)
        return H, g

    @cached_property
    def library(self) -> tuple[Any, Any]:
        """Return cffi's types and the compiled loop."""
        return c_library_of(__file__, {"N": self.arm.robot.n, "M": self.padded, "L": self.vectors})[:2]

    @cached_property
    def function(self) -> Any:
        """Return the compiled accelerations."""
        return jit.compiled_together("elastic_arm", [self.arm.accelerations])[0]

    @property
    def _memory(self) -> _Memory:
        """Return the memory of this thread."""
        if not hasattr(self._local, "memory"):
            self._local.memory = _Memory(self)
        return self._local.memory


class _Memory:
    """Arguments and work space of the C code for one thread."""

    def __init__(self, shooting: Shooting) -> None:
        ffi, _ = shooting.library
        self.arm, count = ffi.new("struct fjr_arm *"), len(shooting.arm.pattern[0])
        self._function, self._work = CFunction(ffi, shooting.function), WorkSpace(ffi, [shooting.function])
        self._work.lend(self.arm)
        self._held = {name: ffi.new("int32_t[]", list(map(int, at))) for name, at in _indices(shooting).items()}
        self._held |= {"f": self._function.pointer, "nonzeros": ffi.new("double[]", 4 * count)}
        for name, value in self._held.items():
            setattr(self.arm, name, value)
        self.arm.count = count


def _indices(shooting: Shooting) -> dict[str, Any]:
    """Return where the nonzeros of the Jacobian act, as struct fjr_arm has it."""
    n = shooting.arm.robot.n
    rows, columns = map(np.array, shooting.arm.pattern)
    first_effort = 4 * n + len(shooting.arm.free)
    by_parameter = [(k, -1, k) for k in range(4 * n, first_effort)]
    by_effort = [(first_effort + k, d, first_effort + d % n) for k, d in enumerate(shooting.delays)]
    entries = [(k, d, e) for k, d, at in by_parameter + by_effort for e in np.flatnonzero(columns == at)]
    targets, joints, forced = np.array(entries, dtype=int).reshape(-1, 3).T
    of_state = np.flatnonzero(columns < 4 * n)
    of_state = of_state[np.argsort(rows[of_state], kind="stable")]
    blocks = np.arange(0, shooting.padded + 1, VECTOR * shooting.vectors)
    return {
        "row_start": np.searchsorted(rows[of_state], np.arange(2 * n + 1)),
        "entry": of_state,
        "column": columns[of_state],
        "forced_start": np.searchsorted(targets, blocks),
        "forced_entry": forced,
        "forced_row": rows[forced],
        "forced_column": targets,
        "forced_joint": joints,
    }
