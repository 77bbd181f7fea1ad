"""Designs of cells against closed forms, exhaustive maps and differences, and their refusals."""

import time
from dataclasses import replace

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, sampled, tells
from microbot_ocp._base.toml_text import toml_text
from microbot_ocp.layout import DesignSettings
from microbot_ocp.layout._quantities import cell_with, quantities_of
from microbot_ocp.layout._search import LayoutSearch
from microbot_ocp.layout._slopes import slopes
from microbot_ocp.ocp.solution import quiet
from microbot_ocp.planning import TimeOptimalSettings
from microbot_ocp.robot import Mounting
from microbot_ocp.tasks import CellFile, read_cell

FASTER = np.array([2.0, 3.0])  # m/s^2, of the gantry's axes
QUICK = TimeOptimalSettings(mesh=20, starts=1, compiled=False)


def gantry():
    """Two slides along X and Y, whose accelerations alone are limited."""
    upright = [[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]
    limits = mo.Limits(q_min=-3.0, q_max=3.0, qdd_max=FASTER)
    table = {"alpha": [0.0, -np.pi / 2], "a": [0.0, 0.0], "d": [0.0, 0.0]}
    return mo.Robot.from_dh(
        **table, joint_type="prismatic", limits=limits, base=upright, convention="modified"
    )


def stops_at(*places, **more):
    return tuple(mo.Stop(position=p, name=n, **more) for p, n in zip(places, "abc", strict=False))


DIAGONAL = stops_at([0.0, 0.0, 0.0], [1.0, 1.0, 0.0])


def cell_of(robot, stops, **more):
    return CellFile("task", robot, tuple(stops), robot.limits, settings=QUICK, **more)


@pytest.mark.thorough
@pytest.mark.slow
def test_the_best_turn_of_a_gantry_is_a_kink_in_closed_form():
    settings = DesignSettings(solves=8, starts=1)
    found = mo.design(gantry(), cell_of(gantry(), DIAGONAL), "base.yaw", settings=settings)
    best = 2.0 * np.sqrt(np.sqrt(2.0) / np.linalg.norm(FASTER))
    assert found.period == pytest.approx(best, rel=5e-3)
    assert abs(np.tan(np.pi / 4 - found.values[0])) == pytest.approx(3.0 / 2.0, rel=0.03)
    assert found.period <= found.period_before
    assert found.after.certificate.ok
    assert len(found.solved) <= 8


@pytest.mark.parametrize("name", sampled(["stops.b.x", "stops.b.y", "stops.a.y", "base.yaw"], 2))
def test_slopes_of_a_gantry_in_closed_form(name):
    cell = replace(
        cell_of(gantry(), stops_at([0.0, 0.0, 0.0], [1.0, 0.4, 0.0])),
        settings=replace(QUICK, mesh=60),
    )
    quantities = quantities_of(cell, name, None)
    motion = cell.solve().motion
    expected = {"stops.b.x": np.sqrt(1.0 / FASTER[0]), "base.yaw": 0.4 * np.sqrt(1.0 / FASTER[0])}
    (slope,) = slopes(cell, quantities, np.array([quantities[0].start]), motion)
    assert slope == pytest.approx(expected.get(name, 0.0), rel=1e-2, abs=2e-3)


def test_the_slope_by_a_gear_ratio_is_that_of_velocity_and_torque():
    link = mo.Link(1.0, [0.0, 0.0, 0.0], np.zeros((3, 3)), armature=2.0)
    limits = mo.Limits(q_min=-10.0, q_max=10.0, qd_max=1.0, tau_max=6.0)
    one = mo.Robot.from_dh([0.0], [0.0], [0.0], None, "prismatic", [link], limits, (0, 0, 0))
    stops = [mo.Stop(position=[0, 0, 0], name="a"), mo.Stop(position=[0, 0, 2.0], name="b")]
    cell = replace(cell_of(one, stops), settings=replace(QUICK, mesh=80))

    def period(ratio):
        acceleration, speed = 6.0 * ratio / (1.0 + 2.0 * ratio**2), 1.0 / ratio
        return 2.0 / speed + speed / acceleration

    quantities = quantities_of(cell, {"gear ratio": ("joint 1",)}, None)
    motion = cell.solve().motion
    assert motion.duration == pytest.approx(period(1.0), rel=1e-3)
    (slope,) = slopes(cell, quantities, np.ones(1), motion)
    assert slope == pytest.approx((period(1.001) - period(0.999)) / 0.002, rel=1e-2)


@pytest.mark.thorough
def test_a_design_is_as_good_as_the_best_node_of_an_exhaustive_map():
    robot = mo.load_robot("planar_2r")
    cell = cell_of(robot, stops_at([0.6, 0.3, 0.0], [0.5, -0.3, 0.0]))
    bounds = {"base.x": (-0.2, 0.1), "base.y": (-0.1, 0.1)}
    settings = DesignSettings(nodes=9, solves=8, starts=1)
    found = mo.design(robot, cell, ["base.x", "base.y"], bounds, settings=settings)
    line = np.linspace(0.0, 1.0, 5)
    every = []
    for share in np.stack(np.meshgrid(line, line), -1).reshape(-1, 2):
        values = np.array([-0.2, -0.1]) + share * [0.3, 0.2]
        every.append(cell_with(cell, found.quantities, values).solve().motion.duration)
    assert found.period <= 1.005 * min(every)
    assert found.period <= found.period_before
    assert len(found.solved) <= 8
    agreed = [worth for worth in found.worth if not worth.flag]
    for worth in agreed:
        assert worth.slope == pytest.approx(worth.difference, rel=0.0101)


TOOL_LINE = {"segments": (mo.Line(0.01), None), "cycle": True}


@pytest.mark.thorough
def test_slopes_of_a_cycle_with_a_line_a_dwell_and_a_tolerance():
    robot = mo.load_robot("planar_2r")
    pick = mo.Stop(position=[0.6, 0.3, 0.0], payload=1.0, dwell=0.2, name="pick")
    place = mo.Stop(position=[0.5, -0.2, 0.0], payload=0.0, tolerance=0.02, name="place")
    cell = replace(
        cell_of(robot, [pick, place], **TOOL_LINE),
        settings=TimeOptimalSettings(mesh=60, starts=1, limit_tolerance=5e-5),
    )
    quantities = quantities_of(cell, ["base.x", "stops.place.y"], {"base.x": (-0.2, 0.2)})
    start = np.array([quantity.start for quantity in quantities])
    by_multipliers = slopes(cell, quantities, start, cell.solve().motion)
    differences = []
    for step in 5e-3 * np.eye(2):
        ends = [cell_with(cell, quantities, start + s * step).solve() for s in (1.0, -1.0)]
        differences.append((ends[0].motion.duration - ends[1].motion.duration) / 1e-2)
    # The mesh moves a slope by some 0.002 s/m, which is 2 % of the smaller one.
    apart = np.abs(by_multipliers - np.array(differences)).max()
    assert apart < 5e-3 * np.linalg.norm(differences)


@pytest.mark.thorough
def test_slopes_beside_an_obstacle_that_the_arm_passes_near():
    pytest.importorskip("ompl")
    robot = mo.load_robot("planar_2r")
    scene = mo.Scene([mo.Sphere([0.72, 0.0, 0.0], 0.15, "ball")], 0.01)
    cell = cell_of(robot, stops_at([0.55, 0.3, 0.0], [0.55, -0.3, 0.0]), scene=scene)
    exact = TimeOptimalSettings(mesh=80, starts=1, limit_tolerance=1e-4)
    cell = replace(cell, settings=exact)
    quantities = quantities_of(cell, ["base.x", "base.y"], {"base.x": (-0.1, 0.1)})
    motion = cell.solve().motion
    (segment,) = motion.provenance["multipliers"]["segments"]
    assert np.abs(segment["distance"]["slopes"]).sum() > 0.1
    by_multipliers = slopes(cell, quantities, np.zeros(2), motion)
    for k in range(2):
        # Durations are right to 3e-5 s: differences of a shorter step are wrong by a percent.
        step = np.eye(2)[k] * 1.6e-2
        ends = [cell_with(cell, quantities, s * step).solve() for s in (1.0, -1.0)]
        difference = (ends[0].motion.duration - ends[1].motion.duration) / 3.2e-2
        assert by_multipliers[k] == pytest.approx(difference, rel=1e-2)


@pytest.mark.thorough
def test_a_placement_without_a_way_past_an_obstacle_takes_no_longer_than_ten_others():
    pytest.importorskip("ompl")
    robot, bounds = mo.load_robot("planar_2r"), dict.fromkeys(("base.x", "base.y"), (-0.1, 0.1))
    scene = mo.Scene([mo.Sphere([0.72, 0.0, 0.0], 0.15, "ball")], 0.01)
    cell = cell_of(robot, stops_at([0.6, 0.3, 0.0], [0.5, -0.3, 0.0]), scene=scene)
    quantities = quantities_of(cell, [*bounds], bounds)
    search = LayoutSearch(cell, quantities, DesignSettings(), quiet)
    times = [time.thread_time()]
    for place in (np.zeros(2), np.array([0.1, 0.05])):
        search.solve(place)
        times.append(time.thread_time())
    free, blocked = np.diff(times)
    assert np.isfinite(search.solved[0].period)
    assert search.solved[1].refusal
    assert blocked < 15.0 * free  # alone it would take until its time limit, minutes


@pytest.mark.thorough
def test_a_design_among_obstacles_is_certified_with_them():
    pytest.importorskip("ompl")
    robot = mo.load_robot("planar_2r")
    scene = mo.Scene([mo.Sphere([0.72, 0.0, 0.0], 0.15, "ball")], 0.01)
    cell = cell_of(robot, stops_at([0.55, 0.3, 0.0], [0.55, -0.3, 0.0]))
    settings = DesignSettings(nodes=9, solves=4, starts=1)
    bounds = dict.fromkeys(("base.x", "base.y"), (-0.1, 0.1))
    found = mo.design(None, cell, [*bounds], bounds, scene=scene, settings=settings)
    assert found.period < found.period_before
    moved, motion = found.cell.robot, found.after.motion
    assert not np.allclose(moved.base, robot.base)
    stops = found.cell.stops
    assert mo.certify(moved, motion, via_q=stops, scene=scene).ok
    closer = mo.Scene([mo.Sphere([0.72, 0.0, 0.0], 0.25, "ball")], 0.01)
    assert not mo.certify(moved, motion, via_q=stops, scene=closer).ok


# refusals -----------------------------------------------------------------------------------------

PLANAR = mo.load_robot("planar_2r").with_gravity([0.0, 0.0, 0.0])
CELL = cell_of(PLANAR, stops_at([0.6, 0.3, 0.0], [0.5, -0.3, 0.0]))


@pytest.mark.parametrize(
    ("free", "bounds", "said"),
    [
        ("bas.x", None, ("base, tool, stops", "gear ratio", "'bas'")),
        ("base.roll", None, ("base", "x, y, z, yaw", "'roll'")),
        ("tool.x", None, ("tool", "yaw", "'x'")),
        ({"stops": {"c": ("x",)}}, None, ("stop", "a, b", "'c'")),
        ("stops.a.pitch", None, ("stop 'a'", "x, y, z, yaw", "'pitch'")),
        ("stops.a.yaw", None, ("stops.a.yaw", "without effect")),
        ("gear ratio.wrist", None, ("gear ratio", "shoulder, elbow", "'wrist'")),
        (["base.x", "base.x"], None, ("'base.x'", "twice")),
        ((), None, ("free", "at least one")),
        ("base.x", {"base.y": (0.0, 1.0)}, ("bounds", "base.x, not", "'base.y'")),
        ("base.x", {"base.x": (0.1, 0.2)}, ("bounds of base.x", "present 0", "0.1 to 0.2 m")),
        (
            "gear ratio.elbow",
            {"gear ratio": {"elbow": (-1.0, 2.0)}},
            ("gear ratio.elbow", "above 0", "-1"),
        ),
        ("base.z", {"base.z": (-0.1, 0.1)}, ("base.z", "5 placements", "stop 'a'", "70 mm")),
        pytest.param(
            ["base.x", "base.z"],
            {"base.z": (-0.1, 0.1)},
            ("base.z", "5 placements", "stop 'a'", "70 mm"),
            marks=pytest.mark.thorough,
        ),
        (["tool.yaw", "base.yaw"], None, ("tool.yaw", "base.yaw", "without effect")),
    ],
)
def test_refusals_in_one_sentence(free, bounds, said):
    settings = DesignSettings(nodes=4, solves=2, starts=0)
    with refused(*said):
        mo.design(PLANAR, CELL, free, bounds, settings=settings)


@pytest.mark.thorough
@pytest.mark.slow
def test_a_quantity_without_effect_beside_another_stays_as_it_is():
    settings = DesignSettings(nodes=4, solves=3, starts=0)
    cell = replace(CELL, settings=QUICK)
    bounds = {"base.x": (-0.1, 0.1), "base.yaw": (-0.5, 0.5)}
    found = mo.design(None, cell, ["base.x", "base.yaw"], bounds, settings=settings)
    place, turn = found.worth
    assert found.values[0] != 0.0
    assert found.values[1] == 0.0
    assert (place.idle, turn.idle) == (False, True)
    tells(turn.sentence, "base.yaw", "no effect")
    assert abs(turn.slope) < 1e-3 * abs(place.slope)
    assert abs(turn.difference) < 1e-3 * found.period
    assert found.plot().ravel()[0].get_xlabel() == "base.x [m]"


@pytest.mark.thorough
@pytest.mark.slow
def test_a_turn_of_the_base_has_an_effect_beside_a_joint_pose():
    home = mo.Stop(q=[1.5, 1.0], name="home")
    cell = cell_of(PLANAR, [home, CELL.stops[0]])
    settings = DesignSettings(nodes=4, solves=2, starts=0)
    found = mo.design(None, cell, "base.yaw", {"base.yaw": (-0.3, 0.3)}, settings=settings)
    assert not found.worth[0].idle
    assert found.period < 0.9 * found.period_before


def test_a_stop_that_is_a_joint_pose_is_not_free():
    cell = cell_of(PLANAR, [mo.Stop(q=[0.0, 0.5], name="home"), CELL.stops[0]])
    with refused("'home'", "joint pose"):
        mo.design(PLANAR, cell, "stops.home.x")


def test_placements_that_reach_nothing_are_refused():
    far = cell_of(PLANAR, stops_at([2.6, 0.3, 0.0], [2.5, -0.3, 0.0]))
    with refused("14 placements", "base.x = 0 m", "'a'", "1.617 m"):
        mo.design(PLANAR, far, "base.x", {"base.x": (-0.2, 0.2)})


def test_obstacles_that_forbid_every_placement_are_refused():
    pytest.importorskip("coal")
    scene = mo.Scene([mo.Box([0.5, 0.5, 0.5], [0.6, 0.3, 0.0], "block")])
    with refused("14 placements", "base.x = 0 m", "'a'", "'block'", "283 mm"):
        mo.design(PLANAR, CELL, "base.x", {"base.x": (-0.1, 0.1)}, scene=scene)


# mountings and files ------------------------------------------------------------------------------


def test_a_mounting_moves_all_that_is_fixed_to_the_base():
    robot = mo.load_robot("ur5e")
    base = mo.Capsule([0.0, 0.0, 0.0], [0.0, 0.0, 0.1], 0.1)
    robot = robot.with_capsules({0: [base], 3: [base]})
    mounting = Mounting(0.3, -0.2, 0.1, np.pi / 2, tool_yaw=0.4)
    moved, q = mounting.on(robot), np.linspace(0.1, 0.6, 6)
    before, after = (np.array(mo.forward_kinematics(arm)(q)) for arm in (robot, moved))
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]]
    place = np.array([[0, -1, 0, 0.3], [1, 0, 0, -0.2], [0, 0, 1, 0.1], [0, 0, 0, 1.0]])
    np.testing.assert_allclose(after, place @ before @ turn, atol=1e-12)
    np.testing.assert_allclose(moved.capsules[0][1].end, [0.3, -0.2, 0.2], atol=1e-12)
    np.testing.assert_allclose(moved.capsules[1][1].end, [0.0, 0.0, 0.1])
    np.testing.assert_allclose(mo.gravity_torque(moved)(q), mo.gravity_torque(robot)(q), atol=1e-9)
    back = Mounting().on(moved, mounting)
    np.testing.assert_allclose(np.array(mo.forward_kinematics(back)(q)), before, atol=1e-12)


