# SPDX-License-Identifier: Apache-2.0
"""Scene of a URDF: primitives, meshes, else a skeleton and a sentence on what is missing."""

from __future__ import annotations

import base64
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fjr_core.errors import RobotError
from fjr_monitor import scene as urdf_scene
from fjr_monitor.scene import Mesh, MeshError, decimated, read_mesh, scene

INERTIAL = """<inertial><origin xyz="0 0 0.2"/><mass value="1"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>"""


def arm(visual: str = "", material: str = "") -> str:
    """A URDF of two links: `visual` is that of the first."""
    return f"""<robot name="arm">{material}
      <link name="base">{visual}</link><link name="tip">{INERTIAL}</link>
      <joint name="turn" type="revolute"><parent link="base"/><child link="tip"/><origin xyz="0 0 0.5"/>
      <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def visual(geometry: str) -> str:
    return (
        f'<visual><origin xyz="1 2 3" rpy="0.1 0.2 0.3"/><geometry>{geometry}</geometry><material name="red"/></visual>'
    )


def ball(path: Path, rings: int) -> Path:
    """Write a unit sphere as binary STL, whose triangles share no vertex."""
    polar, around = np.linspace(0, np.pi, rings), np.linspace(0, 2 * np.pi, 2 * rings)
    grid = np.array([[np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)] for a in polar for b in around])
    corner = np.arange(len(grid)).reshape(rings, 2 * rings)
    squares = [corner[i : rings - 1 + i, j : 2 * rings - 1 + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    triangles = np.vstack([np.stack([squares[i] for i in order], 1) for order in ((0, 1, 2), (0, 2, 3))])
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *grid[each].ravel(), 0) for each in triangles)
    path.write_bytes(b" " * 80 + struct.pack("<I", len(triangles)) + body)
    return path


OBJ = """mtllib two.mtl
o first
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
usemtl steel
f 1 2 3
usemtl cable
f 1 2 4
l 1 4
g second
f 1 3 4
f 2 3 4
"""
COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="shape"><mesh>
  <source id="points"><float_array id="numbers" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array><technique_common>
    <accessor source="#numbers" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
    <param name="Z" type="float"/></accessor></technique_common></source>
  <vertices id="corners"><input semantic="POSITION" source="#points"/></vertices>
  <triangles material="steel" count="1"><input semantic="VERTEX" source="#corners" offset="0"/><p>0 1 2</p></triangles>
  <triangles material="cable" count="3"><input semantic="VERTEX" source="#corners" offset="0"/>
    <p>0 1 3 0 2 3 1 2 3</p></triangles>
</mesh></geometry></library_geometries>
<library_nodes><node id="kept"><scale>2 2 2</scale><instance_geometry url="#shape"/></node></library_nodes>
<library_visual_scenes><visual_scene id="scene"><node><instance_geometry url="#shape"/>
  <node><translate>5 0 0</translate><rotate>0 0 1 90</rotate><node><translate>0 0 7</translate>
    <instance_geometry url="#shape"/><instance_node url="#kept"/></node></node>
</node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>"""


def faces(mesh: Mesh) -> list[list[tuple[float, ...]]]:
    """The corners of each triangle, in an order that depends on nothing but them."""
    return sorted(sorted(map(tuple, corners)) for corners in mesh.vertices[mesh.triangles].round(4).tolist())


def tetrahedron(points: NDArray[np.float64]) -> list[list[tuple[float, ...]]]:
    return faces(Mesh(points, np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])))


def kinds(found: dict[str, Any], link: str) -> list[str]:
    return [shape["kind"] for shape in found["links"][link]]


