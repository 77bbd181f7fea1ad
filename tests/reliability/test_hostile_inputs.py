"""Inputs that are meant to do harm: each is refused in one short line, and soon."""

from __future__ import annotations

import os
import struct
import time
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.cli import main
from microbot_ocp.ocp import SolverSettings
from microbot_ocp.robot import Shape, read_mesh
from microbot_ocp.sweeps import load_sweep, read_study

XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{inside}
<link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>
<child link="b"/><axis xyz="0 0 1"/></joint></robot>"""
MORE_TIME, MORE_BYTES = "more than 10 s", "more than 500,000,000 bytes"


def refused(read, *given) -> str:
    """The one line that a call is refused by."""
    begun = time.process_time()
    with pytest.raises(mo.InputError) as caught:
        read(*given)
    assert time.process_time() - begun < 10.0
    line = str(caught.value)
    assert line.isprintable()
    assert len(line) < 400
    return line


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that can be ended")
@pytest.mark.parametrize(
    ("expression", "said"),
    [
        ("'a' * 10**10", MORE_BYTES),
        ("[[0] * 10**6 for k in range(10**6)]", MORE_BYTES),
        pytest.param("9**9**9", MORE_TIME, marks=pytest.mark.thorough),
    ],
)
def test_an_expression_of_xacro_ends(tmp_path: Path, expression: str, said: str) -> None:
    pytest.importorskip("xacro")
    path = tmp_path / "arm.xacro"
    path.write_text(
        XACRO.format(inside=f'<xacro:property name="p" value="${{{expression}}}"/>${{p}}')
    )
    assert said in refused(mo.load_robot, path)
    path.write_text(XACRO.format(inside='<xacro:property name="p" value="${2**9}"/>'))
    assert mo.load_robot(path).joint_count == 1


@pytest.mark.parametrize("name", ["robot", "scene", "study"])
@pytest.mark.parametrize("key", ["a", "'a b'", "[a"])
def test_deep_keys_of_toml_take_no_time(tmp_path: Path, name: str, key: str) -> None:
    read = {"robot": mo.load_robot, "scene": mo.load_scene, "study": read_study}[name]
    path = tmp_path / f"{name}.toml"
    path.write_text(key + ".a" * 50_000 + ("]" if "[" in key else "=1"))
    assert "nested deeper than 200" in refused(read, path)


@pytest.mark.parametrize("name", ["robot", "scene", "study"])
def test_toml_of_megabytes_takes_no_time(tmp_path: Path, name: str) -> None:
    read = {"robot": mo.load_robot, "scene": mo.load_scene, "study": read_study}[name]
    path = tmp_path / f"{name}.toml"
    path.write_text("a = [" + "1," * 10_000_000 + "]")
    assert "more than 5,000,000 characters" in refused(read, path)


def test_comments_without_an_end_take_no_time(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text("<robot>" + "<!--" * 100_000)
    assert "not valid XML" in refused(mo.load_robot, path)


@pytest.mark.parametrize(
    "content",
    [b"x" * 80 + struct.pack("<I", 4 * 10**9), b"", b"solid a\nfacet"], ids=["head", "empty", "cut"]
)  # fmt: skip
def test_a_mesh_that_claims_more_than_it_has(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.stl"
    path.write_bytes(content)
    assert "a.stl" in refused(read_mesh, Shape(1, np.eye(4), "mesh", np.ones(3), path=str(path)))


READERS = {
    "robot": (mo.load_robot, "a\0\x1b[2J.toml"), "urdf": (mo.load_robot, "a\0\x1b[2J.urdf"),
    "xacro": (mo.load_robot, "a\0\x1b[2J.xacro"), "scene": (mo.load_scene, "a\0\x1b[2J"),
    "motion": (mo.Motion.load, "a\0\x1b[2J"), "solution": (mo.ocp.load_solution, "a\0\x1b[2J"),
    "comparison": (mo.load_comparison, "a\0\x1b[2J"), "sweep": (load_sweep, "a\0\x1b[2J"),
    "table": (mo.sweeps.Cases.table, "a\0\x1b[2J.csv"),
    "parquet": (mo.sweeps.Cases.table, "a\0\x1b[2J.parquet"),
}  # fmt: skip


@pytest.mark.parametrize("name", READERS)
def test_control_characters_of_a_path_are_written_as_codes(name: str) -> None:
    read, path = READERS[name]
    assert "\\x00" in refused(read, path)


NO_PIPES = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize(
    "kind", ["folder", "loop", pytest.param("pipe", marks=NO_PIPES), "empty", "noise"]
)
def test_what_is_no_file_of_the_kind(tmp_path: Path, name: str, kind: str) -> None:
    read, given = READERS[name]
    path = tmp_path / f"x{Path(given).suffix}"
    {
        "folder": path.mkdir,
        "loop": lambda: path.symlink_to(path),
        "pipe": lambda: os.mkfifo(path),
        "empty": path.touch,
        "noise": lambda: path.write_bytes(b"\xff\xfe\xfd" * 1000),
    }[kind]()
    if (name, kind) != ("scene", "empty"):  # which is a scene without obstacles
        refused(read, path)


@pytest.mark.parametrize(
    "name", ["ma57", pytest.param("pardiso", marks=pytest.mark.thorough), "nonsense", 3]
)
def test_a_linear_solver_that_is_not_there(name: object, capfd: pytest.CaptureFixture[str]) -> None:
    options = {"ipopt": {"linear_solver": name}}
    line = refused(lambda: SolverSettings(options=options))
    assert "ldl, mumps" in line
    assert repr(name) in line
    assert capfd.readouterr() == ("", "")


def test_an_if_in_a_limit_is_told_how_it_is_written() -> None:
    def height(state: mo.robot.MotionState) -> ca.SX:
        return state.tool[0, 3] if state.tool[0, 3] > 0 else 0.0

    robot = mo.load_robot("planar_2r").with_limits(also=[mo.Limit("height", height, upper=1.0)])
    assert "casadi.if_else" in refused(mo.time_optimal, robot, [[0, 0], [1, 1]])


def formula(t: ca.SX) -> list[Any]:
    return [t if t > 0 else 0, t]


class Switched:
    label = "switched"

    def torque(self, model: mo.Robot, reference: Any, q: ca.SX, qd: ca.SX) -> ca.SX:
        return -q if q[0] > 0 else q


def test_an_if_in_a_formula_or_a_controller_is_told_how_it_is_written() -> None:
    robot = mo.load_robot("planar_2r")
    motion = mo.time_optimal_path(robot, mo.straight_path([[0, 0], [1, 1]]))
    refusals = [
        refused(lambda: mo.simulate(robot, tau=formula, q0=[0, 0], qd0=[0, 0], t=[0.0, 0.1])),
        refused(lambda: mo.simulation.motion_from_formula(robot, formula, 1.0, label="x")),
        refused(lambda: mo.track(robot, motion, Switched())),
    ]
    assert all("casadi.if_else" in line for line in refusals)


def test_a_recording_that_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DISPLAY", ":99")
    path = tmp_path / "junk.rrd"
    path.write_bytes(b"junk" * 100)
    assert main(["replay", str(path), "--open"]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert "is no recording" in told.err
    assert told.err.count("\n") == 1
