"""Limits for every arm of a box, against arms that are drawn from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import any_robot, refused
from microbot_ocp.limits import LimitFamily, MotionSamples
from planning.shared import slider

BOX = {"mass": 0.1, "friction": 0.4, "payload": (0.5, 2.0)}


def extremes(robot, samples):
    """Largest and least torque over the box [N,n], by the limits."""
    values = LimitFamily.of(robot, mo.execution.robust_limits(robot, **BOX)).values(samples)
    return values["largest_torque"].value, values["least_torque"].value


@pytest.mark.parametrize(
    "name",
    ["microbot", *(pytest.param(n, marks=pytest.mark.thorough) for n in ("ur5e", "stanford"))],
)
def test_no_arm_of_the_box_needs_more_and_a_corner_needs_as_much(name):
    robot = mo.load_robot(name).with_limits(tau_max=100.0)
    draw = np.random.default_rng(1)
    samples = MotionSamples(*draw.normal(size=(4, 100, robot.joint_count)))
    largest, least = extremes(robot, samples)
    plants = mo.execution.differing_plants(robot, **BOX, count=15, seed=2)
    tau = np.array([plant.torques_along(*samples[:3])["tau"] for plant in plants])
    slack = 1e-9 * np.abs(largest).max()
    assert (tau <= largest + slack).all()
    assert (tau >= least - slack).all()
    state = [part[:1] for part in samples[:3]]  # the corner of each joint, factor by factor
    for joint in range(robot.joint_count):
        best = -np.inf
        for payload in BOX["payload"]:
            links = []
            for k in range(len(robot.links)):
                heavy = _varied(robot, k, 1.0 + BOX["mass"]), _varied(robot, k, 1.0 - BOX["mass"])
                more, less = (each.torques_along(*state)["tau"][0, joint] for each in heavy)
                links.append(1.0 + BOX["mass"] * np.sign(more - less))
            for rough in (1.0 - BOX["friction"], 1.0 + BOX["friction"]):
                arm = robot
                for k, factor in enumerate(links):
                    arm = _varied(arm, k, factor)
                arm = _rough(arm, rough).with_payload(payload)
                best = max(best, arm.torques_along(*state)["tau"][0, joint])
        # sizes have no kinks: each is at most a thousandth of the limit too large
        links, half = len(robot.links), 0.5 * np.ptp(BOX["payload"])
        rounded = 0.1 * (BOX["mass"] * links + BOX["friction"] + half)
        assert best - 1e-9 < largest[0, joint] < best + rounded


def _varied(robot, k, factor):
    links = list(robot.links)
    own = links[k]
    links[k] = replace(
        own, mass=own.mass * factor, inertia=own.inertia * factor, armature=own.armature * factor
    )
    return robot.with_links(links)


def _rough(robot, factor):
    return robot.with_links(
        [
            replace(
                link,
                viscous_friction=link.viscous_friction * factor,
                coulomb_friction=link.coulomb_friction * factor,
            )
            for link in robot.links
        ]
    )


@pytest.mark.thorough
def test_one_motion_for_all_of_them(microbot):
    box = {"mass": 0.05, "payload": (0.0, 0.2)}
    limits = mo.execution.robust_limits(microbot, **box)
    via_q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
    ideal, robust = (mo.time_optimal(microbot, via_q, each, starts=1) for each in (None, limits))
    assert robust.solved
    assert mo.certify(microbot, robust, limits).ok
    plants = mo.execution.differing_plants(microbot, **box, count=20)
    for motion, holds in ((robust, True), (ideal, False)):
        states = motion.history().samples[:3]
        uses = [
            np.abs(plant.torques_along(*states)["tau"]) / microbot.limits.tau_max
            for plant in plants
        ]
        assert (np.max(uses) < 1.005) == holds


def shortest(mass):
    """The time of a rail's mass over 1.6 m by 4 N, s."""
    return 2.0 * np.sqrt(1.6 * mass / 4.0)


def test_boxes_are_arguments_as_well():
    rail, via_q = slider(mass=2.0, tau_max=4.0), [[0.0], [1.6]]
    box = {"payload": (0.5, 1.0), "uncertain": {"mass": 0.05}}
    few = {"compiled": False, "starts": 1, "mesh": 40}
    motion = mo.time_optimal(rail, via_q, **box, **few)
    assert motion.duration == pytest.approx(shortest(2.0 * 1.05 + 1.0), rel=1e-3)
    limits = mo.execution.robust_limits(rail, mass=0.05, payload=(0.5, 1.0))
    for given in ({"limits": limits}, box):
        kept = mo.time_optimal(rail, via_q, **given, reserve=0.19, **few)
        assert kept.duration == pytest.approx(shortest(3.1) / 0.9, rel=1e-3)
        assert mo.certify(rail, kept, limits.with_reserve(0.19)).ok
    with refused("uncertain", "mass, friction", "'inertia'"):
        mo.time_optimal(rail, via_q, uncertain={"inertia": 0.1})


@pytest.mark.slow
def test_what_the_arm_carries_between_stops_counts():
    rail = slider(mass=2.0, tau_max=4.0)
    stops = [mo.Stop(q=[0.0], payload=mo.Payload(1.0)), mo.Stop(q=[1.6])]
    motion = mo.time_optimal(
        rail, stops, uncertain={"mass": 0.05}, compiled=False, starts=1, mesh=40
    )
    assert motion.duration == pytest.approx(shortest(2.0 * 1.05 + 1.0), rel=1e-3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"mass": -0.1}, ("mass", "at least 0", "-0.1")),
        ({"friction": 1.5}, ("friction", "at most 1", "1.5")),
        ({"payload": (2.0, 1.0)}, ("payload", "(least, largest)", "kg", "(2.0, 1.0)")),
    ],
)
def test_what_is_no_box(microbot, change, said):
    with refused(*said):
        mo.execution.robust_limits(microbot, **change)


def test_without_masses_or_torques():
    with refused("'microbot'", "limits of torques", "tau_max"):
        mo.execution.robust_limits(any_robot("microbot").with_limits(tau_max=np.inf))
    bare = mo.Robot.from_dh([0.0], [0.0], [0.0])
    with refused("'robot'", "no masses"):
        mo.execution.robust_limits(bare)
