"""Scenes as data and files, proved clearance, motions that go around."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp._base.deadline import processor_time
from microbot_ocp._base.outcome import Outcome
from microbot_ocp.ocp.solution import quiet
from microbot_ocp.planning.search import (
    LegPlanner,
    ProvedPath,
    SolveRequest,
    _guided as guided,
    at_least,
    parts_of,
    scenes_of,
    tool_poses,
)
from microbot_ocp.planning.task import Task, reach_of, task_of
from microbot_ocp.scene import FIRST_SEARCHES, contact_model, room_along

ARM = mo.load_robot("planar_3r")
ARM = ARM.with_capsules(mo.robot.link_capsules(ARM))
POST = mo.Scene([mo.Sphere([0.75, 0.2, 0.0], 0.15, "post")])
ENDS = np.array([[-0.6, 0.3, 0.2], [0.9, 0.3, 0.2]])


# data ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: mo.Sphere([0, 0, 0], 0.0), ("radius", "sphere", "0 m", "0.0")),
        (lambda: mo.Box([1, 1, -1]), ("every edge", "box", "0 m", "-1.0")),
        (lambda: mo.Box([1, 1, 1], 2 * np.eye(4)), ("pose", "box", "homogeneous", "0 0 0 1")),
        (lambda: mo.HalfSpace([0, 0, 0]), ("normal", "half space", "direction", "[0, 0, 0]")),
        (lambda: mo.scene.ConvexMesh(np.eye(3)), ("vertices", "mesh", "4 that")),
        (lambda: mo.Scene([1.0]), ("obstacles", "Sphere, Box, Capsule", "1.0")),
        (lambda: mo.Scene([mo.Box([1, 1, 1], name="a")] * 2), ("names", "obstacles", "'a'")),
        (lambda: mo.Scene([], clearance=-1), ("clearance", "0 m", "not -1")),
        (lambda: mo.Scene([], ignore=["ab"]), ("ignore", "pairs", "'ab'")),
        (
            lambda: mo.Scene([], ignore=[("arm", "b")]).pairs(ARM),
            ("ignore", "elbow, shoulder, wrist", "'arm'"),
        ),
        (lambda: ARM.with_capsules({7: []}), ("capsules", "0 (base) to 3", "'wrist'", "not 7")),
        (lambda: ARM.with_capsules({1: [POST]}), ("capsules", "mo.Capsule", "Scene(")),
        (lambda: mo.robot.link_capsules(ARM, -1.0), ("radius", "0 m", "not -1")),
        (lambda: mo.load_robot("ur5e").with_part(), ("robot", "capsules", "robot.with_capsules")),
    ],
)
def test_bad_input_is_one_sentence(make, said: tuple[str, ...]) -> None:
    with refused(*said):
        make()


def test_pairs_are_links_with_obstacles_and_links_that_are_no_neighbours() -> None:
    robot = mo.load_robot("ur5e")
    robot = robot.with_capsules(mo.robot.link_capsules(robot))
    everything = mo.Scene([mo.HalfSpace(name="floor")])
    own = {p.label for p in everything.pairs(robot) if p.other.name != "floor"}
    assert "wrist_2_joint to base" in own
    assert not any("shoulder_lift_joint to base" in label for label in own)  # they always touch
    fewer = mo.Scene([mo.HalfSpace(name="floor")], ignore=[("wrist_2_joint", "base")])
    assert "wrist_2_joint to base" not in {p.label for p in fewer.pairs(robot)}
    alone = mo.Scene([mo.HalfSpace(name="floor")], self_collision=False)
    assert {p.other.name for p in alone.pairs(robot)} == {"floor"}


def test_capsules_play_their_part_in_equality_and_a_part_hangs_on_the_tool() -> None:
    bare = mo.load_robot("planar_3r")
    assert bare != ARM
    assert bare.with_capsules(dict(mo.robot.link_capsules(bare))) == ARM
    loaded = ARM.with_part(mo.Capsule([0, 0, 0], [0, 0, 0], 0.1))
    frame, part = loaded.capsules[-1]
    assert (frame, part.name) == (3, "part")
    assert part.start == pytest.approx(ARM.tool[:3, 3])


# files --------------------------------------------------------------------------------------------

CELL = """
clearance = 0.01
ignore = [["wrist", "post"]]
[[obstacle]]
name = "post"
kind = "capsule"
start = [1, 0, 0]
end = [1, 0, 1]
radius = 0.1
[[obstacle]]
kind = "box"
size = [1, 2, 0.1]
center = [0, 0, -0.5]
rotation_deg = [0, 0, 90]
[[obstacle]]
kind = "mesh"
vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
[[obstacle]]
kind = "half_space"
normal = [0, 0, 2]
offset = -1
"""


def test_a_scene_is_read_from_toml(tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_text(CELL)
    scene = mo.load_scene(tmp_path / "cell.toml")
    assert scene.names == ("post", "box 2", "mesh 3", "half space 4")
    assert scene.clearance == 0.01
    assert scene.ignore == (("wrist", "post"),)
    box, floor = scene.obstacles[1], scene.obstacles[3]
    assert isinstance(box, mo.Box)
    assert isinstance(floor, mo.HalfSpace)
    assert box.pose[:3, 0] == pytest.approx([0, 1, 0])
    assert floor.normal.tolist() == [0, 0, 1]


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"obstacles": []}, ("'obstacles'", "top level", "'obstacle'")),
        (
            {"obstacle": [{"kind": "cube"}]},
            ("obstacle 1", "kind", "sphere, box, capsule", "'cube'"),
        ),
        ({"obstacle": [{"name": "a", "kind": "sphere"}]}, ("obstacle 'a'", "center", "missing")),
        (
            {"obstacle": [{"kind": "box", "size": [1, 1, 0]}]},
            ("obstacle 1", "every edge", "box", "0 m"),
        ),
        ({"self_collision": 1}, ("self_collision", "true or false", "not 1")),
    ],
)
def test_a_bad_file_is_told_by_obstacle_and_key(table, said: tuple[str, ...]) -> None:
    with refused(*said):
        mo.load_scene(table)


URDF = """<robot name="cell"><link name="world"/>
<link name="shelf">
 <collision><origin xyz="0 0 0.5"/><geometry><box size="1 0.3 0.02"/></geometry></collision>
 <collision><geometry><cylinder radius="0.1" length="0.4"/></geometry></collision></link>
