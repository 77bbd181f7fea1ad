"""The two conventions of Denavit and Hartenberg: tables of one as tables of the other.

Standard (distal) rows put frame i at the far end of link i: ``T(i-1, i) = Rot_z(theta_i)
Trans_z(d_i) Trans_x(a_i) Rot_x(alpha_i)`` (Denavit and Hartenberg, 1955; Paul; Spong). Modified
(proximal) rows put it at joint i (Craig). Between two joints both have the same twist and length,
which stand in row i of the one and in row i + 1 of the other; so frame i of the standard table is
``Trans_x(a_i) Rot_x(alpha_i)`` after frame i of the modified one.
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
    """Return what is given of a standard table [n] in the frames at the joints, those of a modified
    one.

    Returns
    -------
    rows, links, shapes, end
        Twists and lengths [2,n]; the frame at the far end of the last link [4,4], where the tool
        is, in that at its joint.
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
    """Return what is odd about a table and would not be in the other convention; empty if nothing.

    Of the modified convention a first row that is not zero places the base, as is usual. It is odd
    only where nothing is ``placed`` by a base or a tool and the last two axes are parallel: then
    the table has a link before its first joint, but none after its last.
    """
    coincident = {
        "modified": _coincident(alpha[1:], a[1:], kinds),
        "standard": _coincident(alpha[:-1], a[:-1], kinds),
    }
    odd = coincident[convention]
    other: Convention = "standard" if convention == "modified" else "modified"
    parallel = np.isclose(np.sin(alpha[-1]), 0.0)
    first = convention == "modified" and alpha.size > 1 and not placed and parallel
    if first and kinds[0] == "revolute" and (alpha[0] or a[0]):  # rails lie as they please
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
    """Return revolute joints one after another about the same axis."""
    same = [
        f"joints {joint + 1} and {joint + 2} turn about the same axis"
        for joint in range(alpha.size)
        if kinds[joint] == kinds[joint + 1] == "revolute" and alpha[joint] == a[joint] == 0.0
    ]
    return same[:1]
