# SPDX-License-Identifier: Apache-2.0
"""Check the certificate of a rate that `fjr check SCENARIO --certificate FILE` has written (docs/proof.md).

    python tools/check_certificate.py FILE [--seconds 600]

It needs NumPy and mpmath, and shares no code with the program that makes certificates. Of the file it takes the robot,
the gains, the claimed rate and the boxes; every other number is computed again, by other means:

- M_l is the sum over the bodies of trace(dT/dq_i S (dT/dq_j)'), with the pose T (4, 4) and the pseudo-inertia S of a
  body. Its values at 5 angles (3 positions) of each joint determine it, as it has degree 2 in each joint.
- On a box, each joint has a basis of nonnegative functions with the sum 1. Its values at the same nodes, inverted, give
  the control matrices of D_l + K_ld - beta M_l, of which it is a convex combination.
- Gaussian elimination in interval arithmetic proves them positive definite.
- Every body has inertia about its own joint, so that M_l is positive definite, or the same elimination proves it.

All arithmetic encloses the exact values: by mpmath.iv for angles, by rounding outwards for arrays.
Exit code 0: the rate is proven; 1: the certificate is refused, with the reason.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
import time
from collections.abc import Iterator
from decimal import ROUND_FLOOR, Context
from functools import lru_cache, reduce
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from mpmath import iv, mpf
from numpy.typing import NDArray

Array = NDArray[np.float64]
Range = tuple[float, float]
Joint = tuple[bool, float, float]  # whether it is prismatic, and its range
iv.prec = 300  # the inverse of a basis on a short box loses many digits
FULL, SHORT = 2.6, 1e-6  # rad, rad or m; a longer range has the basis of the whole circle, a shorter one is enlarged
KERNEL = (0.65, 0.34)  # 1 + 2 k_1 cos q + 2 k_2 cos 2q >= 0
TOLERANCE = 1e-12  # of rotations, symmetric inertias and diagonal cubic gains
TOGETHER = 1000  # matrices that are eliminated together; they fit into the cache
SYMMETRIC = ("D_l", "D_m", "M_m", "Pi_l", "K_ld", "Pi_m", "K_md")
MATRICES = (*SYMMETRIC, "Lambda_l", "Lambda_m", "Gamma_l", "Gamma_m")
SLIDE, TURN = np.diag([0.0, 0.0, 1.0], 1), np.diag([-1.0, 0.0, 0.0], 1) + np.diag([1.0, 0.0, 0.0], -1)  # dT/dq at q = 0
ENTRIES = {"format", "joints", "bodies", "lower", "upper", "beta", "boxes", *MATRICES}
MOST_JOINTS, MOST_MATRICES = 12, 5**7  # values of M_l: 5 for each revolute joint after the first, 3 for a prismatic one
SECONDS = 600.0  # longest time of a check, if none is given
LARGEST = 1e100  # of a number; products of some of them remain finite
SHAPES = {"rotation": (3, 3), "inertia": (3, 3), "translation": (3,), "com": (3,), "mass": ()}


class RefusedError(Exception):
    """A certificate that does not prove its claim."""


def require(condition: Any, otherwise: str) -> None:
    """Raise RefusedError unless a condition holds."""
    if not condition:
        raise RefusedError(otherwise)


class Box:
    """Arrays of intervals [lo, hi]; every operation rounds outwards. Matrices are the last two axes."""

    def __init__(self, lo: Any, hi: Any = None) -> None:
        self.lo = np.asarray(lo, dtype=float)
        self.hi = self.lo if hi is None else np.asarray(hi, dtype=float)

    def __getitem__(self, at: Any) -> Box:
        return Box(self.lo[at], self.hi[at])

    def __add__(self, other: Box) -> Box:
        return Box(np.nextafter(self.lo + other.lo, -np.inf), np.nextafter(self.hi + other.hi, np.inf))

    def __sub__(self, other: Box) -> Box:
        return self + Box(-other.hi, -other.lo)

    def __mul__(self, other: Box) -> Box:
        ends = [x * y for x in (self.lo, self.hi) for y in (other.lo, other.hi)]
        low, high = reduce(np.minimum, ends), reduce(np.maximum, ends)
        return Box(np.nextafter(low, -np.inf), np.nextafter(high, np.inf))

    def __matmul__(self, other: Box) -> Box:
        inner = range(self.lo.shape[-1])
        return reduce(Box.__add__, (self[..., :, k, None] * other[..., None, k, :] for k in inner))

    def transposed(self) -> Box:
        """Return the transposed matrices."""
        return Box(self.lo.swapaxes(-1, -2), self.hi.swapaxes(-1, -2))


def enclosed(values: Any) -> Array:
    """Return lower and upper ends (2, ..) of nested lists of intervals of mpmath."""
    if isinstance(values, list):
        return np.stack([enclosed(value) for value in values], axis=1)
    return np.array([np.nextafter(float(mpf(end)), side) for end, side in ((values.a, -np.inf), (values.b, np.inf))])


def nodes(prismatic: bool, a: float, b: float) -> list[Any]:
    """Return the angles 72 j degrees, or the positions of a prismatic joint, at which the inertia is evaluated."""
    return [iv.mpf(x) for x in (a - 1.0, (a + b) / 2, b + 1.0)] if prismatic else [2 * iv.pi * j / 5 for j in range(5)]


def inertia_at_nodes(bodies: list[dict[str, Any]], at: list[list[Any]]) -> Box:
    """Return M_l (k_2, .., k_n, n, n) at all nodes of the joints 2 .. n; the first joint stands at zero."""
    n = len(bodies)
    T, slopes, M = Box(np.eye(4)), Box(np.zeros((n, 4, 4))), Box(np.zeros((n, n)))
    for k, body in enumerate(bodies):
        pose = np.block([[np.array(body["rotation"]), np.reshape(body["translation"], (3, 1))], [np.eye(4)[3:]]])
        step = Box(pose) @ motion(body["prismatic"], at[k], k - 1, n - 1) if k else Box(np.eye(4))
        T, generators = T @ step, np.zeros((n, 4, 4))
        generators[k] = SLIDE if body["prismatic"] else TURN
        slopes = slopes @ step[..., None, :, :] + T[..., None, :, :] @ Box(generators)
        inertia, r = Box(np.pad(body["inertia"], (0, 1))), Box([*body["com"], 1.0])
        half_trace = (inertia[0, 0] + inertia[1, 1] + inertia[2, 2]) * Box(np.diag([0.5, 0.5, 0.5, 0.0]))
        S = Box(body["mass"]) * r[:, None] * r[None] + half_trace - inertia  # integral of (r, 1) (r, 1)' over the mass
        for row in (slopes[..., i, :] for i in range(3)):
            M = M + row @ S @ row.transposed()
    return M


def motion(prismatic: bool, at: list[Any], axis: int, axes: int) -> Box:
    """Return the motion (1, .., k, .., 1, 4, 4) of a joint at its nodes."""
    found = np.zeros((2, len(at), 4, 4)) + np.eye(4)
    if prismatic:
        found[:, :, 2, 3] = enclosed(at)
    else:
        c, s = enclosed([iv.cos(x) for x in at]), enclosed([iv.sin(x) for x in at])
        found[:, :, 0, 0], found[:, :, 1, 1], found[:, :, 1, 0], found[:, :, 0, 1] = c, c, s, -s[::-1]
    return Box(*found.reshape(2, *[len(at) if k == axis else 1 for k in range(axes)], 4, 4))


@lru_cache(4096)
def control_map(prismatic: bool, lower: float, upper: float, a: float, b: float) -> tuple[Array, float, float]:
    """Return the matrix from values at the nodes to control values on [a, b], its norm and its relative error.

    lower, upper: range of the joint. The basis of an arc, sin^(4 - k)((b - q) / 2) sin^k((q - a) / 2) times the
    coefficients of 1 = (sin^2 + sin^2 + 2 cos((b - a) / 2) sin sin)^2 / sin^4((b - a) / 2), is nonnegative below pi.
    """
    left, right = iv.mpf(a), iv.mpf(max(b, a + SHORT))
    c, whole = iv.cos((right - left) / 2), iv.sin((right - left) / 2)

    def basis(q: Any) -> list[Any]:
        if prismatic:
            x = (q - left) / (right - left)
            return [(1 - x) ** 2, 2 * x * (1 - x), x**2]
        if b - a > FULL:
            turned = [q - 2 * iv.pi * k / 5 for k in range(5)]
            return [(1 + 2 * iv.mpf(KERNEL[0]) * iv.cos(x) + 2 * iv.mpf(KERNEL[1]) * iv.cos(2 * x)) / 5 for x in turned]
        u, v = iv.sin((right - q) / 2) / whole, iv.sin((q - left) / 2) / whole
        return [w * u ** (4 - k) * v**k for k, w in enumerate((1, 4 * c, 2 + 4 * c**2, 4 * c, 1))]

    low, high = enclosed(inverted([basis(q) for q in nodes(prismatic, lower, upper)]))
    matrix = (low + high) / 2
    radius = np.maximum(high - matrix, matrix - low) * (1 + TOLERANCE)
    size = (np.abs(matrix) + radius) * (1 + TOLERANCE)
    return matrix, np.max(np.sum(size, axis=1)), np.max(np.sum(radius + 12 * 2.0**-53 * size, axis=1))


def inverted(matrix: list[list[Any]]) -> list[list[Any]]:
    """Return the inverse of a matrix by Gauss-Jordan elimination."""
    n = len(matrix)
    rows = [[*row, *(iv.mpf(int(i == k)) for k in range(n))] for i, row in enumerate(matrix)]
    for k in range(n):
        best = max(range(k, n), key=lambda i: abs(float(mpf(rows[i][k].mid))))
        rows[k], rows[best] = rows[best], rows[k]
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in {*range(n)} - {k}:
            rows[i] = [x - rows[i][k] * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[n:] for row in rows]


def holds(S: Box, joints: list[Joint], box: list[Range]) -> bool:
    """Return whether S (k_2, .., k_n, n, n), given at the nodes, is proven positive definite on a box of the joints."""
    n, values = len(joints), (S.lo + S.hi) / 2
    error = np.max(np.maximum(S.hi - values, values - S.lo).reshape(-1, n, n), axis=0) * (1 + TOLERANCE)
    for axis, (joint, part) in enumerate(zip(joints[1:], box[1:], strict=True)):
        matrix, size, rounding = control_map(*joint, *part)
        largest = np.max(np.abs(values).reshape(-1, n, n), axis=0)
        error = (size * error + rounding * (largest + error)) * (1 + TOLERANCE) + 2.0**-1000
        values = np.moveaxis(np.tensordot(matrix, values, axes=(1, axis)), 0, axis)
    values = values.reshape(-1, n, n)
    low, high = np.nextafter(values - error, -np.inf), np.nextafter(values + error, np.inf)
    parts = (slice(k, k + TOGETHER) for k in range(0, len(values), TOGETHER))
    return all(positive_definite(Box(low[part], high[part])) for part in parts)


def positive_definite(S: Box) -> bool:
    """Return whether Gaussian elimination has positive pivots for all symmetric matrices (.., n, n); reads i <= j."""
    n = S.lo.shape[-1]
    G = {(i, j): S[..., i, j] for i in range(n) for j in range(i, n)}
    for i in range(n):
        if not np.all(G[i, i].lo > 0):
            return False
        inverse = Box(np.nextafter(1 / G[i, i].hi, -np.inf), np.nextafter(1 / G[i, i].lo, np.inf))
        for j in range(i + 1, n):
            factor = G[i, j] * inverse
            for k in range(j, n):
                G[j, k] = G[j, k] - factor * G[i, k]
    return True


def leaves(entries: Iterator[Any], box: list[Range]) -> Iterator[list[Range]]:
    """Yield the boxes of a tree in preorder; raise RefusedError unless they cover a box."""
    entry: Any = next(entries, None)
    if type(entry) is int and entry == 0:
        yield box
        return
    refusal = f"the boxes do not cover the joint range: {entry!r:.60} is neither a box nor a split of {box}"
    numbers = isinstance(entry, list) and len(entry) > 1 and all(type(x) in (int, float) for x in entry)
    require(numbers and type(entry[0]) is int and 0 < entry[0] < len(box), refusal)
    joint, cuts = entry[0], map(float, entry[1:])
    for a, b in pairwise([box[joint][0], *cuts, box[joint][1]]):
        require(a < b, refusal)
        yield from leaves(entries, [*box[:joint], (a, b), *box[joint + 1 :]])


def checked(content: dict[str, Any], seconds: float = SECONDS) -> int:
    """Return the number of boxes of a certificate that proves its claim; raise RefusedError, also after `seconds`."""
    end = time.monotonic() + seconds
    digest = content.pop("sha256", None)
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    require(digest == hashlib.sha256(text.encode()).hexdigest(), "sha256 is not the digest of the other entries")
    bodies, joints, beta, matrix = values_of(content)
    check_blocks(beta, matrix)
    M = inertia_at_nodes(bodies, [nodes(*joint) for joint in joints])
    S, inert = matrix["D_l"] + matrix["K_ld"] - Box(beta) * M, all(map(resists, bodies))
    boxes, entries = 0, iter(content["boxes"])
    for box in leaves(entries, [joint[1:] for joint in joints]):
        require(time.monotonic() < end, f"it is not checked within {seconds:g} s; expected a larger --seconds")
        require(inert or holds(M, joints, box), f"M_l is not proven positive definite on the box {box}")
        require(holds(S, joints, box), f"D_l + K_ld - beta M_l is not proven positive definite on the box {box}")
        boxes += 1
    require(not [*entries], "there are boxes beside those that cover the joint range")
    return boxes


def resists(body: dict[str, Any]) -> bool:
    """Return whether a body has inertia about, or mass along, its own joint. M_l is positive definite if all have.

    For dq = (0, .., 0, dq_k, ..) with dq_k != 0, body k moves with its own joint only: its kinetic energy is positive.
    That of no body is negative: an inertia that is semidefinite up to rounding only does not count.
    """
    inertia, (x, y, _) = body["inertia"], body["com"]
    size, moments = np.max(np.abs(inertia)), np.diag(inertia)
    if not (np.all(inertia == np.diag(np.abs(moments))) or positive_definite(Box(inertia))):
        return False
    return body["mass"] > 0 if body["prismatic"] else inertia[2, 2] + body["mass"] * (x * x + y * y) > TOLERANCE * size


def values_of(content: dict[str, Any]) -> tuple[list[dict[str, Any]], list[Joint], float, dict[str, Box]]:
    """Return bodies, joints, beta and matrices; raise RefusedError for values of a wrong kind."""
    require(set(content) == ENTRIES, f"it does not have the entries {', '.join(sorted(ENTRIES))} and no others")
    require(content["format"] == "rate certificate 1", "format is not 'rate certificate 1'")
    joints, bodies = (expected(content[name], list, name) for name in ("joints", "bodies"))
    n = len(joints)
    require(0 < n <= MOST_JOINTS, f"it has {n} joints; expected 1 to {MOST_JOINTS}")
    require(len(bodies) == n, f"it has {len(bodies)} bodies; expected {n}, one per joint")
    for name in joints:
        require(
            type(name) is str and name.isprintable() and name, f"a joint is named {name!r}; expected printable names"
        )
        require(joints.count(name) == 1, f"{joints.count(name)} joints are named {name!r}; expected a name for each")
    beta = float(array(content["beta"], (), "beta"))
    lower, upper = (array(content[name], (n,), name) for name in ("lower", "upper"))
    require(beta > 0, "beta is not positive")
    require(np.all(lower <= upper), "a joint range is empty")
    matrix = {name: array(content[name], (n, n), name) for name in MATRICES}
    parts = [checked_body(expected(body, dict, "a body")) for body in bodies]
    matrices = math.prod(3 if part["prismatic"] else 5 for part in parts[1:])
    require(matrices <= MOST_MATRICES, f"it has {n} joints; expected at most 8 revolute ones")
    expected(content["boxes"], list, "boxes")
    found = [(part["prismatic"], float(a), float(b)) for part, a, b in zip(parts, lower, upper, strict=True)]
    return parts, found, beta, {name: Box(each) for name, each in matrix.items()}


def expected(value: Any, kind: type, name: str) -> Any:
    """Return a value of this type; raise RefusedError for any other, e.g. true in place of a number."""
    require(type(value) is kind, f"{name} is of type {type(value).__name__}; expected {kind.__name__}")
    return value


def of_one_value_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of JSON; raise RefusedError if two entries have one name, of which other readers take either."""
    found = dict(pairs)
    require(len(found) == len(pairs), "an object has two entries of one name")
    return found