@pytest.mark.parametrize(
    ("geometry", "size"),
    [
        ('<box size="1 2 3"/>', [1, 2, 3]),
        ('<sphere radius="2"/>', [2]),
        ('<cylinder radius="1" length="4"/>', [1, 4]),
    ],
)
def test_a_primitive_keeps_size_origin_and_colour_beside_the_skeleton(geometry: str, size: list[float]) -> None:
    found = scene(arm(visual(geometry), '<material name="red"><color rgba="1 0.5 0 1"/></material>'))
    bone, shape = found["links"]["base"]
    assert (bone["kind"], bone["to"]) == ("capsule", [0, 0, 0.5])  # to the joint
    assert shape["size"] == size
    assert (shape["xyz"], shape["rpy"], shape["colour"]) == ([1, 2, 3], [0.1, 0.2, 0.3], "#ff8000")
    bare = scene(arm())
    assert (kinds(found, "tip"), kinds(bare, "base"), kinds(bare, "tip")) == (["hub"], ["capsule"], ["capsule", "hub"])
    bone, hub = bare["links"]["tip"]
    assert bone["to"] == [0, 0, 0.4]  # through the centre of mass
    assert np.cross(hub["to"], [0, 1, 0]).tolist() == [0, 0, 0]  # along the joint's axis
    assert found["notes"] == bare["notes"] == []


NOT_DRAWN = {
    '<mesh filename="package://nowhere/link.stl"/>': "nowhere",
    '<mesh filename="/nowhere/link.stl"/>': "does not exist",
    '<mesh filename="{empty}"/>': "has no triangle",
    '<box size="1 2"/>': "not valid",
    '<box size="1 2 nan"/>': "not valid",
    "<torus/>": "not valid",
    "": "not valid",
}


@pytest.mark.parametrize("geometry", NOT_DRAWN)
def test_a_link_that_cannot_be_drawn_is_a_skeleton_with_a_sentence(tmp_path: Path, geometry: str) -> None:
    (tmp_path / "empty.stl").write_text("nothing")
    found = scene(arm(visual(geometry.replace("{empty}", str(tmp_path / "empty.stl")))))
    (note,) = found["notes"]
    assert note.startswith("a visual of link 'base' is not shown: ")
    assert NOT_DRAWN[geometry] in note
    assert "\n" not in note
    assert kinds(found, "base") == ["capsule"]


@pytest.mark.parametrize("text", ["<robot/>", "hello", "<!DOCTYPE robot><robot/>"])
def test_what_is_no_urdf_is_refused(text: str) -> None:
    with pytest.raises(RobotError):
        scene(text)


def corners(mesh: dict[str, Any]) -> NDArray[np.uint16]:
    """The numbers of the corners of all triangles of a packed mesh."""
    return np.frombuffer(base64.b64decode(mesh["triangles"]), "<u2")


def test_a_mesh_is_scaled_packed_and_shared_and_all_together_stay_small(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = ball(tmp_path / "ball.stl", 20)
    found = scene(arm(2 * visual(f'<mesh filename="file://{name}" scale="2 2 2"/>')))
    assert [shape["mesh"] for shape in found["links"]["base"]] == [0, 0]
    (mesh,) = found["meshes"]
    steps = np.frombuffer(base64.b64decode(mesh["vertices"]), "<u2").reshape(-1, 3)
    assert np.linalg.norm(mesh["low"] + steps * mesh["step"], axis=1) == pytest.approx(2.0, abs=1e-4)
    assert corners(mesh).max() < len(steps)
    monkeypatch.setattr(urdf_scene, "TRIANGLES", 1000)
    paths = [ball(tmp_path / f"{i}.stl", 30) for i in range(3)]
    found = scene(arm("".join(visual(f'<mesh filename="{path}"/>') for path in paths)))
    assert sum(len(corners(each)) / 3 for each in found["meshes"]) <= 1000


def test_a_large_mesh_is_reduced_and_keeps_its_size_and_equal_vertices_are_joined(tmp_path: Path) -> None:
    mesh = read_mesh(ball(tmp_path / "ball.stl", 60), (1.0, 1.0, 1.0))
    assert len(mesh.triangles) > 10_000
    reduced = decimated(mesh, 2000)
    assert 500 < len(reduced.triangles) <= 2000
    assert np.linalg.norm(reduced.vertices, axis=1) == pytest.approx(1.0, abs=0.05)
    assert np.ptp(reduced.vertices, axis=0) == pytest.approx(2.0, abs=0.05)
    square = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    joined = decimated(Mesh(square, np.arange(6).reshape(2, 3)), 10)
    assert len(joined.vertices) == 4
    shape = joined.vertices[joined.triangles]
    assert np.linalg.norm(np.cross(shape[:, 1] - shape[:, 0], shape[:, 2] - shape[:, 0]), axis=1) == pytest.approx(1.0)


def test_an_obj_keeps_the_triangles_of_every_material_and_group(tmp_path: Path) -> None:
    (tmp_path / "two.obj").write_text(OBJ)
    mesh = read_mesh(tmp_path / "two.obj", (1.0, 1.0, 3.0))
    assert faces(mesh) == tetrahedron(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 3]]))


