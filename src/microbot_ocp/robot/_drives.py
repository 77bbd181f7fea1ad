"""What a model leaves out of its drives, where little else bounds how fast joints speed up."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from microbot_ocp.robot._model import Robot


def drive_advice(robot: Robot, qdd: Any = None) -> str:
    """Say which joints may speed up at once, as no drive does, and what to give for them.

    These are joints that nothing limits but their velocity, and those that a torque turns whose
    link is a body with an inertia of its own, but whose rotor, most of what a geared drive turns,
    is not given. Where links are points with masses, as in textbooks, nothing is said.

    Parameters
    ----------
    robot : Robot
    qdd : array_like [N,n], optional
        Accelerations of a motion, to say what they come to.

    Returns
    -------
    str
        A sentence without its full stop; empty where nothing is left out.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> drive_advice(mo.load_robot("microbot"))
    ''
    >>> drive_advice(mo.load_robot("planar_3r")).partition(" nor")[0]
    'motions may begin faster than a drive can: of wrist neither the rotor inertia'
    """
    masses = robot.has_dynamics
    limited = {key: np.isfinite(robot.limits.bounds(key)).any(0) for key in ("tau", "taud")}
    bounded = np.isfinite([robot.limits.bounds(key) for key in ("qdd", "qddd")]).any((0, 1))
    bounded |= limited["taud"] & masses
    unlimited = np.flatnonzero(~bounded & ~(limited["tau"] & masses)).tolist()
    limitless = np.flatnonzero(~bounded).tolist()
    without_rotor = [
        k
        for k, link in enumerate(robot.links)
        if link.inertia.any() and not link.armature and link.rotor is None and k in limitless
    ]
    if unlimited:
        joints, torque = unlimited, ("torque, ", "tau_max, ") if masses else ("", "")
        lacking = (
            f"no limit of {torque[0]}acceleration or jerk is given ({torque[1]}qdd_max, qddd_max)"
        )
    else:
        joints = without_rotor
        lacking = (
            "neither the rotor inertia nor a limit of acceleration, jerk or torque rate is given "
            "(armature, qdd_max, qddd_max, taud_max)"
        )
    if not joints:
        return ""
    everyone = len(joints) == robot.joint_count
    who = "any joint" if everyone else ", ".join(robot.joint_names[k] for k in joints)
    reached = "motions may begin faster than a drive can"
    if qdd is not None:
        peaks = np.abs(np.asarray(qdd)).max(axis=0)
        k = max(joints, key=lambda joint: peaks[joint])
        reached = f"{robot.joint_names[k]} reaches {peaks[k]:.5g} {robot.unit('qdd', k)}"
    return f"{reached}: of {who} {lacking}"
