# SPDX-License-Identifier: Apache-2.0
"""Check the certificate of a rate that `fjr check SCENARIO --certificate FILE` has written (docs/proof.md).

    python tools/check_certificate.py FILE

It needs NumPy and mpmath, and shares no code with the program that makes certificates. Of the file it takes the robot,
the gains, the claimed rate and the boxes; every other number is computed again, by other means:

- M_l is the sum of J' M J over the bodies, with the Jacobians of the forward kinematics, at 5 angles (3 positions) of
  each joint. These values determine it, as it is a trigonometric (ordinary) polynomial of degree 2 in each joint.
- Interpolation at these nodes and the tangent of the half angle give the control matrices of D_l + K_ld - beta M_l on
  a box, of which it is a convex combination.
- Gaussian elimination in interval arithmetic proves them positive definite.

All arithmetic encloses the exact values: by mpmath.iv for angles, by rounding outwards for arrays.
Exit code 0: the rate is proven; 1: the certificate is refused, with the reason.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from functools import lru_cache, reduce
from math import comb
from typing import Any

import numpy as np
from mpmath import iv, mpf
from numpy.typing import NDArray

Array = NDArray[np.float64]
Range = tuple[float, float]
iv.prec = 100
FULL = 2.6  # rad; a longer range has the control matrices of the whole circle
KERNEL = (0.65, 0.34)
ORTHOGONAL = 1e-12
TOGETHER = 1000  # matrices that are eliminated together; they fit into the cache
MATRICES = ("M_m", "D_l", "D_m", "Lambda_l", "Pi_l", "K_ld", "Lambda_m", "Pi_m", "K_md", "Gamma_l", "Gamma_m")


class RefusedError(Exception):
    """A certificate that does not prove its claim."""


class Box:
    """Arrays of intervals [lo, hi]; every operation rounds outwards."""

    def __init__(self, lo: Any, hi: Any = None) -> None:
        self.lo = np.asarray(lo, dtype=float)
        self.hi = self.lo if hi is None else np.asarray(hi, dtype=float)

    def __getitem__(self, at: Any) -> Box:
        return Box(self.lo[at], self.hi[at])

    def __neg__(self) -> Box:
        return Box(-self.hi, -self.lo)

    def __add__(self, other: Box) -> Box:
        return Box(np.nextafter(self.lo + other.lo, -np.inf), np.nextafter(self.hi + other.hi, np.inf))

    def __sub__(self, other: Box) -> Box:
        return self + -other

    def __mul__(self, other: Box) -> Box:
        ends = [x * y for x in (self.lo, self.hi) for y in (other.lo, other.hi)]
        low, high = reduce(np.minimum, ends), reduce(np.maximum, ends)
        return Box(np.nextafter(low, -np.inf), np.nextafter(high, np.inf))

    def inverse(self) -> Box:
        """Return 1 / self for positive intervals."""
        return Box(np.nextafter(1 / self.hi, -np.inf), np.nextafter(1 / self.lo, np.inf))


def total(terms: list[Box]) -> Box:
    """Return the sum."""
    return reduce(Box.__add__, terms)


def dot(left: list[Box], right: list[Box]) -> Box:
    """Return the inner product."""
    return total([x * y for x, y in zip(left, right, strict=True)])


def cross(a: list[Box], b: list[Box]) -> list[Box]:
    """Return the vector product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def times(A: list[list[Box]], B: list[list[Box]]) -> list[list[Box]]:
    """Return the matrix product."""
    return [[dot(row, list(column)) for column in zip(*B, strict=True)] for row in A]


def applied(A: list[list[Box]], v: list[Box]) -> list[Box]:
    """Return the product of a matrix and a vector."""
    return [dot(row, v) for row in A]


def constant(values: Any) -> list[Any]:
    """Return nested lists of numbers as intervals."""
    return [constant(value) if isinstance(value, list) else Box(value) for value in values]


def ends_of(value: Any) -> Range:
    """Return two doubles that enclose an interval of mpmath."""
    return float(np.nextafter(float(mpf(value.a)), -np.inf)), float(np.nextafter(float(mpf(value.b)), np.inf))


# The inertia at the nodes


def node_angle(j: int) -> Any:
    """Return the angle of node j: 72 j degrees."""
    return 2 * iv.pi * j / 5


def nodes(body: dict[str, Any], a: float, b: float) -> list[float]:
    """Return the positions of a prismatic joint at which the inertia is evaluated."""
    return [a, a + (b - a) / 2, b] if b > a else [a - 1.0, a, a + 1.0]