<joint name="at" type="{kind}"><parent link="world"/><child link="shelf"/>
 <origin xyz="1 0 0"/></joint></robot>"""


def test_what_stands_in_a_urdf_file_is_a_scene(tmp_path: Path) -> None:
    path = tmp_path / "cell.urdf"
    path.write_text(URDF.format(kind="fixed"))
    scene = mo.load_scene(path)
    assert scene.names == ("shelf 1", "shelf 2")
    board = scene.obstacles[0]
    assert isinstance(board, mo.Box)
    assert board.pose[:3, 3].tolist() == [1.0, 0.0, 0.5]
    path.write_text(URDF.format(kind="continuous"))
    with refused("joint 'at'", "moves"):
        mo.load_scene(path)


# proof --------------------------------------------------------------------------------------------


def swept(radius: float = 0.2) -> tuple[mo.Motion, mo.Scene]:
    """A link that turns past a ball: the distance of its axis at 45 degrees is known."""
    shape = mo.cubic([[-0.5, 0, 0], [1.5, 0, 0]], [0, 1])
    motion = mo.Motion.from_polynomial(ARM, shape, label="turn")
    return motion, mo.Scene([mo.Sphere([1.3, 1.3, 0], radius, "ball")], self_collision=False)


def test_the_least_distance_is_found_and_bounded_from_below() -> None:
    motion, scene = swept()
    found = mo.clearance(ARM, motion, scene)
    dense = contact_model(ARM, scene).distances(motion.sample(np.linspace(0, 1, 4001)).q)
    assert found.proved
    assert found.at_least <= dense.min() <= found.minimum + 1e-9
    assert found.minimum == pytest.approx(dense.min(), rel=0.3)


@pytest.mark.parametrize("slack", [1e-3, 1e-5])
def test_a_near_miss_is_proved_and_a_touch_is_shown(slack: float) -> None:
    motion, scene = swept()
    t = np.linspace(0.3, 0.9, 20_001)
    apart = contact_model(ARM, scene).distances(motion.sample(t).q).min()
    misses = mo.clearance(ARM, motion, swept(0.2 + apart - slack)[1])
    assert misses.proved, misses.sentence
    touches = mo.clearance(ARM, motion, swept(0.2 + apart + slack)[1])
    assert not touches.proved
    tells(touches.sentence, "overlap", "mm")


def test_a_gap_between_samples_is_not_overlooked() -> None:
    """A motion that dips into a ball between two samples 0.1 s apart and comes back."""
    t = np.array([0.0, 0.1])
    dip = np.array([[0.0, 0, 0], [0.0, 0, 0]])
    speed = np.array([[60.0, 0, 0], [-60.0, 0, 0]])
    motion = mo.Motion(t, dip, speed, np.zeros_like(dip), np.zeros_like(dip))
    angle = motion.sample([0.05]).q[0, 0]
    ball = mo.Sphere([0.9 * np.cos(angle), 0.9 * np.sin(angle), 0], 0.05, "ball")
    scene = mo.Scene([ball], self_collision=False)
    ends = contact_model(ARM, scene).distances(dip)
    assert ends.min() > 0.3
    assert not mo.clearance(ARM, motion, scene).proved


def test_a_certificate_passes_only_where_clearance_is_proved(monkeypatch) -> None:
    motion, scene = swept()
    passed = mo.certify(ARM.with_limits(mo.Limits()), motion, scene=scene)
    assert passed.ok
    assert passed.clearance is not None
    assert passed.clearance.proved
    tells(passed.verdict, "clearance", "proved", "ball")
    assert "not proved" not in passed.verdict
    failed = mo.certify(ARM.with_limits(mo.Limits()), motion, scene=swept(0.9)[1])
    assert not failed.ok
    tells(failed.verdict, "ball at")
    tells(failed._repr_html_(), "clearance", "not proved")
    monkeypatch.setitem(__import__("sys").modules, "coal", None)
    alone = mo.certify(ARM.with_limits(mo.Limits()), motion, scene=scene)
    assert not alone.ok
    tells(alone.verdict, "clearance", "not proved", "coal")


# motions ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def around() -> mo.Motion:
    return mo.time_optimal(ARM, ENDS, scene=POST, mesh=20, starts=1)


def test_a_motion_goes_around_and_is_certified(around: mo.Motion) -> None:
    straight = mo.Motion.from_polynomial(ARM, mo.cubic(ENDS, [0, 1]), label="cubic")
    assert not mo.clearance(ARM, straight, POST).proved
    certificate = mo.certify(ARM, around, via_q=ENDS, scene=POST)
    assert certificate.ok, certificate.verdict
    assert around.solved
    timed = min(path["duration"] for path in around.provenance["paths"])
    assert around.duration < 0.9 * timed
    assert around.provenance["clearance"]["proved"]
    assert 0.0 < around.provenance["first_certified"] < processor_time()


def check_solved_again(around: mo.Motion) -> None:
    """Solve the task, in which more must be asked before links keep clear, and is then as fast."""
    lines = list[str]()
    motion = mo.time_optimal(ARM, ENDS, scene=POST, mesh=20, starts=1, progress=lines.append)
    assert any("solved again" in str(line) for line in lines)
    assert motion.solved
    assert motion.provenance["clearance"]["proved"]
    assert motion.duration < 1.01 * around.duration


@pytest.mark.thorough
# with two only the proof sees that links touch
@pytest.mark.parametrize("samples", [200, 2])
def test_pairs_that_are_missed_are_put_in_and_it_is_solved_again(
    around, monkeypatch, samples: int
) -> None:
    # no pair comes so near on the path
    monkeypatch.setattr(guided, "NEAR", 0.0)
    monkeypatch.setattr(guided, "SAMPLES", samples)
    check_solved_again(around)


@pytest.mark.thorough
def test_more_may_be_asked_of_a_pair_than_the_path_has(around, monkeypatch) -> None:
    """Capsules overlap on the path, and where links touch on what was found from it by less."""
    given: list[Any] = []

    def overlapping_on_the_path(*of: Any) -> Any:
        room, most, apart = room_along(*of)
        given.append(room)
        return (room, np.full_like(most, -0.01) if len(given) == 1 else most, apart)

    monkeypatch.setattr(guided, "room_along", overlapping_on_the_path)
    check_solved_again(around)


def test_links_that_overlap_are_asked_to_leave_what_is_spared() -> None:
    through = mo.cubic(ENDS, [0, 1])(np.linspace(0, 1, 50))
    pairs = POST.pairs(ARM)
    usual, most, _ = room_along(ARM, POST, pairs, through, 1e-3)
    room, _, _ = room_along(ARM, POST, pairs, through, 1e-3, 0.01)
    assert (most < 0.0).any()
    # The capsules are the links, so a required distance is that of the links.
    np.testing.assert_allclose(room[most < 0.0], 0.01, atol=1e-6)
    np.testing.assert_allclose(room[most >= 0.0], usual[most >= 0.0])


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [(1.3, 1.3005, True), (1.3, 1.31, False), (1.3, np.inf, False), (np.inf, np.inf, False)],
)
def test_ways_that_are_not_solved_are_no_known_optimum(monkeypatch, one, other, same) -> None:
    monkeypatch.setattr(guided, "explore_mesh", lambda search: 20)
    first, second = (SimpleNamespace(search=None, duration=time) for time in (one, other))
    assert guided.CoarseResult.is_optimum_of(first, second) is same  # type: ignore[arg-type]
    assert guided.CoarseResult.is_optimum_of(second, first) is same  # type: ignore[arg-type]


@pytest.mark.thorough
def test_a_coarse_motion_does_not_pass_through_thin_things_between_its_mesh_points() -> None:
    thin = ARM.with_capsules(mo.robot.link_capsules(ARM, 0.01))
    post = mo.Scene([mo.Sphere([0.75, 0.2, 0.0], 0.01, "post")], self_collision=False)
    motion = mo.time_optimal(thin, ENDS, scene=post, starts=1)
    assert motion.solved, motion.advice
    assert motion.provenance["clearance"]["proved"]
    timed = min(path["duration"] for path in motion.provenance["paths"])
    assert motion.duration < 0.9 * timed


def planned(
    arm: mo.Robot, via: np.ndarray, progress: Any = quiet
) -> tuple[LegPlanner, Task, Any, Any]:
    """Return the planner of a task among obstacles, the task, its way, and the leg of that."""
    settings = mo.planning.TimeOptimalSettings()
    request = SolveRequest(arm, None, list(via), None, False, settings, progress, scene=POST)
    planner, task = LegPlanner(request), request.task()
    planner.search([task])
    ((way, (leg,)),) = planner.ways(task)
    return planner, task, way, leg


@pytest.mark.thorough
def test_a_path_gets_its_best_timing_where_its_bound_is_faster(around) -> None:
    arm = ARM.with_limits(taud_max=200.0)
    planner, task, way, _ = planned(arm, ENDS)
    guides = planner.guides_of(task, way)
    timed = planner.timed(task, guides[0])
    assert timed is not None
    assert timed.clearance.proved
    assert timed.motion.duration > guides[0].durations[0]
    assert mo.certify(arm, timed.motion, via_q=ENDS, scene=POST).ok


@pytest.mark.thorough
def test_a_path_that_reachability_cannot_time_is_there_all_the_same() -> None:
    """It rests at its corners then, and was left out as slower than nothing."""
    planner, task, way, leg = planned(ARM, ENDS)
    for number in range(FIRST_SEARCHES):
        leg.search(number, quiet)
    for found in leg.ways:
        found.reached = found.motion = None
    *_, guide = planner.guides_of(task, way)
    timed = planner.timed(task, guide)
    assert timed.motion.duration == leg.first_motion.duration
    assert mo.certify(ARM, timed.motion, via_q=ENDS, scene=POST).ok


def test_the_known_motion_is_returned_if_no_path_is_faster(around, monkeypatch) -> None:
    """After the time limit the timing of the fastest path may be slower than the first motion."""
    shape = mo.cubic(ENDS, [0, 3 * around.duration])
    slow = mo.Motion.from_polynomial(ARM, shape, label="other")
    proved = ProvedPath(slow, mo.clearance(ARM, around, POST))
    monkeypatch.setattr(LegPlanner, "timed", lambda *_: proved)
    monkeypatch.setattr(guided.GuidedSearch, "motions", lambda *_: (([], ""), []))
    told = list[Any]()
    motion = mo.time_optimal(ARM, ENDS, scene=POST, mesh=20, starts=1, progress=told.append)
    (known,) = (float(line.split()[0]) for line in map(str, told) if "known" in line)
    assert motion.duration == pytest.approx(known, abs=1e-4)
    assert known < slow.duration


def test_a_coarse_answer_slower_than_its_start_is_solved_on_a_finer_mesh(monkeypatch) -> None:
    """A coarse mesh cannot follow the short accelerations of a slow arm."""
    made, step = list[guided.CoarseResult](), guided.GuidedSearch.coarse_step

    def kept(search: Any, *given: Any) -> guided.CoarseResult:
        made.append(step(search, *given))
        return made[-1]

    monkeypatch.setattr(guided.GuidedSearch, "coarse_step", kept)
    monkeypatch.setattr(guided.GuidedSearch, "_slowest", 0.0)
    motion = mo.time_optimal(ARM, ENDS, scene=POST, mesh=40, starts=1)
    assert motion.solved
    assert made
    for result in made:
        assert guided.explore_mesh(result.search) == guided.full_mesh(result.search)


def test_an_optimum_slower_than_the_timed_path_ends_the_search(around: mo.Motion) -> None:
    """It exceeds limits between its mesh points, and a finer mesh makes it no faster."""
    known = ProvedPath(around, mo.clearance(ARM, around, POST))
    exceeded = Outcome.of(mo.Status.LIMITS_EXCEEDED)
    for times, status in ((1.5, mo.Status.SOLVED), (0.5, mo.Status.FAILED)):
        scaled = mo.Motion.from_polynomial(
            ARM, mo.cubic(ENDS, [0, times * around.duration]), label="other"
        )
        motion = at_least(known, scaled.ended(exceeded), None)
        assert motion.status is status
        assert motion.duration == around.duration


def test_what_a_search_leaves_within_limits_is_known_at_least(around: mo.Motion) -> None:
    """Where it is within what a certificate lets pass, but a finer mesh was not solved."""
    exceeded = Outcome.of(mo.Status.LIMITS_EXCEEDED)
    slower = ProvedPath(around.stretched(ARM, 1.5), mo.clearance(ARM, around, POST))
    motion = at_least(slower, around.ended(exceeded), mo.clearance(ARM, around, POST))
    assert motion.status is mo.Status.NOT_ACCEPTED
    assert motion.duration == around.duration
    assert "made_from" not in motion.provenance


@pytest.mark.thorough
def test_the_same_task_gives_the_same_motion(around: mo.Motion) -> None:
    again = mo.time_optimal(ARM, ENDS, scene=POST, mesh=20, starts=1)
    assert again.duration == around.duration


def test_ends_in_collision_are_told_in_the_users_words() -> None:
    with refused("'via 1'", "collision", "'post'", "144 mm", "link 'elbow'"):
        mo.time_optimal(ARM, [[0.2, 0, 0], [1.0, 0, 0]], scene=POST)
    near = mo.Scene(POST.obstacles, clearance=5.0, self_collision=False)
    with refused("'via 1'", "'post'", "585 mm", "link 'shoulder'", "clearance", "5 m"):
        mo.time_optimal(ARM, [[2.5, 0, 0], ENDS[1]], scene=near)


WALLS = mo.Scene([mo.Sphere([np.cos(a), np.sin(a), 0], 0.3) for a in (0.15, 3.0)])
HELD = ARM.with_limits(q_min=[-np.pi, -0.1, -0.1], q_max=[np.pi, 0.1, 0.1])


@pytest.mark.slow
def test_where_no_way_is_found_the_answer_says_so_and_ends_where_asked() -> None:
    via = np.array([[-0.8, 0, 0], [1.2, 0, 0]])
    motion = mo.time_optimal(HELD, via, scene=WALLS, time_limit=0.5)
    assert motion.status is mo.Status.NOT_FOUND
    tells(motion.note, "'via 1'", "'via 2'", "poses", "deg")
    assert motion.q[[0, -1]] == pytest.approx(via)
    assert not motion.provenance["clearance"]["proved"]


PLACE = np.arange(300) + 0.5  # evenly about a ball
TILT, TURN = np.arccos(1 - PLACE / 150), np.pi * (1 + 5**0.5) * PLACE
BALL = np.array([np.cos(TURN) * np.sin(TILT), np.sin(TURN) * np.sin(TILT), np.cos(TILT)]).T


@pytest.mark.parametrize(
    "tank_at",
    [
        lambda at: mo.Sphere(at, 2.0, "tank"),
        pytest.param(
            lambda at: mo.scene.ConvexMesh(2.0 * BALL, at, "tank"), marks=pytest.mark.thorough
        ),
    ],
    ids=["sphere", "mesh"],
)
def test_a_large_tank_may_be_near(tank_at) -> None:
    """A margin of one per cent of 2 m refused it, and a mesh was seen by 26 planes around it."""
    outwards = np.array([np.cos(1.2), np.sin(1.2), 0])
    bare = mo.Scene([tank_at(5 * outwards)], self_collision=False)
    apart = contact_model(ARM, bare).distances(ENDS)
    tank = tank_at((5 - apart.min() + 0.0155) * outwards)
    motion = mo.time_optimal(ARM, ENDS, scene=mo.Scene([tank]), mesh=20, compiled=False)
    assert motion.solved
    assert "starts" in motion.provenance  # the search, not a timed path in its place
    assert motion.provenance["clearance"]["proved"]


GANTRY = mo.Robot.from_dh(
    alpha=[0, np.pi / 2, np.pi / 2],
    a=np.zeros(3),
    d=np.zeros(3),
    theta_offset=[0, np.pi / 2, np.pi / 2],
    joint_type=["prismatic"] * 3,
    limits=mo.Limits(q_min=-1, q_max=1, qd_max=1, qdd_max=4),
).with_capsules({3: [mo.Capsule([0, 0, -0.1], [0, 0, 0.1], 0.05, "head")]})


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("play", [3e-4, 3e-5])
def test_a_corridor_may_be_as_narrow_as_distances_are_known(play: float) -> None:
    sides = [(s, s * (0.55 + play / 2)) for s in (1, -1)]
    walls = [mo.Box([0.2, 1.0, 3.0], [0, y, 0], f"wall {s}") for s, y in sides]
    via = [[0, 0, -0.6], [0.3, 0, 0.6]]
    motion = mo.time_optimal(GANTRY, via, scene=mo.Scene(walls), mesh=10, starts=1, compiled=False)
    assert motion.solved
    assert motion.provenance["clearance"]["proved"]


@pytest.mark.thorough
@pytest.mark.parametrize("limits", [{"taud_max": 400.0}, {"qddd_max": 200.0}])
def test_what_is_returned_in_a_short_time_keeps_rates_and_is_clear(limits) -> None:
    arm = ARM.with_limits(**limits)
    motion = mo.time_optimal(arm, ENDS, scene=POST, mesh=20, compiled=False, time_limit=6.0)
    certificate = mo.certify(arm, motion, via_q=ENDS, scene=POST)
    assert certificate.ok, certificate.verdict


@pytest.mark.slow
def test_a_first_way_is_proved_before_others_are_looked_for(monkeypatch) -> None:
    searches, told = list[int](), list[tuple[str, int]]()
    place = "microbot_ocp.planning.search._legs.detour"
    usual = __import__("microbot_ocp.scene", fromlist=["detour"]).detour
    monkeypatch.setattr(place, lambda *given: searches.append(given[-1]) or usual(*given))
    progress = lambda event: told.append((str(event), len(searches)))  # noqa: E731
    via = np.array([[0.0, 0.0, 0.0], [0.6, 0.3, 0.0]])
    planner, task, way, leg = planned(ARM, via, progress)
    assert leg.first_motion is not None
    planner.guides_of(task, way)
    (count,) = {count for text, count in told if f"{leg.first_motion.duration:.4f} s, the" in text}
    assert count == 1 < len(searches)
    assert 0.0 < planner.first_certified < np.inf


@pytest.mark.slow
def test_a_redundant_arm_reaches_a_stop_in_a_pose_that_is_free() -> None:
    """Its one representative of the poses at the stop is in collision by 37 mm."""
    ball = mo.Scene([mo.Sphere([0.3, 0.2, 0.0], 0.06, "ball")])
    goal = mo.Stop(position=[0.8, 0.72, 0.0])
    (representative,) = mo.solve_ik_all(ARM, goal.position)
    assert contact_model(ARM, ball).nearest(representative.q).distance < -0.03
    stops = [mo.Stop(q=[-0.9, 0.6, 0.2]), goal]
    motion = mo.time_optimal(ARM, stops, scene=ball)
    assert motion.solved
    assert mo.certify(ARM, motion, via_q=stops, scene=ball).ok


@pytest.mark.thorough
@pytest.mark.parametrize("stopped", [False, True])
def test_what_is_far_away_changes_nothing(stopped: bool) -> None:
    """The search from a path ends as near its limits as the one among nothing."""
    arm, ends = mo.load_robot("microbot"), np.array([[0.04, 1.44, -1.14], [1.44, -0.6, -0.25]])
    far = mo.Scene([mo.Sphere([9.0, 9.0, 9.0], 0.1, "far")])
    alone = mo.time_optimal(arm, ends)
    stops = [mo.Stop(q=ends[0], dwell=0.1), mo.Stop(q=ends[1])]
    beside = mo.time_optimal(arm, stops if stopped else ends, scene=far)
    assert beside.solved
    assert beside.duration - 0.1 * stopped == pytest.approx(alone.duration, rel=5e-4)


@pytest.fixture
def without_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time is over when the search through stops begins, on a busy machine as on a fast one."""
    place = "microbot_ocp.planning.search._among_obstacles._OrderAmongObstacles._found"
    monkeypatch.setattr(place, lambda *_: None)


