"""URDF files as three packages ship them, every chain of them against pinocchio on the same file.

``PYTHONPATH=tests:src python tests/external/urdf_packages.py`` prints the table by file; with
``--chains`` a line for every chain, too.

The files come with ``example-robot-data``, ``rtb-data`` and ``airo-models``, which others maintain.
Pinocchio reads the whole tree without mimics; joints that are not on the way to the tip stand still
at zero, or where a mimic's offset has them; those on it that follow others are moved with them.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from lxml import etree

import microbot_ocp as mo
from helpers import batch, random_states

PACKAGES = ("example-robot-data", "rtb-data", "airo-models")
STATES = 50
QUANTITIES = ("FK", "J", "RNEA", "M")


class File(NamedTuple):
    """A file, its links at the ends with a moving joint before them, and what its mimics add."""

    path: Path
    tips: tuple[str, ...]
    joint_count: int  # that move
    offsets: dict[str, float]

    @property
    def label(self) -> str:
        return f"{self.path.parent.parent.name}/{self.path.name}"


class Chain(NamedTuple):
    """One chain, and its largest relative differences; NaN without masses."""

    tip: str
    joint_count: int
    differences: tuple[float, ...]
    warnings: tuple[str, ...]


def files() -> list[File]:
    """All URDF files of the packages that are installed."""
    return sorted(map(file_at, paths()), key=lambda file: file.label)


def paths() -> list[Path]:
    """Where they are, in the order of their packages and of their names there."""
    found = []
    for package in PACKAGES:
        try:
            listed = metadata.files(package) or []
        except metadata.PackageNotFoundError:
            continue
        found += sorted(Path(str(f.locate())) for f in listed if f.suffix == ".urdf")
    return found


def file_at(path: Path) -> File:
    """The file at a place, its ends and its joints."""
    root = etree.fromstring(path.read_bytes(), etree.XMLParser(recover=True))
    if root is None:
        return File(path, (), 0, {})
    above = {j.find("child").get("link"): j for j in root.findall("joint")}
    parents = {j.find("parent").get("link") for j in above.values()}

    def moves(link: str) -> bool:
        while link in above:
            if above[link].get("type") != "fixed":
                return True
            link = above[link].find("parent").get("link")
        return False

    tips = tuple(link for link in above if link not in parents and moves(link))
    moving = [j for j in above.values() if j.get("type") != "fixed"]
    names = {j.get("name") for j in moving}
    mimics = {j.get("name"): m for j in moving if (m := j.find("mimic")) is not None}

    def held(name: str) -> float:
        mimic = mimics.get(name)
        if mimic is None or mimic.get("joint") not in names:
            return 0.0
        leader = held(mimic.get("joint"))
        return float(mimic.get("multiplier", 1)) * leader + float(mimic.get("offset", 0))

    offsets = {name: position for name in mimics if (position := held(name))}
    return File(path, tips, len(moving), offsets)


def chains(file: File, most: int | None = None) -> Iterator[Chain]:
    """Chains from the root to the links at an end, compared: all, or about ``most`` of them."""
    model = pin.buildModelFromUrdf(str(file.path))
    told: dict[tuple[str, ...], tuple[float, float]] = {}
    step = -(-len(file.tips) // most) if most else 1
    for tip in file.tips[::step]:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            robot = mo.robot.load_urdf(file.path, tip)
        states = random_states(robot, STATES, seed=7)
        tree = Tree(model, robot, file.offsets)
        differences = _kinematics(robot, tree, tip, states[0])
        if robot.chain.joint_names not in told:
            told[robot.chain.joint_names] = _dynamics(robot, tree, *states)
        differences += told[robot.chain.joint_names]
        yield Chain(tip, robot.joint_count, differences, tuple(str(w.message) for w in caught))


class Tree:
    """Pinocchio's model of the whole file, of which only the joints of a chain move."""

    def __init__(self, model: pin.Model, robot: mo.Robot, offsets: dict[str, float]) -> None:
        self.model, self.data, self.robot = model, model.createData(), robot
        self.joints = [model.joints[model.getJointId(name)] for name in robot.chain.joint_names]
        self.columns = [joint.idx_v for joint in self.joints]
        self.held = pin.neutral(model)
        for name, offset in offsets.items():
            joint = model.joints[model.getJointId(name)]
            self.held[joint.idx_q : joint.idx_q + joint.nq] = _position(joint, offset)

    def position(self, q: np.ndarray) -> np.ndarray:
        full = self.held.copy()
        for joint, value in zip(self.joints, self.robot.chain_positions(q), strict=True):
            full[joint.idx_q : joint.idx_q + joint.nq] = _position(joint, value)
        return full

    def rate(self, qd: np.ndarray) -> np.ndarray:
        full = np.zeros(self.model.nv)
        full[self.columns] = self.robot.transmission @ qd
        return full


