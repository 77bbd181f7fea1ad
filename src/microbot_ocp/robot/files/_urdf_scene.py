"""What stands still in a URDF file, as geometry: a table, a shelf, a whole cell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from microbot_ocp._base.checks import InputError, naming
from microbot_ocp.robot._shapes import Shape
from microbot_ocp.robot.files._remarks import Remarks
from microbot_ocp.robot.files._urdf_file import urdf_file
from microbot_ocp.robot.files._xacro import urdf_content
from microbot_ocp.robot.files._xml import read_xml


def read_urdf_shapes(path: str | Path) -> tuple[Shape, ...]:
    """Give collision geometry of a URDF file without moving joints, in the frame of its root link.

    Raises
    ------
    InputError
        A file that cannot be read or is no URDF, a joint that moves, links without a way from the
        root.
    """
    file = Path(path)
    data = urdf_content(file, "scene file")
    remarks = Remarks()
    with naming(f"{file.name}: "):
        read = urdf_file(read_xml(data, remarks), file.name, file.absolute().parent, remarks)
    remarks.warn(file.name)
    above = {joint.child: joint for joint in read.joints.values()}
    shapes = []
    for name, link in read.links.items():
        pose, at, passed = np.eye(4), name, 0
        while at in above:
            joint = above[at]
            if joint.moves:
                raise InputError(
                    f"{file.name}: joint {joint.name!r} moves, but what stands around an arm has "
                    "no moving joints"
                )
            pose, at, passed = joint.frame @ pose, joint.parent, passed + 1
            if passed > len(read.links) or at not in read.links:
                raise InputError(f"{file.name}: link {name!r} has no way from a root link")
        shapes += [
            replace(shape, frame=0, pose=pose @ shape.pose)
            for shape in link.shapes
            if shape.role == "collision"
        ]
    return tuple(shapes)
