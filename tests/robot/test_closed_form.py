"""Closed forms: what they evaluate to as series and as programs, how they read."""

from __future__ import annotations

import ctypes
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import formulas
import microbot_ocp as mo
from helpers import crossed, random_robot, refused
from microbot_ocp._base.checks import FloatArray
from microbot_ocp.robot import _equation_text

SIX = [name for name in mo.packaged_robots() if mo.load_robot(name).joint_count <= 6]
STATES = 5


def numbers(robot: mo.Robot, q: FloatArray, qd: FloatArray) -> dict[str, FloatArray]:
    found = {
        "forward_kinematics": mo.forward_kinematics(robot)(q),
        "mass_matrix": mo.mass_matrix(robot)(q),
        "coriolis_matrix": mo.coriolis_matrix(robot)(q, qd),
        "gravity_torque": mo.gravity_torque(robot)(q),
    }
    return {name: np.array(value).squeeze() for name, value in found.items()}


def states(count: int) -> FloatArray:
    return np.random.default_rng(0).uniform(-3.0, 3.0, (STATES, 2, count))


def in_python(text: str, q: FloatArray, qd: FloatArray) -> dict[str, FloatArray]:
    program: dict = {}
    exec(text, program)
    given = {name: (q, qd) if name == "coriolis_matrix" else (q,) for name in numbers_of(program)}
    return {name: np.array(program[name](*args)).squeeze() for name, args in given.items()}


def numbers_of(program: dict) -> list[str]:
    return [name for name in program if name.endswith(("kinematics", "_matrix", "torque"))]


def from_matlab(text: str) -> str:
    """The functions of a MATLAB file as Python, of which they use little."""
    text = re.sub(r" \.\.\.\n\s*", " ", text[text.index("function T = ") :])
    text = re.sub(r"function (\w) = (\w+\(.*?\))", r"def \2:", text)
    text = re.sub(r"zeros\((\d+), (\d+)\)", r"[[0.0] * \2 for _ in range(\1)]", text)
    text = re.sub(
        r"\b([TMC])\((\d), (\d)\)", lambda m: f"{m[1]}[{int(m[2]) - 1}][{int(m[3]) - 1}]", text
    )
    text = re.sub(r"\bg\((\d)\)", lambda m: f"g[{int(m[1]) - 1}][0]", text)
    text = re.sub(r"\b(qd?)\((\d)\)", lambda m: f"{m[1]}[{int(m[2]) - 1}]", text)
    result = re.finditer(r"(\w) = \[\[0.0\]", text)
    for name in [found[1] for found in result]:
        text = text.replace("\nend", f"\n    return {name}", 1)
    return "from math import cos, sin\n" + text.replace(";", "").replace("%", "#")


@pytest.mark.parametrize(("name", "language"), crossed(SIX, ["python", "matlab"]))
def test_programs_are_the_dynamics(name: str, language: str) -> None:
    robot = mo.load_robot(name)
    text = mo.robot.closed_form(robot).text(language)
    program = from_matlab(text) if language == "matlab" else text
    for q, qd in states(robot.joint_count):
        expected = numbers(robot, q, qd)
        for title, value in in_python(program, q, qd).items():
            size = max(1.0, float(np.abs(expected[title]).max()))
            np.testing.assert_allclose(value, expected.pop(title), rtol=0, atol=1e-12 * size)
        assert not expected


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="compiles as Linux does")
@pytest.mark.parametrize("name", ["stanford", "ur5e"])
def test_c_is_the_dynamics(name: str, tmp_path: Path) -> None:
    compiler = mo.compiler()
    if compiler is None:
        pytest.skip("no C compiler")
    robot = mo.load_robot(name)
    source = mo.robot.closed_form(robot).export(tmp_path / "arm.c")
    flags = ["-O0", "-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "-o", tmp_path / "arm.so", source, "-lm"], check=True)
    library = ctypes.CDLL(str(tmp_path / "arm.so"))
    for q, qd in states(robot.joint_count):
        for title, expected in numbers(robot, q, qd).items():
            found = np.full(expected.shape, np.nan)
            given = (q, qd) if title == "coriolis_matrix" else (q,)
            pointers = [np.ascontiguousarray(x).ctypes.data_as(ctypes.c_void_p) for x in given]
            library[title](*pointers, found.ctypes.data_as(ctypes.c_void_p))
            size = max(1.0, float(np.abs(expected).max()))
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * size)