TEXT = """
schema = 1
robot = "planar_2r"
cycle = true
[[stop]]
name = "pick"
position = [0.6, 0.3, 0.0]
[[stop]]
name = "place it"
position = [0.5, -0.3, 0.0]
tolerance = 0.01
[[segment]]
after = "pick"
kind = "line"
[mounting]
x = 0.05
yaw_deg = 90.0
gear_ratio = { shoulder = 1.1 }
"""


def test_a_cell_file_has_a_mounting(tmp_path):
    file = tmp_path / "cell.toml"
    file.write_text(TEXT)
    cell, robot = read_cell(file), mo.load_robot("planar_2r")
    assert cell.mounting == Mounting(x=0.05, yaw=np.pi / 2, gear_ratio={"shoulder": 1.1})
    np.testing.assert_allclose(cell.limits.tau_max, robot.limits.tau_max * [1.1, 1.0])
    np.testing.assert_allclose(cell.limits.qd_max, robot.limits.qd_max / [1.1, 1.0])
    tool = np.array(mo.forward_kinematics(cell.robot)([0.0, 0.0]))[:3, 3]
    np.testing.assert_allclose(tool, [0.05, 1.0, 0.0], atol=1e-12)
    file.write_text(TEXT.replace("yaw_deg = 90.0", "roll = 1.0"))
    with refused("cell.toml", "[mounting]", "'roll'", "x, y, z, yaw"):
        read_cell(file)