@pytest.mark.thorough
@pytest.mark.usefixtures("without_search")
def test_through_stops_a_timed_way_that_keeps_rates_is_there_before_the_search() -> None:
    arm = ARM.with_limits(taud_max=400.0)
    stops = [mo.Stop(q=ENDS[0], payload=0.1), mo.Stop(q=ENDS[1])]
    motion = mo.time_optimal(arm, stops, scene=POST, compiled=False, time_limit=10.0)
    assert motion.status is mo.Status.TIME_LIMIT
    certificate = mo.certify(arm, motion, via_q=stops, scene=POST)
    assert certificate.ok, certificate.verdict


def test_a_way_that_is_not_found_through_stops_ends_at_them() -> None:
    """What the solver stopped at lasted a millisecond and ended elsewhere."""
    stops = [mo.Stop(q=[-0.8, 0, 0]), mo.Stop(q=[1.2, 0, 0], name="goal")]
    motion = mo.time_optimal(HELD, stops, scene=WALLS, compiled=False, time_limit=0.5)
    assert motion.status is mo.Status.NOT_FOUND
    tells(motion.note, "no path", "'stop 1'", "'goal'")
    assert not motion.provenance["clearance"]["proved"]
    blind = mo.certify(HELD, motion, via_q=stops)
    assert blind.ok, blind.verdict


