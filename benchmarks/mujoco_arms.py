"""Arms as MuJoCo models."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import microbot_ocp as mo
from microbot_ocp.robot import dh_transform


def mjcf(robot: mo.Robot) -> str:
    """Write nested bodies with one hinge or slide along Z, explicit inertials, no contact."""
    import mujoco  # tests that need it are skipped without it

    def text(values: Any) -> str:
        return " ".join(f"{value:.17g}" for value in np.ravel(values))

    turn = np.zeros(4)
    mujoco.mju_mat2Quat(turn, robot.base[:3, :3].ravel())
    opening = [f'<body pos="{text(robot.base[:3, 3])}" quat="{text(turn)}">']
    closing = ["</body>"]
    for joint, link in enumerate(robot.links):
        row = (robot.alpha[joint], robot.a[joint], robot.d[joint], robot.theta_offset[joint])
        placement = dh_transform(*row)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, placement[:3, :3].ravel())
        kind = "hinge" if robot.joint_types[joint] == "revolute" else "slide"
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = link.inertia
        opening.append(
            f'<body pos="{text(placement[:3, 3])}" quat="{text(quaternion)}">'
            f'<joint type="{kind}" axis="0 0 1" armature="{link.armature:.17g}" '
            f'damping="{link.viscous_friction:.17g}"/>'
            f'<inertial pos="{text(link.center_of_mass)}" mass="{link.mass:.17g}" '
            f'fullinertia="{text([xx, yy, zz, xy, xz, yz])}"/>'
        )
        closing.append("</body>")
    return (
        '<mujoco><compiler angle="radian"/>'
        f'<option gravity="{text(robot.gravity)}">'
        '<flag contact="disable" energy="disable" constraint="disable"/></option>'
        f"<worldbody>{''.join(opening + closing)}</worldbody></mujoco>"
    )


def with_small_bodies(robot: mo.Robot) -> mo.Robot:
    """Replace point masses, which MuJoCo refuses, by balls of 0.01 kg m^2."""
    return robot.with_links(
        [
            link if link.inertia.any() else replace(link, inertia=0.01 * np.eye(3))
            for link in robot.links
        ]
    )
