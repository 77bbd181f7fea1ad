"""Films: what they show, and their files."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.tasks import Cell
from microbot_ocp.views import _palette as palette
from microbot_ocp.views.animation import Film, write_animation
from microbot_ocp.views.recording import of_branches, of_cell, of_motion


@pytest.fixture(scope="module")
def robot() -> mo.Robot:
    return mo.load_robot("planar_2r")


@pytest.fixture(scope="module")
def motion(robot: mo.Robot) -> mo.Motion:
    shape = mo.cubic([[0.0, 0.0], [0.6, 0.9]], [0.0, 0.3])
    return mo.Motion.from_polynomial(robot, shape, label="cubic")


@pytest.fixture(scope="module")
def film(robot: mo.Robot, motion: mo.Motion) -> Film:
    return Film(of_motion(robot, motion))


def test_the_arm_moves_and_the_paper_stays(film: Film) -> None:
    first, last = film.frame(0.0), film.frame(0.3)
    assert first.shape == (450, 800, 3)
    assert (first[0, 0] == 255).all()
    changed = (first != last).any(axis=2)
    assert 0.005 < changed.mean() < 0.4
    np.testing.assert_array_equal(film.frame(0.0), first)


def test_the_tool_is_where_the_camera_sees_it(film: Film, robot: mo.Robot) -> None:
    """The end of the trail is the tool's position in the picture."""
    film.frame(0.3)
    tool = np.array(mo.forward_kinematics(robot)([0.6, 0.9]))[:3, 3]
    expected, _ = film.camera.project(tool)
    drawn = film.trails[-1].get_xydata()[-1]
    np.testing.assert_allclose(drawn, expected, atol=1e-6)


def test_a_gif_has_a_frame_each_40_ms_and_holds_the_last(
    robot: mo.Robot, motion: mo.Motion, tmp_path
) -> None:
    path = motion.export(tmp_path / "a.gif", rate=10.0, robot=robot)
    with Image.open(path) as picture:
        durations = []
        for k in range(picture.n_frames):
            picture.seek(k)
            durations.append(picture.info["duration"])
    assert durations == [100, 100, 100, 1600]