@pytest.mark.thorough
@pytest.mark.usefixtures("without_search")
def test_a_timed_cycle_among_obstacles_keeps_lines_dwells_and_payloads() -> None:
    robot, line = mo.load_robot("ur5e"), mo.Line(tolerance=0.002)
    down = np.diag([1.0, -1.0, -1.0])
    at = [[0.4, -0.2, 0.2], [0.4, -0.2, 0.3], [0.4, 0.2, 0.3]]
    picks = [{"dwell": 0.1, "payload": 0.5}, {}, {"dwell": 0.1, "payload": 0.0}]
    stops = [mo.Stop(position=p, orientation=down, **k) for p, k in zip(at, picks, strict=True)]
    floor = mo.Scene([mo.HalfSpace([0, 0, 1], -0.4, "floor")])
    task = {"segments": [line, None, None], "cycle": True, "scene": floor}
    motion = mo.time_optimal(robot, stops, **task, compiled=False)
    assert motion.status is mo.Status.TIME_LIMIT
    certificate = mo.certify(robot, motion, via_q=stops, **task)
    assert certificate.ok, certificate.verdict


@pytest.mark.thorough
def test_stops_that_are_joint_poses_are_via_points(around: mo.Motion) -> None:
    stops = [mo.Stop(q=ENDS[0], name="pick"), mo.Stop(q=ENDS[1], name="place")]
    motion = mo.time_optimal(ARM, stops, scene=POST, mesh=20, starts=1)
    assert motion.duration == around.duration
    assert [mark.name for mark in motion.marks] == ["pick", "place"]
    assert mo.certify(ARM, motion, via_q=stops, scene=POST).ok


