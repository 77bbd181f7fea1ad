"""What newcomers type: files of another kind, degrees for radians, words of other tools."""

from __future__ import annotations

import itertools
import subprocess
import sys
import warnings

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, tells, warned
from microbot_ocp._base.system import FORKS
from microbot_ocp.cli import main

TASK = 'schema = 1\nrobot = "planar_2r"\n'
FILES = {  # text, and what says what it is
    "study.toml": (f"{TASK}[cases]\nkind = 'grid'\n", "study: microbot-ocp sweep"),
    "cell.toml": (f"{TASK}cycle = true\n[[stop]]\nq = [0, 0]\n", "stops: microbot-ocp solve"),
    "task.toml": (f"{TASK}[via]\nq = [[0, 0], [1, 1]]\n", "via points: microbot-ocp solve"),
    "scene.toml": ("clearance = 0.0\n[[obstacle]]\nkind = 'sphere'\n", "scene: scene ="),
    "robot.toml": ("name = 'r'\n[[joint]]\nalpha = 0\n", "robot: microbot-ocp show"),
    "profile.toml": ("name = 'p'\ninterpolation = 'hold'\n", "controller: --profile"),
}
READERS = {  # a command that wants one kind of file in the place of {}
    "study.toml": "sweep {} --out s",
    "cell.toml": "check robot.toml --profile hold@100 --task {}",
    "scene.toml": "check t.csv --robot planar_2r --profile hold@100 --scene {}",
    "robot.toml": "show {}",
    "profile.toml": "check t.csv --robot planar_2r --profile {}",
    "motion": "replay {} --rerun a.rrd",
    "trajectory": "check {} --robot planar_2r --profile hold@100",
}


@pytest.fixture
def said(capsys, tmp_path, monkeypatch):
    """Run a command; return its exit code and what it says on standard error."""
    monkeypatch.chdir(tmp_path)
    for name, (text, _) in FILES.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "t.csv").write_text("0,0,0\n1,0.1,0.1\n")

    def run(*words: str) -> tuple[int, str]:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            code = main(words)
        return code, capsys.readouterr().err + "".join(str(each.message) for each in warned)

    return run


def test_a_file_of_another_kind_is_told_by_what_it_is(said):
    """An unknown key of it was named, with the keys of another kind that were allowed."""
    for wanted, given in itertools.product(READERS, FILES):
        if wanted == given or (wanted, given) == ("cell.toml", "task.toml"):
            continue
        code, line = said(*READERS[wanted].format(given).split())
        assert code == 2
        assert FILES[given][1] in line, (wanted, given, line)
        assert "unknown key" not in line
    for given in ("study.toml", "scene.toml", "robot.toml", "profile.toml"):
        code, line = said("solve", given)
        assert (code, FILES[given][1] in line) == (2, True), line
    assert "motion" in said("solve", "a.npz")[1]
    assert "unknown key 'cylce'" in _misspelt(said)


def _misspelt(said) -> str:
    with open("wrong.toml", "w") as stream:  # a kind of its own keeps its own message
        stream.write(FILES["cell.toml"][0].replace("cycle", "cylce"))
    return said("solve", "wrong.toml")[1]


@pytest.mark.parametrize(
    ("command", "parts"),
    [
        ("ik ur5e --position 0.4,0.1,0.4 --rpy 180,0,90", ["--rpy-deg", "180,0,90", "rad"]),
        ("ik ur5e --position 0.4,0.1,0.4 --rpy 0,22.5,0", ["--rpy-deg"]),
        ("compare planar_2r --via 0,0 --via 1,1 --time 1 --methods cubic", ["--time", "[2]"]),
        ("compare microbot --via 0,0,0 --via 1,1,1 --tau-max -400", ["--tau-max", "waist", "-400"]),
        ("compare microbot --via 0,0,0 --via 1,1,1 --qd-max 1,-2,1", ["--qd-max", "shoulder"]),
        ("time-optimal microbot --via 0,0,0 --via 1,1,1 --mesh 1", ["--mesh", "1"]),
        ("simulate microbot --q 0,1,1 --duration -1", ["--duration", "above 0 s", "-1.0"]),
        ("robots panda", ["show panda"]),
        ("show panda --xacro name:=a", [".xacro", "panda"]),
        ("show a.xacro --xacro name=a", ["--xacro", "NAME:=VALUE"]),
    ],
)
def test_options_are_named_with_what_helps(said, command, parts):
    code, line = said(*command.split())
    assert code == 2
    tells(line, *parts)


def test_joints_in_degrees_are_warned_of(said):
    for word in ("0,45,30", "0,45.5,30", "0,-90,0"):
        code, line = said("fk", "microbot", "--q", word)
        assert code == 0
        assert "--q-deg" in line
        assert word in line


def test_arguments_of_xacro(said, tmp_path):
    pytest.importorskip("xacro")
    (tmp_path / "a.xacro").write_text(
        '<robot name="$(arg name)" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="a"/>'
        '<link name="b"/><joint name="j" type="continuous"><parent link="a"/><child link="b"/>'
        '<axis xyz="0 0 1"/></joint></robot>'
    )
    assert "--xacro" in said("show", "a.xacro")[1]
    assert said("show", "a.xacro", "--xacro", "name:=mine", "--out", "mine.toml")[0] == 0
    assert mo.load_robot("mine.toml").name == "mine"