def test_mp4(robot: mo.Robot, motion: mo.Motion, tmp_path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = motion.export(tmp_path / "a.mp4", rate=5.0, robot=robot, theme="dark")
    described = next(ffmpeg.read_frames(str(path)))
    assert described["size"] == (1280, 720)
    assert described["fps"] == 5.0


def test_what_cannot_be_filmed_is_refused(
    robot: mo.Robot, motion: mo.Motion, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with refused(".gif", "robot=..."):
        motion.export(tmp_path / "a.gif")
    with refused("path", ".gif", "'.avi'"):
        motion.export(tmp_path / "a.avi", robot=robot)
    with refused("rate", "50 Hz", "100"):
        motion.export(tmp_path / "a.gif", 100.0, robot)
    solution = mo.solve_ik(mo.load_robot("microbot"), [3.0, -1.0, 4.5])
    still = of_branches(mo.load_robot("microbot"), [solution], np.array([3.0, -1.0, 4.5]))
    with refused("recording", "moves"):
        write_animation(still, tmp_path / "a.gif")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with refused("imageio-ffmpeg", "pip install 'microbot_ocp[export]'"):
        motion.export(tmp_path / "a.mp4", rate=5.0, robot=robot)
    assert not list(tmp_path.iterdir())


def test_a_film_tells_which_frame_it_draws(robot, motion, tmp_path):
    steps = []
    write_animation(of_motion(robot, motion), tmp_path / "a.gif", 5.0, progress=steps.append)
    assert [step.done for step in steps] == list(range(steps[-1].total))


@pytest.mark.thorough
def test_large_meshes_are_drawn_more_coarsely(tmp_path) -> None:
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(subdivisions=5, radius=0.2).export(tmp_path / "ball.stl")
    link = '<visual><geometry><mesh filename="ball.stl"/></geometry></visual>'
    (tmp_path / "ball.urdf").write_text(
        f'<robot name="ball"><link name="base"/><link name="ball">{link}</link>'
        '<joint name="turn" type="revolute"><parent link="base"/><child link="ball"/>'
        '<origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    robot = mo.load_robot(tmp_path / "ball.urdf")
    shape = mo.cubic([[0.0], [0.5]], [0.0, 1.0])
    film = Film(of_motion(robot, mo.Motion.from_polynomial(robot, shape, label="cubic")))
    film.frame(0.5)
    drawn = film.bodies[-1].get_paths()
    assert 1_000 < len(drawn) < 12_000  # half of what is there looks away
    corners = np.concatenate([path.vertices for path in drawn])
    middle, _ = film.camera.project(np.array([0.5, 0.0, 0.0]))
    assert np.abs(corners.mean(axis=0) - middle).max() < 0.05 * np.ptp(corners)


def test_a_film_of_a_cell_shows_obstacles_tubes_and_the_part_on_its_way(robot: mo.Robot) -> None:
    part = mo.Payload(0.1, shape=mo.Capsule([0, 0, 0], [0.0, 0.0, 0.05], 0.06))
    first, last = [0.3, 0.4], [-0.6, 0.5]
    places = [np.array(mo.forward_kinematics(robot)(q))[:3, 3] for q in (first, [0.0, 0.5], last)]
    stops = (
        mo.Stop(position=places[0], payload=part, name="pick"),
        mo.Stop(position=places[1], payload=0, name="place"),
        mo.Stop(q=last, name="away"),
    )
    shape = mo.cubic([first, [0.0, 0.5], last], [0.0, 0.5, 1.0])
    marks = [mo.motion.Mark(0.5 * k, stop.name) for k, stop in enumerate(stops)]
    motion = mo.Motion.from_polynomial(robot, shape, label="cubic", marks=marks)
    post = mo.Cylinder(0.05, 0.4, [0.2, -0.5, 0.1], "post")
    scene = mo.Scene([post, mo.HalfSpace([0, 1, 0], -1.2, "floor"), mo.HalfSpace([1, 0, 0], -1.5)])
    segments = (mo.Line(tolerance=0.02), None)
    certificate = mo.certify(robot, motion)
    cell = Cell(robot, stops, segments, False, motion, certificate, scene)
    around = Cell(robot, stops[:2], None, True, motion, certificate, scene)
    assert of_cell(around).place_names == ("pick", "place")
    film = Film(of_cell(cell))
    frames: dict[float, np.ndarray] = {}
    wanted = {"post": (palette.OBSTACLE, 0), "part": (palette.PART, 1), "tube": (palette.TUBE, 2)}

    def shown(t: float, place: np.ndarray, name: str) -> bool:
        """Whether a colour is seen within five pixels of a place."""
        if t not in frames:
            frames[t] = film.frame(t).astype(float)
        picture = frames[t]
        x, y = film.space.transData.transform(film.camera.project(np.asarray(place))[0])
        here = picture[449 - int(y) - 5 : 449 - int(y) + 6, int(x) - 5 : int(x) + 6].reshape(-1, 3)
        hue = np.array(wanted[name][0][:3], dtype=float)
        spread = np.linalg.norm(here, axis=1)
        alike = here @ hue / np.maximum(spread * np.linalg.norm(hue), 1e-9)
        return bool(((alike > 0.99) & (spread > 60) & (np.ptp(here, axis=1) > 25)).any())

    up = np.array([0.0, 0.0, 0.05])
    tool = motion.sample([0.25]).q[0]
    there = np.array(mo.forward_kinematics(robot)(tool))[:3, 3] + up
    above = [place + up for place in places]
    assert shown(0.0, [0.2, -0.5, 0.1], "post")
    assert shown(0.9, (places[0] + places[1]) / 2, "tube")
    assert [shown(t, above[0], "part") for t in (0.0, 0.4, 0.95)] == [True, False, False]
    assert [shown(t, above[1], "part") for t in (0.0, 0.95)] == [False, True]
    assert shown(0.25, there, "part")
    assert film.floor == -1.2
    film.frame(1.0)
    assert "apart" in film.gap_text.get_text()


def test_a_long_title_ends_before_the_panels(robot: mo.Robot, motion: mo.Motion) -> None:
    film = Film(
        of_motion(robot, motion), title="an arm with a name as long as names can be: a motion"
    )
    title = next(text for text in film.figure.texts if text.get_text().startswith("an arm"))
    assert title.get_window_extent().x1 < 0.69 * film.figure.bbox.width


@pytest.mark.parametrize(
    "names",
    [
        ("panda_joint1", "panda_joint2"),
        ("shoulder_pan_joint", "elbow"),
        ("joint 1", "a_name_of_four_words"),
        ("withoutanyunderscore", "x"),
    ],
)
def test_panels_have_the_names_of_the_joints(
    robot: mo.Robot, motion: mo.Motion, names: tuple[str, str]
) -> None:
    film = Film(of_motion(replace(robot, joint_names=names), motion))
    film.frame(0.1)
    for cursor, name in zip(film.cursors, names, strict=True):
        (label,) = cursor.axes.get_yticklabels()
        assert label.get_text().replace("\n", "") == name
        assert label.get_window_extent().x0 > 0.6 * film.figure.bbox.width  # beside the arm