def test_toml_text_is_read_back():
    from microbot_ocp._base.schema import parsed

    data = parsed(TEXT) | {"scene": {"obstacle": [{"a b": [1.5, float("inf")]}], "x": 'q"\\\n'}}
    assert parsed(toml_text(data)) == data


@pytest.mark.thorough
@pytest.mark.slow
def test_a_saved_design_is_the_cell_with_the_new_numbers(tmp_path):
    (tmp_path / "new").mkdir()
    file = tmp_path / "cell.toml"
    text = TEXT.replace('[[segment]]\nafter = "pick"\nkind = "line"\n', "")
    file.write_text(text + "[settings]\nmesh = 20\nstarts = 1\ncompiled = false\n")
    mo.save_robot(mo.load_robot("planar_2r"), tmp_path / "arm.toml")
    file.write_text(file.read_text().replace('"planar_2r"', '"arm.toml"'))
    free, bounds = ["base.x", "stops.place it.y"], {"stops.place it.y": (-0.35, -0.25)}
    settings = DesignSettings(nodes=4, solves=2, starts=0)
    found = mo.design(None, file, free, bounds, settings=settings)
    again = read_cell(found.save(tmp_path / "new" / "cell.toml"))
    assert again.mounting == found.cell.mounting
    assert again.stops == found.cell.stops
    assert again.robot.tool.tolist() == found.cell.robot.tool.tolist()
    np.testing.assert_allclose(again.robot.base, found.cell.robot.base, atol=1e-12)
    assert found.period <= found.period_before
    text = str(found.table())
    tells(text, "base.x", "worth")
    assert found.plot().figure is not None