def _position(joint: pin.JointModel, value: float) -> list[float]:
    """As pinocchio has it: cosine and sine for a joint without limits."""
    return [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]


def relative(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Largest difference at any state, relative to the largest entry of that state."""
    theirs = np.asarray(theirs)
    ours = np.reshape(ours, theirs.shape)
    axes = tuple(range(1, theirs.ndim))
    size = np.abs(theirs).max(axis=axes)
    worst = np.abs(ours - theirs).max(axis=axes)
    return float(np.divide(worst, size, out=worst.copy(), where=size > 0).max())


def _kinematics(robot: mo.Robot, tree: Tree, tip: str, q: np.ndarray) -> tuple[float, ...]:
    model, data = tree.model, tree.data
    frame = model.getFrameId(tip, pin.BODY)
    poses, slopes = [], []
    for row in map(tree.position, q):
        slope = pin.computeFrameJacobian(model, data, row, frame, pin.LOCAL_WORLD_ALIGNED)
        slopes.append(slope.reshape(6, model.nv)[:, tree.columns] @ robot.transmission)
        pin.framesForwardKinematics(model, data, row)
        poses.append(data.oMf[frame].homogeneous)
    ours = (batch(mo.forward_kinematics(robot), q), batch(mo.jacobian(robot), q))
    return relative(ours[0], np.array(poses)), relative(ours[1], np.array(slopes))


def _dynamics(
    robot: mo.Robot, tree: Tree, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> tuple[float, float]:
    model, data, at, moved = tree.model, tree.data, tree.columns, robot.transmission
    tau = [
        moved.T @ pin.rnea(model, data, tree.position(row), tree.rate(speed), tree.rate(change))[at]
        for row, speed, change in zip(q, qd, qdd, strict=True)
    ]
    upper = []
    for row in q:
        whole = np.reshape(pin.crba(model, data, tree.position(row)), (model.nv, model.nv))
        upper.append(np.triu(whole)[np.ix_(at, at)])
    if not robot.has_dynamics:
        assert not np.any(tau)
        return np.nan, np.nan
    smooth = [replace(link, viscous_friction=0.0, coulomb_friction=0.0) for link in robot.links]
    bare = robot.with_links(smooth)
    mass = np.array([moved.T @ (u + np.triu(u, 1).T) @ moved for u in upper])
    return (
        relative(batch(mo.inverse_dynamics(bare), q, qd, qdd), np.array(tau)),
        relative(batch(mo.mass_matrix(bare), q), mass),
    )


def main(every_chain: bool) -> None:
    """Print the table by file, what is refused and why, and the counts."""
    every, moving, counted, worst = files(), 0, 0, np.zeros(4)
    head = f"{'file':52} {'tips':>9} {'joints':>7}" + "".join(f"{q:>9}" for q in QUANTITIES)
    print(head, " without tip")
    refused = []
    for file in every:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                robot = mo.robot.load_urdf(file.path)
                alone = f"{robot.joint_count} joints"
            except mo.InputError as problem:
                alone = str(problem)
        if not file.joint_count:
            refused.append(alone)
            continue
        moving += 1
        done = list(chains(file))
        counted += len(done)
        largest = np.array([c.differences for c in done]).T
        by_quantity = [np.nanmax(row) if np.isfinite(row).any() else np.nan for row in largest]
        worst = np.fmax(worst, by_quantity)
        counts = [c.joint_count for c in done]
        print(
            f"{file.label[-52:]:52} {len(done):4}/{len(file.tips):4} "
            f"{f'{min(counts)}-{max(counts)}':>7}"
            + "".join(f"{value:9.1e}" for value in by_quantity),
            f" {alone[:60]}",
        )
        for chain in done if every_chain else ():
            figures = "".join(f"{value:9.1e}" for value in chain.differences)
            print(f"    {chain.tip:48} {'':9} {chain.joint_count:7}{figures}")
        for text in sorted(
            {text for c in done for text in c.warnings} | {str(w.message) for w in caught}
        ):
            print(f"    {text[:300]}")
    print(f"\n{len(every)} files, {moving} with a moving joint, {counted} chains")
    print("largest relative differences", dict(zip(QUANTITIES, worst.tolist(), strict=True)))
    print("refused:", *refused, sep="\n    ")


if __name__ == "__main__":
    main("--chains" in sys.argv)