def array(value: Any, shape: tuple[int, ...], name: str) -> Array:
    """Return nested lists of finite numbers of this shape; raise RefusedError for anything else."""
    if shape:
        require(type(value) is list and len(value) == shape[0], f"{name} is not a list of {shape[0]} entries")
        return np.array([array(each, shape[1:], name) for each in value], dtype=float)
    require(
        type(value) in (int, float) and abs(value) <= LARGEST, f"{name} holds {value!r:.60}; expected finite numbers"
    )
    return np.array(float(value))


def checked_body(body: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a rigid body; raise RefusedError for others."""
    require(set(body) == {*SHAPES, "prismatic"}, f"a body has other entries than prismatic, {', '.join(SHAPES)}")
    prismatic = expected(body["prismatic"], bool, "prismatic")
    part = {name: array(body[name], shape, name) for name, shape in SHAPES.items()}
    R, inertia, mass = part["rotation"], part["inertia"], part["mass"]
    close = TOLERANCE * np.max(np.abs(inertia))
    require(np.max(np.abs(R @ R.T - np.eye(3))) < TOLERANCE, "a rotation is not orthogonal")
    require(np.linalg.det(R) > 0, "a rotation is a reflection")
    require(mass >= 0, "a body has a negative mass")
    require(np.max(np.abs(inertia - inertia.T)) <= close, "an inertia is not symmetric")
    require(np.linalg.eigvalsh(inertia)[0] >= -close, "an inertia is not positive semidefinite")
    return {**part, "prismatic": prismatic}


def check_blocks(beta: float, matrix: dict[str, Box]) -> None:
    """Raise RefusedError unless V is positive and the blocks of positions and motors have the rate beta."""
    for name in SYMMETRIC:
        require(np.all(matrix[name].lo == matrix[name].lo.T), f"{name} is not symmetric")
    blocks = {name: matrix[name] for name in ("M_m", "Pi_l", "Pi_m")}
    blocks["D_m + K_md - beta M_m"] = matrix["D_m"] + matrix["K_md"] - Box(beta) * matrix["M_m"]
    for Pi, Lambda, Gamma in (("Pi_l", "Lambda_l", "Gamma_l"), ("Pi_m", "Lambda_m", "Gamma_m")):
        twice, cubic = matrix[Pi] @ matrix[Lambda], matrix[Pi].lo @ matrix[Gamma].lo
        twice = twice + twice.transposed()
        blocks[f"sym({Pi} {Lambda}) - beta {Pi}"] = twice * Box(0.5) - Box(beta) * matrix[Pi]
        diagonal = np.diag(cubic)  # the square of the error at joint k multiplies column k
        off = np.max(np.abs(cubic - np.diag(diagonal)), axis=0) <= TOLERANCE * diagonal
        require(np.all(off) and np.all(diagonal >= 0), f"{Pi} {Gamma} is not diagonal and nonnegative")
    for name, block in blocks.items():
        require(positive_definite(block), f"{name} is not proven positive definite")


def main(arguments: list[str]) -> int:
    """Check one file; return the exit code."""
    parser = argparse.ArgumentParser(description="Check the certificate of a rate (docs/proof.md).")
    parser.add_argument("file", metavar="FILE")
    parser.add_argument(
        "--seconds", type=float, default=SECONDS, help="longest time of the check (default %(default)s)"
    )
    given = parser.parse_args(arguments)
    try:
        content = json.loads(Path(given.file).read_text(encoding="utf-8"), object_pairs_hook=of_one_value_each)
        require(isinstance(content, dict), "it is not a JSON object")
        with np.errstate(all="ignore"):  # what is not a number is not positive
            boxes = checked(content, given.seconds)
    except (OSError, ValueError, ArithmeticError, RecursionError, MemoryError, RefusedError) as error:
        print(f"{given.file}: refused: {error}", file=sys.stderr)
        return 1
    beta = Context(prec=6, rounding=ROUND_FLOOR).create_decimal(content["beta"])
    print(f"{given.file}: proven: beta = {beta} 1/s on {boxes} boxes, joints {', '.join(content['joints'])}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