def along_axis(values: list[Range], axis: int, axes: int) -> Box:
    """Return intervals as an array of 1 x .. x k x .. x 1."""
    shape = [1] * axes
    shape[axis] = len(values)
    return Box(*(np.reshape(side, shape) for side in zip(*values, strict=True)))


def inertia_at_nodes(bodies: list[dict[str, Any]], ranges: list[Range]) -> dict[tuple[int, int], Box]:
    """Return M_ij, i <= j, at all nodes of the joints 2 .. n; the first joint stands at zero."""
    axes = len(bodies) - 1
    R, p = constant(np.eye(3).tolist()), constant([0.0] * 3)
    directions: list[list[Box]] = []
    origins: list[list[Box]] = []
    M: dict[tuple[int, int], Box] = {}
    for k, body in enumerate(bodies):
        if k:
            R, p = moved(R, p, body, k - 1, axes, ranges[k])
        directions.append([row[2] for row in R])
        origins.append(p)
        com = [x + y for x, y in zip(p, applied(R, constant(body["com"])), strict=True)]
        transposed = [list(column) for column in zip(*R, strict=True)]
        inertia = times(times(R, constant(body["inertia"])), transposed)
        for i, j, term in kinetic_terms(bodies[: k + 1], directions, origins, com, inertia, Box(body["mass"])):
            M[i, j] = M[i, j] + term if (i, j) in M else term
    return M


def moved(R: Any, p: Any, body: dict[str, Any], axis: int, axes: int, limits: Range) -> tuple[Any, Any]:
    """Return the pose of a body from that of its parent."""
    p = [x + y for x, y in zip(p, applied(R, constant(body["translation"])), strict=True)]
    R = times(R, constant(body["rotation"]))
    if body["prismatic"]:
        q = along_axis([(x, x) for x in nodes(body, *limits)], axis, axes)
        return R, [x + row[2] * q for x, row in zip(p, R, strict=True)]
    c, s = (along_axis([ends_of(f(node_angle(j))) for j in range(5)], axis, axes) for f in (iv.cos, iv.sin))
    return [[row[0] * c + row[1] * s, row[1] * c - row[0] * s, row[2]] for row in R], p


def kinetic_terms(
    bodies: list[dict[str, Any]],
    directions: list[list[Box]],
    origins: list[list[Box]],
    com: list[Box],
    inertia: list[list[Box]],
    mass: Box,
) -> Iterator[tuple[int, int, Box]]:
    """Yield m v_i . v_j + w_i . I w_j of the last body: v, w are its velocities for unit velocity of each joint."""
    linear = []
    for body, z, o in zip(bodies, directions, origins, strict=True):
        arm = [x - y for x, y in zip(com, o, strict=True)]
        linear.append(z if body["prismatic"] else cross(z, arm))
    turned = [applied(inertia, z) for z in directions]
    for j, other in enumerate(bodies):
        for i in range(j + 1):
            term = mass * dot(linear[i], linear[j])
            if not (bodies[i]["prismatic"] or other["prismatic"]):
                term = term + dot(directions[i], turned[j])
            yield i, j, term


# From values at the nodes to control values


@lru_cache(4096)
def control_map(prismatic: bool, a: float, b: float, at: tuple[float, ...]) -> tuple[Array, Array]:
    """Return the matrix from values at the nodes to control values on [a, b], and the radii of its entries."""
    if prismatic:
        rows = [[lagrange(at, j, u, v) for j in range(3)] for u, v in ((a, a), (a, b), (b, b))]
    elif b - a > FULL:
        rows = [[deconvolution(k - j) for j in range(5)] for k in range(5)]
    else:
        rows = arc_rows(iv.mpf(a), iv.mpf(b))
    low, high = (np.array([[ends_of(entry)[side] for entry in row] for row in rows]) for side in (0, 1))
    mid = (low + high) / 2
    return mid, np.nextafter(np.maximum(high - mid, mid - low), np.inf) * (1 + 1e-12)


def lagrange(at: tuple[float, ...], j: int, u: float, v: float) -> Any:
    """Return the blossom at (u, v) of the Lagrange polynomial of node j."""
    x, y = (iv.mpf(at[k]) for k in range(3) if k != j)
    node, first, second = iv.mpf(at[j]), iv.mpf(u), iv.mpf(v)
    return (first * second - (x + y) * (first + second) / 2 + x * y) / ((node - x) * (node - y))


def deconvolution(steps: int) -> Any:
    """Return the weight of a node `steps` nodes away: the inverse of the kernel 1 + 2 k_1 cos q + 2 k_2 cos 2q >= 0."""
    angle = node_angle(steps)
    return (1 + 2 * iv.cos(angle) / iv.mpf(KERNEL[0]) + 2 * iv.cos(2 * angle) / iv.mpf(KERNEL[1])) / 5


