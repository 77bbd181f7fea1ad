"""An SRDF file as data: what MoveIt says of a robot beside its URDF.

Format: http://wiki.ros.org/srdf. Read are the chains of groups, named states, and the pairs of
links whose collisions are disabled; what is about planning groups alone has no place in a robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError, naming
from microbot_ocp._base.reading import bytes_of
from microbot_ocp.robot.files._remarks import Remarks
from microbot_ocp.robot.files._urdf_file import number_from
from microbot_ocp.robot.files._xml import read_xml

UNREAD = ("disable_default_collisions", "enable_collisions", "link_sphere_approximation")


@dataclass(frozen=True, eq=False)
class SrdfFile:
    """All of a file that a robot can hold.

    Attributes
    ----------
    tips : group -> link at the end of its chain; groups without a chain are left out
    states : names, and their joint -> position, rad or m
    disabled : pairs of links that may touch, each in alphabetical order
    """

    tips: dict[str, str]
    states: tuple[tuple[str, dict[str, float]], ...]
    disabled: tuple[tuple[str, str], ...]


def read_srdf(path: str | Path) -> SrdfFile:
    """Read an SRDF file.

    Raises
    ------
    InputError
        A file that cannot be read or is no SRDF, a name that is missing, a value that is no number.
    """
    name, remarks = Path(path).name, Remarks()
    with naming(f"{name}: "):
        content = _content(read_xml(bytes_of(path, "SRDF file"), remarks), remarks)
    remarks.warn(name)
    return content


def _content(root: Element, remarks: Remarks) -> SrdfFile:
    if root.tag != "robot":
        raise InputError(f"it is not an SRDF: its root is <{root.tag}>, not <robot>")
    for kind in UNREAD:
        if root.find(kind) is not None:
            remarks.add("elements of the SRDF are left out", f"<{kind}>")
    tips, states = dict[str, str](), list[tuple[str, dict[str, float]]]()
    for group in root.findall("group"):
        if (chain := group.find("chain")) is not None:
            tips[_text(group, "name")] = _text(chain, "tip_link")
    for state in root.findall("group_state"):
        name = _text(state, "name")
        positions = {}
        for joint in state.findall("joint"):
            label = f"value of joint {_text(joint, 'name')!r} in the state {name!r}"
            value = number_from(label, _text(joint, "value").split()[0])
            positions[_text(joint, "name")] = checks.number(label, value)
        states.append((name, positions))
    pairs = {
        tuple(sorted((_text(pair, "link1"), _text(pair, "link2"))))
        for pair in root.findall("disable_collisions")
    }
    return SrdfFile(tips, tuple(states), tuple(sorted(pairs)))  # type: ignore[arg-type]


def _text(element: Element, key: str) -> str:
    text = element.get(key, "").strip()
    if not text:
        raise InputError(f"<{element.tag}> of the SRDF lacks {key}")
    return text