@pytest.mark.parametrize("kinds", ["rr", "prr", "rrprp"])
def test_series_are_the_dynamics(kinds: str) -> None:
    robot = random_robot(kinds)
    form = mo.robot.closed_form(robot)
    for q, qd in states(len(kinds)):
        expected = numbers(robot, q, qd)
        symbols = np.array([[[c(q) for c in row] for row in rows] for rows in form.christoffel])
        found = {
            "forward_kinematics": [[entry(q) for entry in row] for row in form.pose],
            "mass_matrix": [[entry(q) for entry in row] for row in form.mass],
            "coriolis_matrix": symbols @ qd,
            "gravity_torque": [entry(q) for entry in form.gravity],
        }
        for title, value in expected.items():
            size = max(1.0, float(np.abs(value).max()))
            np.testing.assert_allclose(found[title], value, rtol=0, atol=1e-12 * size)
    assert len(form.lines()) == sum(range(len(kinds) + 1)) + len(kinds) ** 2 + len(kinds)


def test_long_sums_are_several_statements(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_equation_text, "MOST_TERMS", 2)
    robot = mo.load_robot("stanford")
    form = mo.robot.closed_form(robot)
    assert "\n    double h112 = " in form.text("c")
    q, qd = states(6)[0]
    expected = numbers(robot, q, qd)
    for text in (form.text("python"), from_matlab(form.text("matlab"))):
        for title, value in in_python(text, q, qd).items():
            np.testing.assert_allclose(value, expected[title], rtol=0, atol=1e-11)


def test_terms_are_those_of_the_textbook() -> None:
    """Craig, equation 3.14: the Puma's r11, here with the other signs of its packaged frames."""
    puma = mo.robot.closed_form(mo.load_robot("puma560"))
    assert len(puma.pose[0][0].terms) == 5
    stanford = mo.robot.closed_form(mo.load_robot("stanford"))
    assert str(stanford.pose[2][3]) == (
        "0.412 + q3 cos(q2) + 0.263 cos(q2) cos(q5) - 0.263 sin(q2) sin(q4) sin(q5)"
    )


@pytest.mark.parametrize("name", ["microbot", "stanford"])
def test_latex_can_be_read(name: str) -> None:
    text = mo.robot.closed_form(mo.load_robot(name)).text("latex")
    assert text.count("{") == text.count("}")
    assert text.count(r"\begin{") == text.count(r"\end{") == 5
    for block in re.findall(r"\\begin\{align\*\}.*?\\end\{align\*\}", text, re.DOTALL):
        assert "<math" in formulas.mathml(block, block=True)
    assert (r"d_3\,\cos \theta_2" in text) == (name == "stanford")


def test_a_robot_without_masses_has_a_pose(tmp_path: Path) -> None:
    robot = mo.Robot.from_dh(alpha=[0.0, 0.0], a=[0.0, 1.0], d=[0.0, 0.0], name="2 & R_x")
    form = mo.robot.closed_form(robot)
    assert (form.mass, form.christoffel, form.gravity) == ((), (), ())
    assert in_python(form.text("python"), np.zeros(2), np.zeros(2)).keys() == {"forward_kinematics"}
    assert r"2 \& R\_x" in form.text("latex")
    assert "function [T] = robot_2___R_x(q, qd)" in form.text("matlab")


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with refused("closed_form", "6 joints", "not 7"):
        mo.robot.closed_form(mo.load_robot("panda"))
    form = mo.robot.closed_form(mo.load_robot("planar_2r"))
    with refused("language", "latex, python, c", "'fortran'"):
        form.text("fortran")
    with refused("ending", ".tex, .py, .c, .m", "'.f90'"):
        form.export(tmp_path / "arm.f90")
