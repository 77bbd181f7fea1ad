"""The robot's own shapes and meshes in a recording."""

from dataclasses import replace

import numpy as np
import pytest
from reading import read, static

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp.robot import Shape
from microbot_ocp.views.recording import of_motion

CORNERS = 0.1 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])


def motion_of(robot):
    shape = mo.cubic([[0, 0, 0], [0.5, 0.4, 0.3]], [0, 1.0])
    return mo.Motion.from_polynomial(robot, shape, label="cubic")


@pytest.fixture
def tetrahedron(tmp_path):
    """A mesh file of four triangles."""
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + [
        f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces
    ]
    path = tmp_path / "tetrahedron.obj"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_shapes_and_meshes_stand_for_the_capsules(microbot, tetrahedron, tmp_path):
    pytest.importorskip("trimesh")
    pose = np.eye(4)
    pose[:3, 3] = (0.0, 0.0, 0.3)
    shapes = (
        Shape(0, np.eye(4), "box", [0.2, 0.3, 0.4], "visual", "base"),
        Shape(1, pose, "capsule", [0.1, 0.5], "visual", "one", color=(1.0, 0.0, 0.0, 1.0)),
        Shape(2, pose, "mesh", [2.0, 2.0, 2.0], "visual", "two", str(tetrahedron)),
        Shape(3, np.eye(4), "sphere", [0.2], "collision", "three"),
        Shape(1, pose, "box", [9.0, 9.0, 9.0], "collision", "one"),
    )
    robot = replace(microbot, shapes=shapes)
    path = of_motion(robot, motion_of(robot)).save(tmp_path / "arm.rrd")
    arm = "/world/motion"
    half = static(path, f"{arm}/link_0/geometry_1", "Boxes3D:half_sizes")
    np.testing.assert_allclose(half, [[0.1, 0.15, 0.2]], rtol=1e-6)
    place = static(path, f"{arm}/link_1/geometry_2", "Transform3D:translation")
    below = static(path, f"{arm}/link_1/geometry_2", "Capsules3D:translations")
    np.testing.assert_allclose(np.add(place, below), [[0.0, 0.0, 0.05]], atol=1e-7)
    vertices = static(path, f"{arm}/link_2/geometry_3", "Mesh3D:vertex_positions")
    assert len(vertices) == 4 or len(vertices) == 12
    np.testing.assert_allclose(np.max(vertices, axis=0), [0.2, 0.2, 0.2], rtol=1e-6)
    static(path, f"{arm}/link_3/geometry_4", "Ellipsoids3D:half_sizes")
    with refused("expected 1", "got 0", error=ValueError):
        static(path, f"{arm}/link_2/shape", "Capsules3D:lengths")


def test_a_mesh_that_is_missing_is_told_and_capsules_stand_in(microbot, tmp_path):
    gone = str(tmp_path / "gone.stl")
    shapes = (Shape(1, np.eye(4), "mesh", [1, 1, 1], "visual", "one", gone),)
    robot = replace(microbot, shapes=shapes)
    path = of_motion(robot, motion_of(robot)).save(tmp_path / "arm.rrd")
    assert static(path, "/world/motion/link_2/shape", "Capsules3D:lengths")
    (text,) = static(path, "/summary", "TextDocument:text")
    tells(text, "capsules", "gone.stl")

    assert read(path, "/world/motion/link_1", "Transform3D:translation")
