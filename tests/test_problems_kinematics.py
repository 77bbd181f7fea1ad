"""The problem scripts of parts 1 to 3, run as a reader runs them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from helpers import sampled_rows, tells

pytestmark = pytest.mark.slow

PROBLEMS = Path(__file__).parent.parent / "problems"
FORWARD, INVERSE, VELOCITY = (
    "01_forward_kinematics.py",
    "02_inverse_kinematics.py",
    "03_velocity_propagation.py",
)
MICROBOT = ["--alpha-deg", "0,90,0,0", "--a", "0,0,3,4", "--d", "2,0,0,0"]


def run(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(PROBLEMS / script), *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False, timeout=300
    )


def words(script: str, *arguments: str) -> str:
    """Output of a run that must succeed without a warning, blanks made single."""
    done = run(script, *arguments)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return " ".join(done.stdout.split())


def test_forward_kinematics_of_the_report() -> None:
    """Course report, part 1, recomputed: the tool at (3, -1, 4.5)."""
    text = words(FORWARD)
    assert "frame 4 in base [ 0.9443 -0.0916 0.3162 3.0000 ] [ -0.3148 0.0305 0.9487" in text
    assert "frame 3 in frame 2 [ -0.3646 -0.9312 0.0000 3.0000 ]" in text
    assert "tool: Px = 3.0000 Py = -1.0000 Pz = 4.5000 m" in text
    tells(text, "report: entry (2,2)", "frame 3 in base", "-0.0305")


def test_forward_kinematics_of_the_listing() -> None:
    """Course report, part 1, angles of its listing, recomputed."""
    text = words(FORWARD, *MICROBOT, "--theta-deg", "-86.41,22.886,-3.415,0")
    assert "Px = 0.4092 Py = -6.5223 Pz = 4.5000" in text
    assert "report:" not in text


def test_forward_kinematics_in_symbols() -> None:
    lengths = ["--alpha-deg", "0,90,0,0", "--a", "0,0,e,f", "--d", "h,0,0,0"]
    text = words(FORWARD, "--symbolic", *lengths, "--theta-deg", "x,x,x,0")
    assert "[ c1*c23 -c1*s23 s1 c1*(f*c23 + e*c2) ]" in text
    assert "f*s23 + e*s2 + h" in text
    assert "c1*(4*c23 + 3*c2)" in words(FORWARD, "--symbolic")


@pytest.mark.parametrize(("last_row", "code"), [("0 4 0 0", 0), ("0 4 0", 2)])
def test_rows_are_asked_for_on_a_terminal(last_row: str, code: int) -> None:
    pty = pytest.importorskip("pty")
    outer, inner = pty.openpty()
    rows = "0 0 2 161.5651\n90, 0, 0, 74.1561\n0 3 0 111.3819\n" + last_row + "\n\n"
    os.write(outer, rows.encode())
    command = [sys.executable, str(PROBLEMS / FORWARD)]
    done = subprocess.run(
        command, stdin=inner, capture_output=True, text=True, check=False, timeout=300
    )
    os.close(outer)
    os.close(inner)
    assert done.returncode == code
    assert "row 1: " in done.stdout
    if code == 0:
        assert "Px = 3.0000  Py = -1.0000  Pz = 4.5000" in done.stdout
    else:
        assert done.stderr == "error: row 4 must have 4 entries, not 3\n"


def test_four_branches_of_the_report() -> None:
    """Course report, part 2, recomputed."""
    text = words(INVERSE)
    assert "4 branches by Gauss-Newton, 4 by the NLP" in text
    places = [
        text.index(row)
        for row in (
            "-18.4349 105.8439 -111.3819",
            "-18.4349 -29.1863 111.3819",
            "161.5651 74.1561 111.3819",
            "161.5651 -150.8137 -111.3819",
        )
    ]
    assert places == sorted(places)  # the order of the report
    assert "[ 0.1288 -0.9399 -0.3162 3.0000 ]" in text  # solution 2


def test_position_out_of_reach_is_told() -> None:
    text = words(INVERSE, "--position", "-9,0,2")
    tells(text, "out of reach", "2 m")


def test_branch_nearest_to_a_seed() -> None:
    text = words(INVERSE, "--seed-deg", "-20,-30,100")
    assert "seed [deg] -18.4349 -29.1863 111.3819 solved" in text


@pytest.mark.thorough
def test_branches_where_they_are_a_continuum() -> None:
    text = words(INVERSE, "--position", "0,0,5")
    assert "2 branches by Gauss-Newton, " in text
    assert "continuum" in text


def test_velocities_of_the_report() -> None:
    """Course report, part 3, recomputed; the third entry of v3 is negative."""
    text = words(VELOCITY)
    assert "v3 = [L1*qd1*s2, L1*qd1*c2 + L2*qd1 + L2*qd2, 0]" in text
    assert "omega2 [ -0.2978 0.5333 0.3491 ] report [ -0.2978 0.5333 0.3491 ]" in text
    assert "v3 [ -0.9751 -0.3818 -1.6000 ] report [ -0.9751 -0.3818 1.6000 ] misprint" in text
    assert "v4 [ -0.9751 4.1561 0.2870 ] report [ -0.9751 4.1561 0.2870 ]" in text
    assert text.count("misprint") == 1
    assert "v = [ 3.1285 -1.3451 -2.5902 ] omega = [ -0.3587 -1.0763 0.6109 ]" in text
    assert "tool at [ -0.4458 0.1486 -2.0037 ] m" in text


def test_velocities_of_another_state_stand_alone() -> None:
    text = words(VELOCITY, "--theta-deg", "0,0,0", "--rate-deg", "0,0,57.29577951308232")
    assert "v = [ 0.0000 0.0000 4.0000 ]" in text
    assert "condition number inf" in text
    assert "by torque 40.000000 W" in text
    assert "report [" not in text


@pytest.mark.parametrize(
    ("script", "arguments", "said"),
    sampled_rows(
        [
            (FORWARD, ["--a", "1,2"], ("--alpha-deg, --a, --d", "--theta-deg")),
            (FORWARD, [*MICROBOT, "--theta-deg", "0,x,0,0"], ("theta_deg", "numbers", "'x'")),
            (FORWARD, [*MICROBOT, "--theta-deg", "0,0,0"], ("columns", "length")),
            (FORWARD, [*MICROBOT, "--theta-deg", "0,nan,0,0"], ("theta_deg", "finite", "nan")),
            (INVERSE, ["--position", "1,2"], ("position", "3 finite", "1,2")),
            (INVERSE, ["--position", "1,2,up"], ("position", "numbers", "'1,2,up'")),
            (INVERSE, ["--seed-deg", "1"], ("seed-deg", "3 finite", "not 1")),
            (INVERSE, ["--robot", "nowhere"], ("robot", "'nowhere'")),
            (VELOCITY, ["--theta-deg", "1,2"], ("theta_deg", "3 finite", "1,2")),
            (VELOCITY, ["--force", "0,0,inf"], ("force", "3 finite", "0,0,inf")),
        ],
        3,
    ),
)
def test_bad_input_is_one_line_and_exit_code_2(
    script: str, arguments: list[str], said: tuple[str, ...]
) -> None:
    done = run(script, *arguments)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    tells(done.stderr, *said)
    assert len(done.stderr.strip().split("\n")) == 1
    assert done.stdout == ""


@pytest.mark.parametrize("script", [FORWARD, INVERSE, VELOCITY])
def test_help_has_an_example(script: str) -> None:
    text = words(script, "--help")
    assert f"python problems/{script}" in text