BEYOND = [1.05 * np.cos(0.6), 1.05 * np.sin(0.6), 0.0]


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(
    "via",
    [ENDS, [mo.Stop(q=q) for q in ENDS]],
    ids=["poses", "stops"],
)
def test_a_pair_counts_where_it_is_nearer_than_a_large_clearance(via) -> None:
    """What passes at 3 cm is refused where 5 cm are wanted, and was not led around."""
    plan = {"mesh": 20, "starts": 1, "compiled": False}
    unhindered = mo.time_optimal(ARM, via, **plan)
    small = mo.Sphere(BEYOND, 0.01, "post")
    nearest = mo.clearance(ARM, unhindered, mo.Scene([small])).minimum
    post = replace(small, radius=0.01 + nearest - 0.03)
    motion = mo.time_optimal(ARM, via, scene=mo.Scene([post], clearance=0.05), **plan)
    assert motion.solved
    assert "made_from" not in motion.provenance
    assert motion.provenance["clearance"]["proved"]


@pytest.mark.thorough
def test_the_fastest_is_returned_where_less_time_is_allowed() -> None:
    few: dict[str, Any] = {"mesh": 10, "starts": 1, "limit_tolerance": 0.01, "compiled": False}
    lines = list[str]()
    few["progress"] = lambda event: lines.append(str(event))
    motion = mo.time_optimal(ARM, ENDS, scene=POST, duration=0.5, **few)
    assert motion.status is mo.Status.INFEASIBLE
    # Once the fastest motion is known, no slower path is refined: meshes grow in one refinement.
    meshes = [int(line.split()[1].rstrip(":")) for line in lines if line.startswith("mesh ")]
    assert meshes == sorted(set(meshes))
    tells(motion.note, "0.5 s", "fastest")
    assert motion.provenance["clearance"]["proved"]