def test_the_package_is_the_program():
    """In a process of its own: the program takes the signals of the one that it runs in."""
    command = [sys.executable, "-m", "microbot_ocp", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("microbot-ocp ")


@pytest.mark.skipif(not FORKS, reason="no forks")
def test_the_thread_that_waits_for_signals_does_not_keep_solvers_from_forking():
    """Without a process of its own fatrop may go on for ever: no limit of time reaches it."""
    code = (
        "from microbot_ocp._base.child_process import can_fork\n"
        "from microbot_ocp.cli import _process\n_process.watch()\nassert can_fork()"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


ROBOT = mo.load_robot("microbot")
MOTION = mo.Motion.from_polynomial(ROBOT, mo.quintic([[0, 0, 0], [0.5, 0.5, 0.5]], [0.0, 5.0]))


@pytest.mark.parametrize(
    ("call", "kind", "ours"),
    [
        (lambda: mo.Limits(v_max=2), TypeError, "'qd_max'"),  # type: ignore[call-arg]
        (lambda: mo.Limits(jerk=2), TypeError, "'qddd_max'"),  # type: ignore[call-arg]
        (lambda: mo.Limits(effort=2), TypeError, "'tau_max'"),  # type: ignore[call-arg]
        (lambda: ROBOT.with_limits(velocity=2), mo.InputError, "'qd_max'"),  # type: ignore[call-arg]
        (lambda: mo.Stop(pos=[1, 2, 3]), TypeError, "'position'"),  # type: ignore[call-arg]
        (lambda: mo.Link(1.0, com=[0, 0, 0]), TypeError, "'center_of_mass'"),  # type: ignore[call-arg]
        (
            lambda: mo.time_optimal(ROBOT, [[0, 0, 0], [1, 1, 1]], max_velocity=1.0),
            TypeError,
            "with_limits(qd_max=...)",
        ),
        (lambda: ROBOT.fkine, AttributeError, "mo.forward_kinematics(robot)"),
        (lambda: ROBOT.tau_max, AttributeError, "robot.limits.tau_max"),
        (lambda: ROBOT.num_positions, AttributeError, "robot.joint_count"),
        (lambda: ROBOT.crba, AttributeError, "mo.mass_matrix(robot)"),
        (lambda: ROBOT.limits.vmax, AttributeError, "'qd_max'"),
        (lambda: MOTION.positions, AttributeError, "motion.q"),
        (lambda: mo.rnea, AttributeError, "mo.inverse_dynamics(robot)"),
    ],
)
def test_words_of_other_tools(call, kind, ours):
    with refused(ours, error=kind):
        call()


def test_angles_of_a_table_in_degrees_are_refused_with_their_conversion():
    for key, angles in (
        ("alpha", [0, 90, 0]),
        ("alpha", [0, 22.5, 0]),
        ("theta_offset", [0, 0, 45]),
    ):
        rows = {"alpha": [0, 0, 0], "a": [0, 1, 1], "d": [0, 0, 0], key: angles}
        with refused(key, "a turn", "in rad", "np.radians"):
            mo.Robot.from_dh(**rows)
    assert mo.Robot.from_dh([0, 2 * np.pi], [0, 1], [0, 0], convention="modified").joint_count == 2


@pytest.mark.parametrize("position", [[4000, 300, 300], [2.0e4, 0, 0], [0, -9000, 0]])
def test_a_stop_in_millimetres(position):
    robot = mo.load_robot("microbot")
    stops = [mo.Stop(q=[0, 0, 0]), mo.Stop(position=position)]
    with refused("'stop 2'", "out of reach", "millimetres"):
        mo.time_optimal(robot, stops)


def test_results_are_saved_into_folders(tmp_path):
    comparison = mo.compare(mo.load_robot("planar_2r"), [[0, 0], [1, 1]], ["cubic"])
    for name in ("x.pdf", "x.png", "x.npz"):
        with refused(f"{name}'", "a folder", "savefig"):
            comparison.save(tmp_path / name)
    assert comparison.save(tmp_path / "results.v2", outputs=["json"])


def test_a_polynomial_needs_no_label():
    assert MOTION.label == "motion"


def test_rotations_of_few_digits_are_made_exact_and_others_refused_by_their_distance():
    exact = mo.robot.rotation_of([0.3, 0.2, 0.1])
    robot = mo.load_robot("ur5e")
    for digits in (3, 4, 5):
        with warned("orientation", "nearest rotation"):
            stop = mo.Stop(position=[0.3, 0.3, 0.3], orientation=exact.round(digits))
        taken = np.array(stop.orientation)
        np.testing.assert_allclose(taken @ taken.T, np.eye(3), atol=1e-14)
        np.testing.assert_allclose(taken, exact, atol=10.0**-digits)
        with warned("orientation", "nearest rotation"):
            assert mo.solve_ik(robot, [0.3, 0.3, 0.3], exact.round(digits)).solved
    off = exact.round(1)
    for call in (
        lambda turn: mo.Stop(position=[0.3, 0.3, 0.3], orientation=turn),
        lambda turn: mo.solve_ik(robot, [0.3, 0.3, 0.3], turn),
        lambda turn: mo.Box([1, 1, 1], np.block([[turn, np.zeros((3, 1))], [0, 0, 0, 1]])),
    ):
        with refused("0.1 off", "mo.robot.nearest_rotation"):
            call(off)
        with refused("rotation", "mirrors"):
            call(-exact)
        call(mo.robot.nearest_rotation(off))