def arc_rows(a: Any, b: Any) -> list[list[Any]]:
    """Return control values on an arc of the trigonometric Lagrange polynomials D of the five nodes.

    With t = tan((q - m) / 2), m the middle of the arc, (1 + t^2)^2 D is a polynomial of degree 4. Its Bernstein
    coefficients, over those of (1 + t^2)^2, are the control values.
    """
    one, c1, s1, c2, s2 = [1, 0, 2, 0, 1], [1, 0, 0, 0, -1], [0, 2, 0, 2, 0], [1, 0, -6, 0, 1], [0, 4, 0, -4, 0]
    quarter = (b - a) / 4
    T = iv.sin(quarter) / iv.cos(quarter)
    weights = bernstein(one, T)
    columns = []
    for j in range(5):
        x = (a + b) / 2 - node_angle(j)
        factors = (1, 2 * iv.cos(x), -2 * iv.sin(x), 2 * iv.cos(2 * x), -2 * iv.sin(2 * x))
        powers = [sum(f * row[i] for f, row in zip(factors, (one, c1, s1, c2, s2), strict=True)) for i in range(5)]
        columns.append([value / (5 * weight) for value, weight in zip(bernstein(powers, T), weights, strict=True)])
    return [list(row) for row in zip(*columns, strict=True)]


def bernstein(powers: list[Any], T: Any) -> list[Any]:
    """Return the Bernstein coefficients on t = -T .. T of a polynomial of degree 4 with coefficients of 1 .. t^4."""
    found = []
    for k in range(5):
        value = iv.mpf(0)
        for i in range(5):
            signed = sum(
                comb(k, m) * comb(4 - k, i - m) * (-1) ** (i - m) for m in range(max(0, i + k - 4), min(i, k) + 1)
            )
            value += powers[i] * T**i * signed / comb(4, i)
        found.append(value)
    return found


# The inequality on the boxes


class Inequality:
    """A - beta M_l > 0: values (n (n + 1) / 2, ..) at the nodes, and bounds of their errors (n (n + 1) / 2,)."""

    def __init__(self, A: Box, M: dict[tuple[int, int], Box], beta: float, bodies: Any, ranges: list[Range]) -> None:
        self.pairs = sorted(M)
        self.n = len(bodies)
        self.prismatic = [bool(body["prismatic"]) for body in bodies[1:]]
        self.at = [tuple(nodes(body, *limits)) for body, limits in zip(bodies[1:], ranges[1:], strict=True)]
        shape = tuple(3 if slides else 5 for slides in self.prismatic)
        S = [A[i, j] - Box(beta) * M[i, j] for i, j in self.pairs]
        low, high = (np.stack([np.broadcast_to(side(entry), shape) for entry in S]) for side in (lower_end, upper_end))
        mid = (low + high) / 2
        radius = np.nextafter(np.maximum(high - mid, mid - low), np.inf)
        self.steps: list[tuple[Range | None, Array, Array]] = [(None, mid, largest(radius))]

    def holds(self, ranges: list[Range]) -> bool:
        """Return whether all control matrices on a box of the joints 2 .. n are proven positive definite."""
        for axis, limits in enumerate(ranges):
            if len(self.steps) > axis + 1 and self.steps[axis + 1][0] == limits:
                continue
            del self.steps[axis + 1 :]
            matrix, radius = control_map(self.prismatic[axis], *limits, self.at[axis])
            _, values, error = self.steps[axis]
            self.steps.append((limits, *mapped(matrix, radius, values, error, axis + 1)))
        _, values, error = self.steps[-1]
        values, error = values.reshape(len(values), -1), error[:, None]
        return eliminated(
            self.n, self.pairs, np.nextafter(values - error, -np.inf), np.nextafter(values + error, np.inf)
        )


def lower_end(entry: Box) -> Array:
    """Return the lower ends."""
    return entry.lo


def upper_end(entry: Box) -> Array:
    """Return the upper ends."""
    return entry.hi


def largest(values: Array) -> Array:
    """Return the largest absolute value of each entry (n (n + 1) / 2,)."""
    return np.asarray(np.max(np.abs(values).reshape(len(values), -1), axis=1))


def mapped(matrix: Array, radius: Array, values: Array, error: Array, axis: int) -> tuple[Array, Array]:
    """Return the values times a matrix along an axis, and the bounds of the errors of each entry."""
    size = np.abs(matrix) + radius
    rounding = np.max(np.sum(radius + 12 * 2.0**-53 * size, axis=1))
    grown = np.max(np.sum(size, axis=1)) * error + rounding * (largest(values) + error)
    found: Array = np.moveaxis(np.asarray(np.tensordot(matrix, values, axes=(1, axis)), dtype=float), 0, axis)
    return found, np.asarray(grown * (1 + 1e-14) + 2.0**-1000)