@pytest.mark.thorough
def test_a_part_keeps_clear_from_the_stop_on_at_which_it_is_picked(around: mo.Motion) -> None:
    part = mo.Payload(0.1, shape={"start": [0, 0, 0], "end": [0.25, 0, 0], "radius": 0.08})
    stops = [mo.Stop(q=ENDS[0], payload=part), mo.Stop(q=ENDS[1])]
    motion = mo.time_optimal(ARM, stops, scene=POST, mesh=12, starts=1, compiled=False)
    certificate = mo.certify(ARM, motion, via_q=stops, scene=POST)
    assert certificate.ok
    assert motion.provenance["starts"][0]["start"] == "branches 1-1, around 1"
    bare = mo.certify(mo.load_robot("planar_3r"), around, via_q=stops, scene=POST)
    assert bare.clearance is not None
    assert bare.clearance.pair == "part to post"
    assert not bare.clearance.proved
    with refused("stop 'stop 2'", "collision", "'post'", "144 mm", "link 'elbow'"):
        mo.time_optimal(ARM, [ENDS[0], mo.Stop(q=[0.2, 0.0, 0.0])], scene=POST)
    with refused("radius", "shape", "payload", "missing"):
        mo.Payload(1.0, shape={"start": [0, 0, 0], "end": [0, 0, 1]})


