# SPDX-License-Identifier: Apache-2.0
"""Triangle meshes of a URDF: read by trimesh and pycollada, reduced to few triangles, packed for arm.js."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.errors import FjrError

LARGEST = 64 * 2**20  # bytes of a file
MOST_NODES = 10_000  # of a COLLADA scene; nodes that instance each other in two places multiply
CELLS = (4096, 256, 160, 112, 80, 56, 40, 28, 20, 14, 10, 7, 5)  # along the longest side; the first joins equal points
STEPS = 65535  # of a packed coordinate


class MeshError(FjrError):
    """A mesh cannot be read."""


@dataclass(frozen=True)
class Mesh:
    """Vertices (v, 3) [m] and triangles (m, 3) of vertex indices."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]

    def packed(self) -> dict[str, Any]:
        """Return the mesh as values for arm.js: 16 bits a coordinate, from `low` in steps of `step` [m]."""
        low = self.vertices.min(axis=0)
        step = np.maximum(np.ptp(self.vertices, axis=0), 1e-9) / STEPS
        return {
            "low": low.tolist(),
            "step": step.tolist(),
            "vertices": _text(np.rint((self.vertices - low) / step).astype("<u2")),
            "triangles": _text(self.triangles.astype("<u4" if len(self.vertices) > STEPS else "<u2")),
            "wide": len(self.vertices) > STEPS,
        }


def read_mesh(path: Path, scale: tuple[float, ...]) -> Mesh:
    """Read an STL, OBJ, DAE or other mesh file that trimesh knows, scaled by (3,); raises MeshError in one sentence."""
    if path.is_file() and path.stat().st_size > LARGEST:
        raise MeshError(f"{path} has more than {LARGEST // 2**20} MiB")
    try:
        corners = (_collada if path.suffix.lower() == ".dae" else _mesh)(path)
    except ImportError as error:
        raise MeshError(f"the package {error.name}, which reads meshes, is not installed") from None
    except Exception:  # the readers raise many types
        raise MeshError(f"{path} cannot be read as a mesh") from None
    if not (len(corners) and np.isfinite(corners).all()):
        raise MeshError(f"{path} has no triangle, or a vertex that is not finite")
    return Mesh(corners.reshape(-1, 3) * scale, np.arange(3 * len(corners)).reshape(-1, 3))


def _mesh(path: Path) -> NDArray[np.float64]:
    """Return the corners (m, 3, 3) of all triangles of a file."""
    import trimesh

    mesh = trimesh.load_mesh(path, process=False, skip_materials=True)
    return np.asarray(mesh.vertices, dtype=float)[mesh.faces]


def _collada(path: Path) -> NDArray[np.float64]:
    """Return the corners (m, 3, 3) of all triangles of a COLLADA scene; raise ValueError beyond MOST_NODES.

    pycollada skips what it cannot read, such as textures. trimesh has no limit of nodes.
    """
    from collada import Collada, DaeError
    from collada.polylist import Polylist
    from collada.scene import GeometryNode
    from collada.triangleset import TriangleSet

    def placed(node: Any, pose: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
        if next(nodes) > MOST_NODES:
            raise ValueError(f"more than {MOST_NODES} nodes")
        for part in node.geometry.primitives if isinstance(node, GeometryNode) else ():
            triangles = part.triangleset() if isinstance(part, Polylist) else part
            if isinstance(triangles, TriangleSet):
                yield (triangles.vertex @ pose[:3, :3].T + pose[:3, 3])[triangles.vertex_index]
        for child in getattr(node, "children", ()):
            yield from placed(child, pose @ getattr(node, "matrix", np.eye(4)))

    nodes = count(1)
    document = Collada(str(path), ignore=[DaeError])
    return np.concatenate([part for node in document.scene.nodes for part in placed(node, np.eye(4))])


def decimated(mesh: Mesh, most: int) -> Mesh:
    """Return the mesh with at most about `most` triangles: vertices of one cell of a grid become their mean."""
    for cells in CELLS:
        reduced = _clustered(mesh, cells)
        if len(reduced.triangles) <= most:
            break
    return reduced


def _clustered(mesh: Mesh, cells: int) -> Mesh:
    low = mesh.vertices.min(axis=0)
    side = max(float(np.ptp(mesh.vertices, axis=0).max()), 1e-9) / cells
    key = ((mesh.vertices - low) / side).astype(np.int64) @ np.array([1, 2**20, 2**40])
    _, place, count = np.unique(key, return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(place, column) for column in mesh.vertices.T], axis=1)
    corners = place[mesh.triangles]
    a, b, c = corners.T
    return Mesh(sums / count[:, None], corners[(a != b) & (b != c) & (c != a)])


def _text(numbers: NDArray[Any]) -> str:
    return base64.b64encode(numbers.tobytes()).decode()