def eliminated(n: int, pairs: list[tuple[int, int]], low: Array, high: Array) -> bool:
    """Return whether Gaussian elimination in interval arithmetic has positive pivots for all matrices (.., k)."""
    if low.shape[1] > TOGETHER:
        parts = (slice(begin, begin + TOGETHER) for begin in range(0, low.shape[1], TOGETHER))
        return all(eliminated(n, pairs, low[:, part], high[:, part]) for part in parts)
    G = {pair: Box(*entry) for pair, *entry in zip(pairs, low, high, strict=True)}
    for i in range(n):
        if not np.all(G[i, i].lo > 0):
            return False
        inverse = G[i, i].inverse()
        for j in range(i + 1, n):
            factor = G[i, j] * inverse
            for k in range(j, n):
                G[j, k] = G[j, k] - factor * G[i, k]
    return True


def positive_definite(S: Box) -> bool:
    """Return whether a symmetric matrix (n, n) is proven positive definite."""
    n = len(S.lo)
    pairs = [(i, j) for i in range(n) for j in range(i, n)]
    low, high = (np.array([[side[pair]] for pair in pairs]) for side in (S.lo, S.hi))
    return eliminated(n, pairs, low, high)


def is_split(entry: list[Any], n: int) -> bool:
    """Return whether a list is a joint other than the first of n, and cuts."""
    joint, *cuts = entry
    return type(joint) is int and 0 < joint < n and all(type(cut) in (int, float) for cut in cuts)


def leaves(tree: list[Any], ranges: list[Range]) -> Iterator[list[Range]]:
    """Yield the boxes of a tree in preorder; raise RefusedError unless they cover the ranges."""
    left, entries = [ranges], iter(tree)
    while left:
        box = left.pop()
        entry = next(entries, None)
        if type(entry) is int and entry == 0:
            yield box
            continue
        if not (isinstance(entry, list) and len(entry) > 1 and is_split(entry, len(box))):
            raise RefusedError(f"the boxes do not cover the joint range: {entry!r} is neither a box nor a split")
        joint, ends = entry[0], [box[entry[0]][0], *map(float, entry[1:]), box[entry[0]][1]]
        if not all(a < b for a, b in zip(ends[:-1], ends[1:], strict=True)):
            raise RefusedError(f"the boxes do not cover the joint range: {ends} do not increase")
        parts = zip(ends[:-1], ends[1:], strict=True)
        left += reversed([[*box[:joint], part, *box[joint + 1 :]] for part in parts])
    if next(entries, None) is not None:
        raise RefusedError("there are boxes beside those that cover the joint range")


# The certificate


def checked(content: dict[str, Any], progress: Callable[[int], None] = lambda boxes: None) -> int:
    """Return the number of boxes of a certificate that proves its claim; raise RefusedError."""
    digest = content.pop("sha256", None)
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    if digest != hashlib.sha256(text.encode()).hexdigest():
        raise RefusedError("sha256 is not the digest of the other entries")
    bodies, ranges, beta, matrix = values_of(content)
    check_blocks(beta, matrix)
    M = inertia_at_nodes(bodies, ranges)
    inequality = Inequality(matrix["D_l"] + matrix["K_ld"], M, beta, bodies, ranges)
    boxes = 0
    for boxes, box in enumerate(leaves(content["boxes"], ranges), 1):
        if not inequality.holds(box[1:]):
            raise RefusedError(f"D_l + K_ld - beta M_l is not proven positive definite on the box {box}")
        progress(boxes)
    return boxes


