"""Arms of MuJoCo that differ from the model, under computed torque that saturates and is sampled.

The reserve is found on a few arms of the package's own simulation; then arms drawn from the same
box of masses are played by MuJoCo, with that reserve and without. MuJoCo takes no point masses and
the command no dry friction: every link is a ball of 0.01 kg m^2 without Coulomb friction.

    PYTHONPATH=tests python -m benchmarks plants --robot microbot --count 20
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import numpy as np

import microbot_ocp as mo
from execution.test_reserve import BOUND, GAIN, RATE, played
from external.test_mujoco import with_small_bodies


def main(arguments: list[str] | None = None) -> None:
    """One arm, one line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks plants", description=__doc__)
    parser.add_argument("--robot", default="microbot")
    parser.add_argument("--count", type=int, default=500, help="arms that are drawn")
    parser.add_argument("--mass", type=float, default=0.05, help="share of every link's mass")
    parser.add_argument("--bound", type=float, default=BOUND, help="of the tool's error, m")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    robot = mo.load_robot(options.robot)
    smooth = [replace(link, coulomb_friction=0.0) for link in robot.links]
    robot = with_small_bodies(robot.with_links(smooth))
    draw = np.random.default_rng(options.seed)
    low, high = np.maximum(robot.limits.q_min, -1.2), np.minimum(robot.limits.q_max, 1.2)
    via_q = draw.uniform(low, high, (2, robot.joint_count))
    box = {"mass": options.mass, "seed": options.seed}
    few = mo.execution.differing_plants(robot, count=2, **box)
    loop: Any = mo.ComputedTorque(kp=GAIN)
    reserve = mo.smallest_reserve(robot, via_q, loop, few, options.bound, sample_rate=RATE)
    plants = mo.execution.differing_plants(robot, count=options.count, **box)
    rows = {"ideal": reserve.ideal, f"reserve {100 * reserve.reserve:.1f} %": reserve.motion}
    for name, motion in rows.items():
        errors = np.array([played(robot, motion, plant) for plant in plants])
        print(
            f"{options.robot}, {name}: {motion.duration:.4f} s, {len(plants)} arms, tool error "
            f"median {1e3 * np.median(errors):.2f} mm, worst {1e3 * errors.max():.2f} mm, "
            f"{(errors > options.bound).sum()} above {1e3 * options.bound:.0f} mm"
        )