@pytest.mark.thorough
@pytest.mark.parametrize(
    "loads", [(None, 0.1), pytest.param((0.1, None), marks=pytest.mark.thorough)]
)
def test_segments_with_other_pairs_are_priced_by_limits_that_all_have(loads) -> None:
    shape = {"start": [0, 0, 0], "end": [0.25, 0, 0], "radius": 0.08}
    parts = [mo.Payload(mass, shape=shape) if mass else 0.0 for mass in loads]
    stops = [mo.Stop(q=ENDS[k], payload=part) for k, part in enumerate(parts)]
    stops.append(mo.Stop(q=ENDS[0]))
    motion = mo.time_optimal(ARM, stops, scene=POST, mesh=20, starts=1, compiled=False)
    assert motion.solved
    assert motion.provenance["clearance"]["proved"]
    assert set(motion.provenance["multipliers"]["upper"]) == {"q", "qd", "tau"}


def test_a_blocked_stop_is_said_before_any_order_is_solved(monkeypatch) -> None:
    monkeypatch.setattr("microbot_ocp.planning.search._among_obstacles.best_order", None)
    stops = [ENDS[0], mo.Stop(q=[0.2, 0.0, 0.0], name="through"), ENDS[1]]
    with refused("stop 'through'", "collision", "'post'", "144 mm", "link 'elbow'"):
        mo.time_optimal(ARM, stops, scene=POST, order="free")


@pytest.mark.thorough
def test_orders_are_compared_among_the_obstacles() -> None:
    stops = [ENDS[0], ENDS[1], [-0.5, 0.3, 0.1], [-0.2, 0.3, 0.2]]
    settings = {"mesh": 20, "starts": 1, "limit_tolerance": 0.01, "compiled": False}
    motion = mo.time_optimal(ARM, stops, scene=POST, order="free", **settings)
    assert motion.provenance["clearance"]["proved"]
    best, other = motion.provenance["orders"]
    assert best["order"] == motion.provenance["order"] == [0, 2, 1, 3]
    assert 1.8 < best["coarse"] < 0.99 * other["coarse"] < 2.0  # 1.04 and 1.35 s without the post
    assert other["status"] == "coarse"
    tells(motion.remark, "one way", "velocity")


