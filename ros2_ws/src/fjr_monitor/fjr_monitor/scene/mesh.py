# SPDX-License-Identifier: Apache-2.0
"""Triangle meshes of a URDF: read by Pinocchio's collision library, reduced to few triangles, packed for arm.js."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree.ElementTree import ParseError

import numpy as np
from numpy.typing import NDArray

from fjr_core.errors import FjrError
from fjr_monitor.scene.mesh_parts import in_one_level

LARGEST = 64 * 2**20  # bytes of a file
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
    """Read an STL, OBJ, DAE or other mesh file that Assimp knows, scaled by (3,); raises MeshError in one sentence."""
    try:
        import coal  # with Pinocchio; a URDF without meshes needs neither
    except ImportError:
        raise MeshError("the package coal, which comes with Pinocchio and reads meshes, is not installed") from None
    try:
        if path.stat().st_size > LARGEST:
            raise MeshError(f"{path} has more than {LARGEST // 2**20} MiB")
        with TemporaryDirectory() as folder:
            readable = path
            if (content := in_one_level(path)) is not None:
                readable = Path(folder, f"mesh{path.suffix}")
                readable.write_bytes(content)
            model = coal.MeshLoader(coal.BV_AABB).load(str(readable), np.array(scale))
        triangles = [[corner[0], corner[1], corner[2]] for corner in map(model.tri_indices, range(model.num_tris))]
        mesh = Mesh(np.array(model.vertices()), np.array(triangles, dtype=np.int64).reshape(-1, 3))
    except (OSError, ValueError, RuntimeError, ParseError):
        raise MeshError(f"{path} cannot be read as a mesh") from None
    if not (len(mesh.triangles) and np.isfinite(mesh.vertices).all()):
        raise MeshError(f"{path} has no triangle, or a vertex that is not finite")
    return mesh


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
