"""Motions simulated again by MuJoCo and pinocchio, and mutations that a certificate must find."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice, pairwise

import numpy as np
import pytest
from benchmarks.mujoco_arms import mjcf, with_small_bodies

import microbot_ocp as mo
from external.motions import FREE, among_obstacles, mutations, others, planned, shapes, via
from external.pinocchio_model import pinocchio_model
from microbot_ocp.certificate._task_certificate import _part
from microbot_ocp.motion import Motion, mesh_of
from microbot_ocp.planning.search import stretches
from microbot_ocp.planning.task import task_of
from microbot_ocp.simulation import interpolated

mujoco = pytest.importorskip("mujoco")
pin = pytest.importorskip("pinocchio")

STEP = 1e-3  # s, of the classical Runge-Kutta method
SEGMENT = 50  # steps
EVERY = 10  # one of so many segments is simulated
Acceleration = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def plain(robot: mo.Robot) -> mo.Robot:
    """Without friction, and each link at least a ball of 0.01 kg m^2: MuJoCo takes no points."""
    still = {"viscous_friction": 0.0, "coulomb_friction": 0.0}
    robot = robot.with_links([replace(link, **still) for link in robot.links])
    return with_small_bodies(robot)


def by_mujoco(robot: mo.Robot) -> Acceleration:
    model = mujoco.MjModel.from_xml_string(mjcf(robot))
    data = mujoco.MjData(model)

    def acceleration(q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, qd, tau
        mujoco.mj_forward(model, data)
        return data.qacc.copy()

    return acceleration


def by_pinocchio(robot: mo.Robot) -> Acceleration:
    model = pinocchio_model(robot)
    data = model.createData()
    return lambda q, qd, tau: pin.aba(model, data, q, qd, tau).copy()


def largest_miss(acceleration: Acceleration, motion: Motion, enough: float = np.inf) -> float:
    """Largest error of a position, rad, at the end of a segment from the motion's own state.

    Returned at once if it is above ``enough``.
    """
    torque, mesh, n = interpolated(motion, motion.tau, mesh_of(motion)), mesh_of(motion), 0
    if motion.breaks is None or motion.breaks.size == motion.t.size:
        torque, mesh = interpolated(motion, motion.tau, mesh[[0, -1]]), mesh[[0, -1]]
    worst, x = 0.0, np.zeros(0)

    def rate(x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        q, qd = np.split(x, 2)
        return np.concatenate([qd, acceleration(q, qd, tau)])

    for start, end in pairwise(mesh):
        count = int(np.ceil((end - start) / STEP))
        t = np.linspace(start, end, 2 * count + 1)
        t[-1] -= 1e-9  # the torque before the break
        tau = torque(t)
        own = motion.sample(t)
        h = (end - start) / count
        for k in range(count):
            if n % SEGMENT == 0:
                x = np.concatenate([own.q[2 * k], own.qd[2 * k]])
            n += 1
            if (n - 1) // SEGMENT % EVERY:
                continue
            first = rate(x, tau[2 * k])
            second = rate(x + 0.5 * h * first, tau[2 * k + 1])
            third = rate(x + 0.5 * h * second, tau[2 * k + 1])
            fourth = rate(x + h * third, tau[2 * k + 2])
            x = x + h / 6 * (first + 2 * second + 2 * third + fourth)
            worst = max(worst, float(np.abs(x[: x.size // 2] - own.q[2 * k + 2]).max()))
            if worst > enough:
                return worst
    return worst


def usual(robot: mo.Robot) -> Iterator[tuple[str, Motion]]:
    yield from islice(shapes(robot, 0.8), 1)
    yield from planned(robot)


def further(robot: mo.Robot) -> Iterator[tuple[str, Motion]]:
    yield from islice(shapes(robot, 0.8), 1, None)
    yield from others(robot)


@pytest.fixture(scope="module", params=[usual, pytest.param(further, marks=pytest.mark.thorough)])
def kinds(request) -> tuple[mo.Robot, dict[str, Motion]]:
    robot = plain(mo.load_robot("microbot"))
    return robot, dict(request.param(robot))


def agrees(robot: mo.Robot, motion: Motion) -> None:
    """Passed by the certificate and found by other simulators, that one torque is wrong, too."""
    name, wrong = motion.label, replace(motion, tau=motion.tau * 1.001)
    found = mo.certify(robot, motion, FREE)
    assert found.ok, f"{name}: {found.verdict}"
    for simulator in (by_mujoco, by_pinocchio):
        acceleration = simulator(robot)
        assert largest_miss(acceleration, motion) < 1e-7, name
        assert largest_miss(acceleration, wrong, 1e-6) > 1e-6, name


@pytest.mark.thorough
@pytest.mark.slow
def test_others_find_the_same_motion(kinds):
    robot, motions = kinds
    for name, motion in motions.items():
        agrees(robot, replace(motion, label=name))


@pytest.mark.thorough
@pytest.mark.slow
def test_others_find_the_same_motion_among_obstacles():
    pytest.importorskip("coal")
    robot = plain(mo.load_robot("microbot"))
    for name, motion in among_obstacles(robot):
        agrees(robot, replace(motion, label=name))


@pytest.mark.thorough
def test_others_find_the_same_motion_with_what_is_picked_up():
    robot = plain(mo.load_robot("microbot"))
    poses = list(map(list, via(robot)))
    stops = [mo.Stop(q=poses[0]), mo.Stop(q=poses[1], dwell=0.1, payload=3.0), mo.Stop(q=poses[2])]
    motion = mo.time_optimal(robot, stops)
    assert mo.certify(robot, motion, via_q=stops).ok
    parts = stretches(task_of(robot, stops), motion)
    assert {part.robot.links[-1].mass for part in parts} == {
        robot.links[-1].mass + load for load in (0.0, 3.0)
    }
    for start, end, own, _ in parts:
        part = _part(motion, own, start, end)
        agrees(own, part)
        if own != robot:
            assert largest_miss(by_mujoco(robot), part) > 1e-6
            assert largest_miss(by_pinocchio(robot), part) > 1e-6


@pytest.mark.thorough
def test_mujoco_finds_the_motion_of_a_design_before_and_after_at_its_stops():
    robot = plain(mo.load_robot("microbot"))
    stops = [mo.Stop(position=[0.3, y, 0.2], name=name) for y, name in ((0.2, "a"), (-0.3, "b"))]
    settings = mo.layout.DesignSettings(nodes=4, solves=3, starts=0)
    bounds = {"base.x": (-0.1, 0.1), "base.yaw": (-0.3, 0.3)}
    found = mo.design(robot, stops, [*bounds], bounds, settings=settings, starts=1)
    assert found.before is not None
    assert found.period < found.period_before
    for cell in (found.before, found.after):
        arm, motion = cell.robot, cell.motion
        assert largest_miss(by_mujoco(arm), motion) < 1e-7
        model = mujoco.MjModel.from_xml_string(mjcf(arm))
        data = mujoco.MjData(model)
        for mark, stop in zip(motion.marks, cell.stops, strict=True):
            data.qpos[:] = motion.sample([mark.time]).q[0]
            mujoco.mj_forward(model, data)
            tool = data.xpos[-1] + data.xmat[-1].reshape(3, 3) @ arm.tool[:3, 3]
            np.testing.assert_allclose(tool, stop.position, atol=1e-6)
    assert not np.allclose(found.after.robot.base, robot.base)


@pytest.mark.slow
@pytest.mark.parametrize("simulator", [by_mujoco, by_pinocchio])
def test_others_find_the_same_motion_of_seven_joints(simulator):
    robot = plain(mo.load_robot("panda"))
    for name, motion in shapes(robot, 1.0):
        assert largest_miss(simulator(robot), motion) < 1e-7, name


@pytest.mark.slow
@pytest.mark.thorough
def test_mutations_of_every_kind_of_motion_are_found(kinds):
    robot, motions = kinds
    for kind, motion in motions.items():
        for what, other, wrong in mutations(robot, motion):
            found = mo.certify(other, wrong, FREE)
            assert not found.ok, f"{kind}: {what}"
            assert found.verdict.startswith("Failed: "), f"{kind}: {what}"


@pytest.mark.parametrize("name", ["puma560", "panda"])
def test_slow_motions_pass_whatever_one_simulation_makes_of_them(name):
    robot = mo.load_robot(name)
    kind, motion = next(shapes(robot, 8.0))
    found = mo.certify(robot, motion, FREE)
    assert found.ok, f"{kind}: {found.verdict}"
    assert found.amplification > 1e4
    assert found.defect < 1e-8
