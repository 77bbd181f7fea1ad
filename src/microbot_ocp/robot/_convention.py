"""The two conventions of Denavit and Hartenberg, and the conversion to the modified one.

Standard (distal) rows put frame i at the far end of link i: ``T(i-1, i) = Rot_z(theta_i)
Trans_z(d_i) Trans_x(a_i) Rot_x(alpha_i)`` (Denavit and Hartenberg, 1955; Paul; Spong). Modified
(proximal) rows put it at joint i (Craig). The twist and length between two joints agree in both;
they stand in row i of a standard table and in row i + 1 of a modified one. Frame i of the standard
table is therefore ``Trans_x(a_i) Rot_x(alpha_i)`` after frame i of the modified one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot._links import Link
from microbot_ocp.robot._shapes import Shape
from microbot_ocp.robot._transforms import dh_transform

Convention = Literal["modified", "standard"]
NAMES = {"modified": "modified (Craig's, proximal)", "standard": "standard (distal)"}


def as_modified(
    alpha: FloatArray, a: FloatArray, links: Sequence[Link], shapes: Sequence[Shape]
) -> tuple[FloatArray, tuple[Link, ...], tuple[Shape, ...], FloatArray]:
    """Return the data of a standard table [n] in the frames of a modified one.

    Returns
    -------
    rows, links, shapes, end
        Twists and lengths [2,n], links, shapes, and the standard frame [4,4] of the last link,
        to which the tool refers, in the modified one.
    """
    rows = np.zeros((2, alpha.size))
    rows[:, 1:] = alpha[:-1], a[:-1]
    rows.setflags(write=False)
    ends = [dh_transform(*row, 0.0, 0.0) for row in zip(alpha, a, strict=True)]
    moved = []
    for joint, link in enumerate(links):
        turn, rotor = ends[joint][:3, :3], link.rotor
        carrier = joint if rotor is None or rotor.carrier is None else rotor.carrier
        if rotor is not None and carrier:
            rotor = replace(rotor, axis=ends[carrier - 1][:3, :3] @ rotor.axis)
        # The link moves from the frame at its far end to the frame at its joint.
        inertia = turn @ link.inertia @ turn.T
        center = turn @ link.center_of_mass + ends[joint][:3, 3]
        inertia = (inertia + inertia.T) / 2
        moved.append(replace(link, center_of_mass=center, inertia=inertia, rotor=rotor))
    placed = (
        replace(shape, pose=ends[shape.frame - 1] @ shape.pose) if shape.frame else shape
        for shape in shapes
    )
    return rows, tuple(moved), tuple(placed), ends[-1]


def doubts(
    convention: Convention, alpha: FloatArray, a: FloatArray, kinds: Sequence[str], placed: bool
) -> str:
    """Return oddities of a table that the other convention would not have; empty if there are none.

    In the modified convention a nonzero first row usually places the base. It is odd only without a
    base or tool (``placed``) and with parallel last axes: the table has a link before its first
    joint but none after its last.
    """
    coincident = {
        "modified": _coincident(alpha[1:], a[1:], kinds),
        "standard": _coincident(alpha[:-1], a[:-1], kinds),
    }
    odd = coincident[convention]
    other: Convention = "standard" if convention == "modified" else "modified"
    parallel = np.isclose(np.sin(alpha[-1]), 0.0)
    first = convention == "modified" and alpha.size > 1 and not placed and parallel
    # Prismatic first axes have any direction.
    if first and kinds[0] == "revolute" and (alpha[0] or a[0]):
        twist = f"alpha {np.degrees(alpha[0]):.4g} deg, a {a[0]:.4g} m"
        odd = [f"there is a link before its first joint ({twist}), but none after its last", *odd]
    if not odd or coincident[other]:
        return ""
    meant = ", or convention='modified' if it is meant" if convention == "modified" else ""
    return (
        f"the DH table looks like one of the {NAMES[other]} convention, but is read as "
        f"{NAMES[convention]}: {', and '.join(odd)}. Give convention={other!r}{meant}"
    )


def _coincident(alpha: FloatArray, a: FloatArray, kinds: Sequence[str]) -> list[str]:
    """Return a note on the first two successive revolute joints that share an axis."""
    same = [
        f"joints {joint + 1} and {joint + 2} turn about the same axis"
        for joint in range(alpha.size)
        if kinds[joint] == kinds[joint + 1] == "revolute" and alpha[joint] == a[joint] == 0.0
    ]
    return same[:1]