BOLT = mo.Payload(0.1, shape=mo.Capsule([0.05, 0, 0], [0.1, 0, 0], 0.05, "bolt"))
MOVED = [
    mo.Stop(q=[-0.4, 0.3, 0.2], payload=BOLT, name="pick"),
    mo.Stop(q=[0.6, 0.3, 0.2], payload=0.0, name="place"),
    mo.Stop(q=[0.0, 0.3, 0.2], velocity="rest", name="back"),
    mo.Stop(q=[1.2, 0.3, 0.1], name="park"),
]


@pytest.mark.thorough
def test_a_part_is_an_obstacle_where_it_was_put_down() -> None:
    far = mo.Scene([mo.Box([0.1, 0.1, 0.3], [-0.9, 0, 0], "box")])
    settings = {"mesh": 10, "starts": 1, "limit_tolerance": 0.01, "compiled": False}
    motion = mo.time_optimal(ARM, MOVED, scene=far, **settings)
    assert motion.provenance["clearance"]["proved"]
    assert motion.provenance["clearance"]["pair"] == "wrist to bolt at place"
    certificate = mo.certify(ARM, motion, via_q=MOVED, scene=far, limit_tolerance=0.02)
    assert certificate.ok, certificate.verdict
    straight = mo.cubic([stop.q for stop in MOVED], [0, 1, 2, 3], via_qd=np.zeros((4, 3)))
    marks = [mo.motion.Mark(float(k), stop.name) for k, stop in enumerate(MOVED)]
    through = mo.Motion.from_polynomial(ARM, straight, label="through", marks=marks)
    found = mo.certify(ARM, through, via_q=MOVED, scene=far).clearance
    assert found is not None
    assert not found.proved
    assert found.pair == "wrist to bolt at place"
    assert found.time > 2.0
    allowed = mo.Scene(far.obstacles, ignore=[("wrist", "bolt"), ("elbow", "bolt")])
    found = mo.certify(ARM, through, via_q=MOVED, scene=allowed).clearance
    assert found is not None
    assert found.proved


def test_where_parts_lie() -> None:
    pick, place, back, park = MOVED
    again = mo.Stop(q=place.q, payload=BOLT, name="again")
    last = mo.Stop(q=park.q, payload=0.0, name="last")
    home = mo.Stop(q=[0.0, 0.3, 0.0], name="home")
    task = task_of(ARM, [back, pick, place, mo.Stop(q=[0, 0, 0]), again, last, home])
    poses = tool_poses(ARM, np.array([stop.q for stop in task.stops]))
    (bolt,) = parts_of(task, poses)
    assert bolt.carries == ((1, 2), (4, 5))  # taken up again where it was put down
    scenes = scenes_of(task, mo.Scene([mo.Box([1, 1, 1], [3, 3, 0], "box")]), poses)
    lying = [scene.names[1:] for scene in scenes]
    at_place = ("bolt at place",)
    assert lying == [("bolt at pick",), (), at_place, at_place, (), ("bolt at last",)]
    # the last two links hold it: they may touch it on the way to it and away from it
    hands = [{link for link, _ in scene.ignore} - {"bolt"} for scene in scenes]
    assert hands == [
        {"elbow", "wrist"},
        set(),
        {"elbow", "wrist"},
        {"elbow", "wrist"},
        set(),
        {"elbow", "wrist"},
    ]
    start = ARM.with_part(*BOLT.shape).capsules[-1][1].start
    reached = np.array(mo.forward_kinematics(ARM, frame=3)(np.array(place.q)))
    assert scenes[2].obstacles[1].start == pytest.approx(reached[:3, :3] @ start + reached[:3, 3])


def test_reach_is_the_sum_of_the_links() -> None:
    assert reach_of(ARM) == pytest.approx(1.0 + np.hypot(0.1, 0.2), abs=0.1)


def test_a_recording_shows_obstacles_and_the_nearest_points(
    around: mo.Motion, tmp_path: Path
) -> None:
    shapes = [mo.Box([0.1, 0.1, 0.1], [1, 1, 0]), mo.Cylinder(0.1, 0.2, [-1, 0, 0])]
    shapes += [mo.HalfSpace(offset=-1.0), mo.scene.ConvexMesh(np.vstack([np.zeros(3), np.eye(3)]))]
    scene = mo.Scene([*POST.obstacles, *shapes, mo.Capsule([1, 0, 1], [1, 0, 2], 0.1)])
    path = around.to_rerun(ARM, tmp_path / "around.rrd", scene)
    content = path.read_bytes()
    for word in (b"scene/post", b"scene/nearest", b"capsule_1"):
        assert word in content