def test_a_collada_file_keeps_every_primitive_in_every_node(tmp_path: Path) -> None:
    (tmp_path / "two.dae").write_text(COLLADA)
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    turned = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # a row by this: by 90 degrees about z
    placed = [points, points @ turned + [5, 0, 7], 2 * points @ turned + [5, 0, 7]]
    expected = sorted(face for each in placed for face in tetrahedron(each))
    assert faces(read_mesh(tmp_path / "two.dae", (1.0, 1.0, 1.0))) == expected
    (tmp_path / "inches.dae").write_text(COLLADA.replace('meter="1"', 'name="inch" meter="0.0254"'))
    metres, inches = (read_mesh(tmp_path / name, (1.0, 1.0, 1.0)).vertices for name in ("two.dae", "inches.dae"))
    np.testing.assert_allclose(inches, 0.0254 * metres, atol=1e-15)


def with_nodes_that_multiply() -> str:
    """Return a file whose nodes hold 2^40 instances."""
    twice = "".join(f'<node id="n{i}">' + 2 * f'<instance_node url="#n{i + 1}"/>' + "</node>" for i in range(40))
    text = COLLADA.replace("<library_visual_scenes>", f"<library_nodes>{twice}</library_nodes><library_visual_scenes>")
    first = text.index("<node", text.index("<visual_scene"))
    return text[:first] + '<node><instance_node url="#n0"/></node>' + text[first:]


@pytest.mark.parametrize(
    "text",
    ["", "<COLLADA>", "<COLLADA/>", COLLADA.replace("#scene", "#none"), "<a>\xff</a>", with_nodes_that_multiply()],
    ids=["empty", "not closed", "nothing", "no scene", "no UTF-8", "endless"],
)
def test_a_collada_file_without_a_scene_that_can_be_drawn_is_refused_in_a_sentence(tmp_path: Path, text: str) -> None:
    (tmp_path / "bad.dae").write_text(text, encoding="latin-1")
    with pytest.raises(MeshError, match=r"bad.dae cannot be read as a mesh$"):
        read_mesh(tmp_path / "bad.dae", (1.0, 1.0, 1.0))


@pytest.mark.parametrize("rgba", ["1 0 0", "red", ""])
def test_what_does_not_matter_does_not_keep_the_arm_from_being_drawn(rgba: str) -> None:
    """An invalid colour, a far joint, an undeclared prefix and a bad inertia of a link at rest."""
    material = f'<material name="red"><color rgba="{rgba}"/></material>'
    bad = '<inertial><origin xyz="a b c"/><mass value="-1"/></inertial>'
    text = arm(visual('<box size="1 1 1"/>') + bad, material).replace("0 0 0.5", "0 0 5e8")
    found = scene(text.replace("</robot>", "<gazebo><sim:plugin/></gazebo></robot>"))
    (box,) = (each for each in found["links"]["base"] if each["kind"] == "box")
    assert box["colour"] is None
    assert [(each["name"], each["xyz"]) for each in found["joints"]] == [("turn", (0, 0, 5e8))]