def values_of(content: dict[str, Any]) -> tuple[list[dict[str, Any]], list[Range], float, dict[str, Box]]:
    """Return bodies, joint ranges, beta and matrices; raise RefusedError for values of a wrong kind."""
    if content.get("format") != "rate certificate 1":
        raise RefusedError(f"format is {content.get('format')!r}; expected 'rate certificate 1'")
    try:
        bodies, beta = list(content["bodies"]), float(content["beta"])
        n = len(bodies)
        ranges = [(float(a), float(b)) for a, b in zip(content["lower"], content["upper"], strict=True)]
        arrays = {name: np.array(content[name], dtype=float) for name in MATRICES}
        shapes = {"rotation": (3, 3), "inertia": (3, 3), "translation": (3,), "com": (3,), "mass": ()}
        parts = [(np.array(body[name], dtype=float), shape) for body in bodies for name, shape in shapes.items()]
        kinds = all(isinstance(body["prismatic"], bool) for body in bodies) and isinstance(content["boxes"], list)
        kinds = kinds and len(content["joints"]) == n and all(isinstance(name, str) for name in content["joints"])
        orthogonal = all(np.max(np.abs(R @ R.T - np.eye(3))) < ORTHOGONAL for R, shape in parts[:: len(shapes)])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RefusedError(f"a value is missing or of a wrong kind ({error!r})") from None
    sized = len(ranges) == n > 0 and all(array.shape == (n, n) for array in arrays.values())
    sized = sized and kinds and all(part.shape == shape for part, shape in parts)
    numbers = [np.ravel(array) for array in (*arrays.values(), *(part for part, _ in parts), np.array(ranges))]
    if not (sized and np.isfinite(np.concatenate(numbers)).all() and np.isfinite(beta) and beta > 0):
        raise RefusedError("a value has a wrong shape or is not finite")
    if not (orthogonal and all(a <= b for a, b in ranges)):
        raise RefusedError("a rotation is not orthogonal, or a joint range is empty")
    if not all(is_physical(float(body["mass"]), np.array(body["inertia"], dtype=float)) for body in bodies):
        raise RefusedError("a body has a negative mass, or an inertia that is not positive semidefinite")
    return bodies, ranges, beta, {name: Box(array) for name, array in arrays.items()}


def is_physical(mass: float, inertia: Array) -> bool:
    """Return whether mass and inertia (3, 3) have no negative kinetic energy."""
    size = float(np.max(np.abs(inertia)))
    symmetric = bool(np.max(np.abs(inertia - inertia.T)) <= 1e-12 * size)
    return mass >= 0 and symmetric and bool(np.linalg.eigvalsh(inertia)[0] >= -1e-12 * size)


def check_blocks(beta: float, matrix: dict[str, Box]) -> None:
    """Raise RefusedError unless the blocks of the position errors and of the motors have the rate beta."""
    for name in ("D_l", "K_ld", "D_m", "K_md", "M_m", "Pi_l", "Pi_m"):
        array = matrix[name].lo
        if np.max(np.abs(array - array.T)) > 0:
            raise RefusedError(f"{name} is not symmetric")
    blocks = {"D_m + K_md - beta M_m": matrix["D_m"] + matrix["K_md"] - Box(beta) * matrix["M_m"]}
    for side in "lm":
        Pi, Lambda, Gamma = (matrix[f"{name}_{side}"] for name in ("Pi", "Lambda", "Gamma"))
        blocks |= {f"Pi_{side}": Pi, f"sym(Pi_{side} Lambda_{side}) - beta Pi_{side}": rate_block(Pi, Lambda, beta)}
        cubic = Pi.lo @ Gamma.lo
        if np.any(np.abs(cubic - np.diag(np.diag(cubic))) > 1e-12 * np.max(np.abs(cubic))) or np.any(
            np.diag(cubic) < 0
        ):
            raise RefusedError(f"Pi_{side} Gamma_{side} is not diagonal and nonnegative")
    for name, block in blocks.items():
        if not positive_definite(block):
            raise RefusedError(f"{name} is not proven positive definite")


def rate_block(Pi: Box, Lambda: Box, beta: float) -> Box:
    """Return (Pi Lambda + Lambda' Pi) / 2 - beta Pi."""
    n = len(Pi.lo)
    product = [
        [dot([Pi[i, k] for k in range(n)], [Lambda[k, j] for k in range(n)]) for j in range(n)] for i in range(n)
    ]
    rows = [[(product[i][j] + product[j][i]) * Box(0.5) - Box(beta) * Pi[i, j] for j in range(n)] for i in range(n)]
    return Box(*(np.array([[side(entry) for entry in row] for row in rows]) for side in (lower_end, upper_end)))


def main(arguments: list[str]) -> int:
    """Check one file; return the exit code."""
    if len(arguments) != 1:
        print("usage: python tools/check_certificate.py FILE", file=sys.stderr)
        return 2
    try:
        with open(arguments[0], encoding="utf-8") as file:
            content = json.load(file)
        if not isinstance(content, dict):
            raise RefusedError("it is not a JSON object")
        boxes = checked(content)
    except (OSError, ValueError, RecursionError, RefusedError) as error:
        print(f"{arguments[0]}: refused: {error}", file=sys.stderr)
        return 1
    joints = ", ".join(map(str, content["joints"]))
    print(f"{arguments[0]}: proven: beta = {content['beta']:.6g} 1/s on {boxes} boxes, joints {joints}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
