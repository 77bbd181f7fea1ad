"""The command line: what each command prints, writes and returns."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

import make_commands
import microbot_ocp as mo
from helpers import sampled, tells, warned
from microbot_ocp.cli import (
    _doctor,
    _motions as motions,
    _process as process,
    _program as commands,
    _report as report,
    main,
)
from microbot_ocp.ocp.solvers import _ldl
from microbot_ocp.views.live import spoken_progress

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = [
    "demo",
    "robots",
    "show",
    "limits",
    "fk",
    "ik",
    "simulate",
    "compare",
    "time-optimal",
    "solve",
    "design",
    "check",
    "studio",
    "sweep",
    "replay",
    "export",
    "doctor",
]
VIA_DEG = "0,0,0 -8,45,30 -90,90,90"
SHORT = ("planar_2r", "--via-deg", "0, 0", "--via-deg", "2,3")  # films of few pictures
TASK = """
schema = 1
robot = "microbot"
methods = ["cubic", "lspb"]
outputs = ["json", "motions"]
[via]
q_deg = [[0, 0, 0], [-90, 90, 90]]
"""


@pytest.fixture(autouse=True)
def _quiet_folder(tmp_path, monkeypatch):
    """Every test runs in an empty folder, at 80 columns, without colours asked for."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    monkeypatch.setattr(spoken_progress, "__defaults__", (np.inf,))  # however slow the machine is


@pytest.fixture
def call(capfd):
    def run(*arguments):
        code = main(arguments)
        out, err = capfd.readouterr()
        return code, out, err

    return run


@pytest.fixture
def ask(call):
    """Run a command with --json: its code and document."""

    def run(*arguments):
        code, out, err = call(*arguments, "--json")
        assert err == ""
        return code, json.loads(out, parse_constant=lambda word: pytest.fail(word))

    return run


@pytest.fixture
def refused(call):
    """Run a command that must refuse its input: the one line that it says."""

    def run(*arguments):
        code, out, err = call(*arguments)
        assert code == 2
        assert out == ""
        (line,) = err.splitlines()
        assert line.startswith("error: ")
        return line

    return run


# --- the program -------------------------------------------------------------------------------


def test_help_lists_every_command(call):
    code, out, _ = call("--help")
    assert code == 0
    for name in COMMANDS:
        assert f"\n  {name} " in out
    assert "..." not in out.split("Commands:")[1]
    assert call()[:2] == (0, out)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_has_an_example_that_names_real_options(call, command):
    code, out, _ = call(command, "--help")
    assert code == 0
    head, example = out.split("Example:")
    assert f"microbot-ocp {command}" in example
    for word in example.split():
        if word.startswith("--"):
            assert f"{word} " in head
    assert "--json" in head
    assert max(map(len, out.splitlines())) <= 80


def test_the_version(call):
    code, out, _ = call("--version")
    assert (code, out) == (0, f"microbot-ocp {metadata.version('microbot_ocp')}\n")


@pytest.mark.parametrize(
    ("words", "offered", "kept_back"),
    [
        ("ti", {"time-optimal"}, {"robots"}),
        ("show p", {"panda", "puma560"}, {"microbot"}),
        ("show panda --", {"--tip", "--toml", "--json"}, {"--install-completion"}),
        ("compare microbot --qd", {"--qd-max", "--qdd-max"}, {"--q-max"}),
        ("compare microbot --methods cubic,l", {"cubic,lspb"}, {"lspb"}),
        ("replay best.npz --robot s", {"stanford"}, {"panda"}),
    ],
)
def test_completion(call, monkeypatch, words, offered, kept_back):
    monkeypatch.setenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1")
    monkeypatch.setenv("_MICROBOT_OCP_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", f"microbot-ocp {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    code, out, _ = call()
    assert code == 0
    assert offered <= set(out.split())
    assert not kept_back & set(out.split())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nope"], ["nope", "robots, show"]),
        (["simulat"], ["did you mean 'simulate'?"]),
        (["--bogus"], ["--bogus"]),
        (["show"], ["ROBOT"]),
        (["show", "robbie"], ["robbie", "microbot", "panda"]),
        (["show", "none.toml"], ["none.toml", "cannot be read"]),
        (["show", "microbot", "--rerun", "x.txt"], [".rrd", "x.txt"]),
        (["show", "microbot", "--rerun", "none/x.rrd"], ["none/x.rrd", "folder"]),
        (["fk", "microbot"], ["--q-deg"]),
        (["fk", "microbot", "--q", "1,2"], ["--q", "waist, shoulder, elbow", "not 2"]),
        (["fk", "microbot", "--q", "1,2,x"], ["--q", "1,2,x"]),
        (["fk", "microbot", "--q", "1,2,nan"], ["--q", "finite"]),
        (["fk", "microbot", "--q", "1,2,3", "--q-deg", "1,2,3"], ["not both"]),
        (["fk", "microbot", "--q", "1,2,3", "--frame", "4"], ["--frame", "1 to 3", "4"]),
        (["fk", "microbot", "--q", "1,2,3", "--frame", "x"], ["--frame", "whole number", "'x'"]),
        (["fk", "microbot", "--q", "1", "2", "3"], ["commas: 3,-1,4.5"]),
        (["ik", "microbot"], ["--position"]),
        (["ik", "microbot", "--position", "3", "-1", "4.5"], ["commas: 3,-1,4.5"]),
        (["ik", "microbot", "--position", "1,2"], ["x, y, z", "1,2"]),
        (["ik", "microbot", "--position", "1,2,3", "--seed", ""], ["--seed", "not ''"]),
        (["ik", "microbot", "--position", "1,2,3", "--time-limit", "0"], ["above 0 s", "'0'"]),
        (["ik", "microbot", "--position", "1,2,3", "--rpy", "1"], ["roll, pitch, yaw"]),
        (["export", "a.npz", "a.gif", "--profile", "hold@50"], ["--profile", "films", ".gif"]),
        (["check", "a.csv", "--robot", "microbot", "--profile", "hold@50"], ["a.csv", "cannot be"]),
        (["simulate", "microbot"], ["--q-deg"]),
        (["simulate", "microbot", "--q", "0,0,0", "--duration", "-1"], ["--duration", "-1"]),
        (["simulate", "microbot", "--q", "0,0,0", "--step", "x"], ["--step", "number", "'x'"]),
        (["simulate", "microbot", "--motion", "none.npz"], ["none.npz"]),
        (["simulate", "microbot", "--q-deg", "0,90,0"], ["singular", "armature"]),
        (["compare", "microbot"], ["--via-deg"]),
        (["compare", "microbot", "--via", "0,0,0"], ["at least 2 points", "not 1"]),
        (["compare", "microbot", "--via", "0,0,0 0,0,0"], ["the same"]),
        (["compare", "microbot", "--via", "0,0,0 1,1,1", "--methods", "a"], ["cubic", "'a'"]),
        (["compare", "microbot", "--via", "0,0,0 1,1,1", "--tau-max", "1,2"], ["--tau-max"]),
        (["compare", "microbot", "--via", "0,0,0 1,1,1", "--tau-max", "-1"], ["--tau-max", "-1"]),
        (["compare", "microbot", "--via", "0,0,0 1,1,1", "--mesh", "2"], ["mesh", "4", "2"]),
        (["time-optimal", "microbot", "--via", "0,0,0 1,1,1", "--out", "x.txt"], [".npz"]),
        (["time-optimal", "microbot", "--via", "0,0,0 9,9,9"], ["position limits", "515.6"]),
        (["solve", "none.toml"], ["none.toml", "No such file"]),
        (["replay", "none.npz", "--rerun", "x.rrd"], ["none.npz"]),
        (["replay", ".", "--rerun", "x.rrd"], ["comparison.json"]),
        (["replay", "x.npz"], ["--rerun", "--open"]),
        (["replay", "x.rrd", "--rerun", "y.rrd"], ["already", "replay x.rrd --open"]),
    ],
)
def test_bad_input_is_one_line(refused, tmp_path, arguments, words):
    line = refused(*arguments)
    for word in words:
        assert word in line
    assert list(tmp_path.iterdir()) == []


def test_angles_that_look_like_degrees_are_warned_of_or_refused(call, refused):
    with warned("--q is", "'0,90,0' rad", "--q-deg"):
        call("fk", "microbot", "--q", "0,90,0")
    line = refused("ik", "microbot", "--position", "3,-1,4", "--rpy", "0,90,0")
    tells(line, "--rpy", "turn", "--rpy-deg")


def test_a_limit_given_in_both_units(refused):
    line = refused(
        "compare", "microbot", "--via", "0,0,0 1,1,1", "--qd-max", "1", "--qd-max-deg", "9"
    )
    assert "--qd-max or --qd-max-deg" in line


def test_open_without_a_screen(refused, monkeypatch):
    monkeypatch.setattr(report, "has_display", lambda: False)
    assert "screen" in refused("show", "microbot", "--open")


def test_the_viewer_listens_on_loopback_only(call, monkeypatch, tmp_path):
    seen = []

    def run(command):
        seen.append((command, Path(command[-1]).stat().st_size))
        return 0

    monkeypatch.setattr(report, "has_display", lambda: True)
    monkeypatch.setattr("microbot_ocp.views.live.find_viewer", lambda: "rerun")
    monkeypatch.setattr("microbot_ocp.views.live.wait_for_viewer", run)
    code, _, _ = call("show", "planar_2r", "--open")
    ((command, size),) = seen
    assert code == 0
    assert command[:3] == ["rerun", "--bind", "127.0.0.1"]
    assert size > 10_000
    assert not Path(command[-1]).exists()  # it was for the viewer only
    assert list(tmp_path.iterdir()) == []
    assert call("show", "planar_2r", "--rerun", "kept.rrd")[0] == 0
    assert call("replay", "kept.rrd", "--open")[0] == 0
    assert seen[1][0][-1] == "kept.rrd"


# --- robots and poses --------------------------------------------------------------------------


def test_robots(call, ask):
    code, out, _ = call("robots")
    assert code == 0
    assert all(name in out for name in mo.packaged_robots())
    _, document = ask("robots")
    assert [robot["name"] for robot in document["robots"]] == list(mo.packaged_robots())


@pytest.mark.slow
@pytest.mark.parametrize("name", sampled(mo.packaged_robots(), 3))
def test_show_fits_80_columns_and_tells_everything(call, ask, name):
    code, out, _ = call("show", name)
    assert code == 0
    assert max(map(len, out.splitlines())) <= 80
    robot = mo.load_robot(name)
    for joint in robot.joint_names:
        assert sum(line.startswith(joint) for line in out.splitlines()) >= 3
    code, document = ask("show", name)
    assert code == 0
    assert [joint["name"] for joint in document["joints"]] == list(robot.joint_names)
    reach = document["workspace"]
    if reach["reach_bound"] is not None:
        assert 0 < reach["reach_found"] <= reach["reach_bound"]


@pytest.mark.slow
@pytest.mark.parametrize("name", sampled(mo.packaged_robots(), 3))
def test_a_packaged_robot_is_a_start_for_a_robot_file(call, tmp_path, name):
    code, out, err = call("show", name, "--toml")
    assert (code, err) == (0, "")
    (tmp_path / "arm.toml").write_text(out)
    assert mo.load_robot(tmp_path / "arm.toml") == mo.load_robot(name)
    assert "[sources]" in out


@pytest.mark.slow
def test_a_robot_is_copied_from_one_format_to_the_other(call, ask, refused, tmp_path):
    assert ask("show", "panda", "--out", "arm.urdf")[1]["written"] == ["arm.urdf"]
    assert ask("show", "stanford", "--out", "arm.c")[1]["written"] == ["arm.c"]
    code, out, _ = call("show", "arm.urdf", "--out", "arm.toml")
    assert code == 0
    assert out.endswith("written: arm.toml\n")
    assert mo.load_robot(tmp_path / "arm.toml") == mo.load_robot(tmp_path / "arm.urdf")
    assert call("show", "arm.urdf", "--toml")[1] == (tmp_path / "arm.toml").read_text()
    (tmp_path / "arm.toml").write_text('name = "broken"')
    for arguments, words in [
        (["microbot", "--toml", "--json"], "not both"),
        (["microbot", "--out", "arm.yaml"], ".toml or .urdf"),
        (["arm.toml", "--out", "copy.toml"], "[[joint]]"),
    ]:
        assert words in refused("show", *arguments)
    assert {path.name for path in tmp_path.iterdir()} == {"arm.toml", "arm.urdf", "arm.c"}


def test_a_robot_without_masses_or_limits(call, tmp_path):
    robot = mo.Robot.from_dh(
        alpha=[0, 0], a=[0, 1], d=[0, 0], joint_type=["revolute", "prismatic"], name="bare"
    )
    mo.save_robot(robot, tmp_path / "bare.toml")
    code, out, _ = call("show", "bare.toml", "--rerun", "bare.rrd")
    assert code == 0
    assert "kinematics only" in out
    assert "Limits: none" in out
    assert out.endswith("written: bare.rrd\n")
    assert (tmp_path / "bare.rrd").stat().st_size > 1000
    code, out, err = call("simulate", "bare.toml", "--q", "0,0")
    assert (code, out) == (2, "")
    assert "no masses" in err


def test_fk_in_both_units(ask):
    _, degrees = ask("fk", "microbot", "--q-deg", "0,45,-30")
    _, radians = ask("fk", "microbot", "--q", f"0,{np.pi / 4},{-np.pi / 6}")
    robot = mo.load_robot("microbot")
    pose = np.array(mo.forward_kinematics(robot)(np.radians([0, 45, -30])))
    np.testing.assert_allclose(degrees["position"], pose[:3, 3], atol=1e-12)
    np.testing.assert_allclose(degrees["rotation"], pose[:3, :3], atol=1e-12)
    np.testing.assert_allclose(radians["position"], degrees["position"], atol=1e-12)


def test_fk_of_a_prismatic_joint_takes_metres(ask):
    code, document = ask("fk", "stanford", "--q-deg", "0,90,0.5,0,0,0")
    assert code == 0
    np.testing.assert_allclose(document["q"], [0, np.pi / 2, 0.5, 0, 0, 0])


def test_fk_outside_the_limits_says_so(call):
    code, out, _ = call("fk", "microbot", "--q-deg", "0,0,-400")
    assert code == 0
    assert "elbow at -400 deg, allowed ±360 deg" in out


def test_ik_returns_what_fk_gives(ask):
    code, found = ask("ik", "microbot", "--position", "3,-1,4.5")
    assert code == 0
    assert len(found["solutions"]) == 4
    for solution in found["solutions"]:
        joints = ",".join(map(str, solution["q_deg"]))
        _, pose = ask("fk", "microbot", "--q-deg", joints)
        np.testing.assert_allclose(pose["position"], [3, -1, 4.5], atol=1e-6)


def test_ik_takes_the_orientation_that_fk_tells(ask):
    _, pose = ask("fk", "ur5e", "--q-deg", "10,-70,80,-40,30,20")
    position, angles = (",".join(map(str, pose[key])) for key in ("position", "rpy_deg"))
    code, found = ask(
        "ik",
        "ur5e",
        "--position",
        position,
        "--rpy-deg",
        angles,
        "--seed-deg",
        "9,-69,81,-41,31,19",
    )
    assert code == 0
    np.testing.assert_allclose(
        found["solutions"][0]["q_deg"], [10, -70, 80, -40, 30, 20], atol=1e-4
    )


def test_a_target_out_of_reach_is_not_solved(call, ask):
    code, out, err = call("ik", "microbot", "--position", "9,9,9")
    assert code == 1
    assert err == ""
    assert "out of reach" in out
    assert "nearest pose" in out
    assert ask("ik", "microbot", "--position", "9,9,9")[1]["solved"] is False


def test_ik_records_every_branch(call, tmp_path):
    path = tmp_path / "branches.rrd"
    code, out, err = call("ik", "microbot", "--position", "3,-1,4.5", "--rerun", str(path))
    assert (code, err) == (0, "")
    assert out.endswith(f"written: {path}\n")
    chunks = RrdReader(path).stream().to_chunks()
    arms = {chunk.entity_path.split("/")[2] for chunk in chunks if "/link_3" in chunk.entity_path}
    assert arms == {"branch_1", "branch_2", "branch_3", "branch_4", "solution"}
    assert call("ik", "microbot", "--position", "3,-1,4.5", "--rerun", "branches.png")[0] == 2


# --- motions -----------------------------------------------------------------------------------


def test_simulate_saves_what_replay_reads(call, ask, tmp_path):
    arguments = ("simulate", "microbot", "--q-deg", "0,30,20", "--duration", "0.3")
    code, document = ask(*arguments, "--step", "0.01", "--out", "fall.npz")
    assert code == 0
    assert document["status"] == "solved"
    motion = mo.Motion.load(tmp_path / "fall.npz")
    assert motion.duration == pytest.approx(0.3)
    np.testing.assert_allclose(motion.q[-1], document["q_end"])
    code, out, _ = call("replay", "fall.npz", "--rerun", "fall.rrd")
    assert code == 0
    assert "free fall: 0.300 s" in out
    assert (tmp_path / "fall.rrd").stat().st_size > 10_000
    code, again = ask("simulate", "microbot", "--motion", "fall.npz")
    assert code == 0
    np.testing.assert_allclose(again["q_end"], document["q_end"], atol=1e-6)
    _, out, _ = call(*arguments, "--tau", "0,0,0")
    assert "constant torques" in out
    assert call(*arguments[:-1], "1e-9")[0] == 0
    code, _, err = call("replay", "fall.npz", "--robot", "panda", "--rerun", "x.rrd")
    assert code == 2
    assert "3 joints" in err


def test_a_motion_that_does_not_know_its_robot(refused, call, tmp_path):
    call("simulate", "planar_2r", "--q", "0,0", "--duration", "0.1", "--out", "fall.npz")
    motion = mo.Motion.load(tmp_path / "fall.npz")
    mo.Motion(**{**vars(motion), "provenance": {}}).save(tmp_path / "plain.npz")
    assert "--robot" in refused("replay", "plain.npz", "--rerun", "x.rrd")
    mo.Motion(**{**vars(motion), "provenance": {"robot": "arm"}}).save(tmp_path / "own.npz")
    assert "'arm'" in refused("replay", "own.npz", "--rerun", "x.rrd")
    code, _, _ = call("replay", "own.npz", "--robot", "planar_2r", "--rerun", "x.rrd")
    assert code == 0


def test_compare_writes_nothing_unless_it_is_asked(call, tmp_path):
    code, out, err = call("compare", *SHORT, "--methods", "cubic,lspb", "--qd-max", "1")
    assert (code, err) == (0, "")
    assert list(tmp_path.iterdir()) == []
    assert "\x1b" not in out
    assert max(map(len, out.splitlines())) <= 80
    assert any(
        line.startswith("cubic, best times and velocities") and line.split()[-1] == "ok"
        for line in out.splitlines()
    )


@pytest.mark.slow
def test_compare_records_and_says_so(call, tmp_path):
    arguments = ("compare", *SHORT, "--methods", "cubic,lspb")
    code, out, err = call(*arguments, "--rerun", "both.rrd")
    assert (code, err) == (0, "")
    assert out.endswith("written: both.rrd\n")
    chunks = RrdReader(tmp_path / "both.rrd").stream().to_chunks()
    arms = {c.entity_path.split("/")[2] for c in chunks if "/link_2" in c.entity_path}
    assert arms == {"cubic", "lspb"}


@pytest.mark.thorough
def test_compare_saves_every_file(call, tmp_path):
    arguments = ("compare", *SHORT, "--methods", "cubic,lspb")
    code, out, _ = call(*arguments, "--out", "out", "--rerun", "both.rrd")
    assert code == 0
    assert out.splitlines()[-2:] == ["written: 11 files in out", "written: both.rrd"]
    assert (tmp_path / "out" / "comparison.pdf").exists()


@pytest.mark.thorough
@pytest.mark.slow
def test_compare_does_not_break_the_names_of_joints(call):
    via = "0,-30,0,-120,0,90,45 60,40,30,-60,40,130,0"
    arguments = ("compare", "panda", "--via-deg", via, "--methods", "cubic")
    code, out, _ = call(*arguments, "--taud-max", "inf")
    assert code == 0
    assert max(map(len, out.splitlines())) <= 80
    assert "(panda" not in out.split("Peaks:")[0]
    assert out.count("panda_j") == out.count("panda_joint2")


def test_ik_does_not_break_the_names_of_joints(call, tmp_path):
    text = call("show", "microbot", "--toml")[1]
    (tmp_path / "long.toml").write_text(text.replace('"elbow"', f'"{"elbow_" * 8}"'))
    code, out, _ = call("ik", "long.toml", "--position", "3,-1,4.5")
    assert code == 0
    assert "q1       q2       q3" in out
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.slow
def test_compare_saves_what_replay_reads(ask, call, refused, tmp_path, monkeypatch):
    assert motions.OUTPUTS == mo.tasks.OUTPUTS  # all, but figures and films are dear
    monkeypatch.setattr(motions, "OUTPUTS", ("csv", "json", "motions"))
    arguments = ("compare", *SHORT, "--methods", "cubic,lspb", "--tau-max", "60,30")
    code, document = ask(*arguments, "--out", "out")
    assert code == 0
    assert document["limits"]["tau_max"] == [60, 30]
    assert {Path(path).parts[0] for path in document["written"]} == {"out"}
    assert (tmp_path / "out" / "comparison.csv").exists()
    code, out, _ = call(*arguments, "--out", "out", "--rerun", "both.rrd")
    assert out.splitlines()[-2:] == ["written: 4 files in out", "written: both.rrd"]
    code, replayed = ask("replay", "out", "--rerun", "again.rrd")
    assert code == 0
    assert set(replayed["motions"]) == {"cubic", "lspb"}
    loaded = mo.load_comparison(tmp_path / "out", None)
    assert loaded.limits.tau_max.tolist() == [60, 30]
    assert np.isinf(loaded.limits.qdd_max).all()
    assert all(certificate.ok for certificate in loaded.certificates.values())
    assert ask("replay", "out/comparison.json", "--rerun", "b.rrd")[0] == 0
    assert ask("replay", "out/motions/cubic.npz", "--rerun", "c.rrd")[0] == 0
    (tmp_path / "out" / "comparison.json").write_text("[]")
    tells(refused("replay", "out", "--rerun", "x.rrd"), "comparison.json", "not a saved")


def test_a_method_that_cannot_do_the_task_is_exit_code_1(call, monkeypatch):
    import microbot_ocp.tasks._methods as methods

    def fail(_):
        raise mo.InputError("of no use")

    method = methods.Method("LSPB, best times and velocities", fail)
    monkeypatch.setitem(methods.METHODS, "lspb", method)
    code, out, err = call("compare", *SHORT, "--methods", "cubic,lspb")
    assert (code, err) == (1, "")
    tells(out, "of no use", methods.METHODS["cubic"].title)


@pytest.mark.slow
def test_time_optimal(ask, call, tmp_path):
    arguments = ("time-optimal", "microbot", "--via-deg", VIA_DEG, "--mesh", "20", "--starts", "1")
    code, document = ask(*arguments, "--out", "best.npz", "--rerun", "best.rrd")
    assert code == 0
    assert document["solved"] is True
    assert document["duration"] == pytest.approx(1.93, abs=0.02)
    assert document["certificate"]["ok"] is True
    assert mo.Motion.load(tmp_path / "best.npz").provenance["robot"] == "microbot"
    assert (tmp_path / "best.rrd").exists()
    code, out, _ = call(*arguments)
    assert code == 0
    assert "Certificate: ok" in out
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.slow
def test_a_solver_that_does_not_converge_is_exit_code_1(call, monkeypatch):
    from dataclasses import replace

    from microbot_ocp._base.outcome import Outcome
    from microbot_ocp.cli import _motions as tasks

    found = tasks.find_time_optimal

    def stopped(*arguments, **options):
        motion = found(*arguments, **options)
        return replace(motion, outcome=Outcome.of(mo.Status.ITERATION_LIMIT, "finer mesh"))

    monkeypatch.setattr(tasks, "find_time_optimal", stopped)
    code, out, _ = call("time-optimal", *SHORT, "--mesh", "10", "--starts", "1")
    assert code == 1
    tells(out, str(mo.Status.ITERATION_LIMIT), "Advice: finer mesh")


def test_solve_writes_the_outputs_of_the_file(ask, call, tmp_path):
    (tmp_path / "task.toml").write_text(TASK)
    code, document = ask("solve", "task.toml", "--out", "out")
    assert code == 0
    assert [entry["name"] for entry in document["entries"]] == ["cubic", "lspb"]
    names = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()}
    motions = {f"out/motions/{name}.npz" for name in ("cubic", "lspb")}
    assert names == {"task.toml", "out/comparison.json", *motions}
    assert set(document["written"]) == names - {"task.toml"}
    (tmp_path / "task.toml").write_text(TASK.replace('"json", "motions"', '"csv", "recording"'))
    assert ask("solve", "task.toml", "--out", "two")[0] == 0
    assert {p.name for p in (tmp_path / "two").iterdir()} == {"comparison.csv", "comparison.rrd"}


def test_solve_tells_the_key_that_is_wrong(refused, tmp_path):
    (tmp_path / "task.toml").write_text(TASK.replace("methods", "method"))
    tells(refused("solve", "task.toml"), "task.toml", "'method'", "methods")


def test_out_that_is_a_file(refused, tmp_path):
    (tmp_path / "task.toml").write_text(TASK)
    tells(refused("solve", "task.toml", "--out", "task.toml"), "task.toml", "a folder")
    (tmp_path / "link").symlink_to("nowhere")
    assert "'link'" in refused("solve", "task.toml", "--out", "link")
    tells(refused("solve", "task.toml", "--out", ""), "'--out'", "path")


def test_doctor(call, ask, monkeypatch):
    code, out, _ = call("doctor")
    assert code == 0
    for word in ("casadi", "ipopt", "fatrop", "compiler", "viewer"):
        assert word in out
    code, document = ask("doctor")
    assert code == 0
    assert document["healthy"] is True
    import casadi as ca

    monkeypatch.setattr(ca, "has_nlpsol", lambda name: name != "ipopt")
    code, out, _ = call("doctor")
    assert code == 1
    assert "MISSING" in out


def test_doctor_names_a_missing_linear_solver_and_what_takes_its_place(ask, monkeypatch):
    def without_amd():
        raise AttributeError("amd_l_order")

    monkeypatch.setattr(_ldl, "_known", {})
    monkeypatch.setattr(_ldl, "_amd_ordering", without_amd)
    with warned("MUMPS", "ldl", "amd_l_order"):
        code, document = ask("doctor")
    found = {finding["name"]: finding for finding in document["findings"]}
    assert code == 0
    assert not found["ldl"]["ok"]
    assert "MUMPS" in found["ldl"]["found"]
    assert found["band"]["ok"]


def test_the_demo_opens_its_report_where_there_is_somebody_to_see_it(call, tmp_path, monkeypatch):
    assert call("demo", "--mesh", "2")[0] == 2
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("microbot_ocp.cli._motions.has_display", lambda: True)
    monkeypatch.setattr(mo.Comparison, "save", lambda *_, **__: [])
    comparison = mo.compare(mo.load_robot("planar_2r"), [[0, 0], [1, 1]], ["cubic"])
    monkeypatch.setattr("microbot_ocp.tasks._task_file.TaskFile.compare", lambda *_: comparison)
    assert call("demo")[0] == 0
    assert opened == []
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert call("demo", "--out", "again")[0] == 0
    assert opened == [(tmp_path / "again" / "report.html").as_uri()]


def test_a_check_writes_its_report(call, tmp_path):
    arm = mo.load_robot("planar_2r")
    slow = mo.quintic([[0.0, 0.0], [0.5, 0.3]], [0.0, 2.0])
    motion = mo.Motion.from_polynomial(arm, slow, label="slow")
    motion.export("slow.csv", rate=250.0, robot=arm)
    command = ("check", "slow.csv", "--robot", "planar_2r", "--profile", "ros2_jtc_cubic@250")
    code, out, _ = call(*command, "--out", "slow.html")
    assert code == 0
    assert "written: slow.html" in out
    page = (tmp_path / "slow.html").read_text("utf-8")
    tells(page, "every limit")
    assert page.count("<img") == 2
    assert "http" not in page
    assert call(*command, "--out", "slow.pdf")[0] == 2


FOR_DEVELOPERS = {"test", "docs", "fuzz", "release", "bench"}


def test_doctor_names_every_extra_and_how_to_get_it(call, monkeypatch):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert set(_doctor.EXTRAS) == set(project["optional-dependencies"]) - FOR_DEVELOPERS
    monkeypatch.setenv("COLUMNS", "200")
    version = _doctor._version
    monkeypatch.setattr(_doctor, "_version", lambda name: "" if name == "coal" else version(name))
    code, out, _ = call("doctor")
    assert code == 0
    assert "pip install 'microbot_ocp[cell]' for obstacles" in out


def test_an_interrupt_that_a_solver_swallowed(call, monkeypatch):
    monkeypatch.setattr(process, "pressed", lambda: True)
    code, out, err = call("robots")
    assert (code, out, err) == (130, "", "")


def test_a_full_disk_is_one_line(refused, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("microbot_ocp.cli._robots.load_robot", full)
    tells(refused("robots"), "no space")


# --- as a process ------------------------------------------------------------------------------


@pytest.fixture
def program(tmp_path):
    """Run the program in an empty folder with an empty home."""
    home, folder, cache = (tmp_path / name for name in ("home", "work", "cache"))
    for each in (home, folder, cache):
        each.mkdir()
    environment = {
        "PATH": os.environ["PATH"],
        "HOME": str(home),
        "PYTHONPATH": os.pathsep.join(sys.path),
        "MICROBOT_OCP_CACHE": str(cache),
    }

    def run(*arguments, shell="", **more):
        command = [sys.executable, "-m", "microbot_ocp.cli", *arguments]
        if shell:
            command = ["bash", "-c", f'"$@" {shell}', "bash", *command]
        return subprocess.run(
            command,
            capture_output=True,
            text=True,
            cwd=folder,
            env={**environment, **more},
            timeout=120,
        )

    yield run
    assert list(folder.iterdir()) == []
    assert list(home.iterdir()) == []


@pytest.mark.slow
def test_a_pipe_has_no_codes_and_a_reader_may_leave(program):
    done = program("robots")
    assert done.returncode == 0
    assert "\x1b" not in done.stdout
    assert done.stderr == ""
    cut = program("show", "panda", "--json", shell="| head -1; exit ${PIPESTATUS[0]}")
    assert cut.stdout == "{\n"
    assert cut.stderr == ""


def test_a_refusal_in_a_process(program):
    done = program("fk", "robbie", "--q", "0")
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.skipif(os.name != "posix", reason="closes streams as a shell does")
@pytest.mark.parametrize(
    ("shell", "reason"),
    [
        pytest.param(">&-", "file descriptor", marks=pytest.mark.thorough),
        (">/dev/full", "no space"),
    ],
)
def test_an_output_that_is_closed_or_full(program, shell, reason):
    if shell.endswith("full") and not Path("/dev/full").exists():
        pytest.skip("needs /dev/full")
    done = program("--version", shell=f"{shell} <&-")
    assert (done.returncode, done.stdout) == (1, "")
    assert len(done.stderr.splitlines()) == 1
    tells(done.stderr, "error: ", "standard output", reason)
    assert program("fk", shell=f"2{shell}").returncode == 2


@pytest.mark.thorough
@pytest.mark.slow
def test_a_stream_that_knows_ascii_only(program):
    done = program("show", "planar_2r", "--json", PYTHONIOENCODING="ascii")
    assert done.returncode == 0
    assert json.loads(done.stdout)["name"] == "planar_2r"
    assert program("show", "planar_2r", PYTHONIOENCODING="ascii").returncode == 0


@pytest.mark.thorough
@pytest.mark.slow
def test_a_solve_writes_into_the_cache_only(program):
    done = program("compare", *SHORT, "--methods", "cubic")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("script") is None, reason="script makes the terminal")
@pytest.mark.parametrize("no_color", [False, True])
def test_a_terminal_has_colours_unless_no_color_is_set(tmp_path, no_color):
    environment = {**os.environ, "TERM": "xterm-256color"}
    environment |= {"NO_COLOR": "1"} if no_color else {}
    command = f"{sys.executable} -m microbot_ocp.cli robots"
    done = subprocess.run(
        ["script", "-qec", command, "/dev/null"],
        capture_output=True,
        text=True,
        env=environment,
        cwd=tmp_path,
        timeout=60,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0
    assert ("\x1b[" in done.stdout) != no_color


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize(
    ("number", "expected"),
    [("SIGINT", 130), ("SIGTERM", 143), pytest.param("SIGHUP", 129, marks=pytest.mark.thorough)],
)
def test_a_signal_ends_a_solve_within_a_second(tmp_path, number, expected):
    if signal.getsignal(getattr(signal, number)) is signal.SIG_IGN:
        pytest.skip(f"{number} is ignored here, as below nohup, and by what is started")
    code = (
        "import sys\nfrom microbot_ocp.cli import entry, _process as process\n"
        "watch = process.watch\n"
        "def told():\n    watch()\n    print('ready', file=sys.stderr, flush=True)\n"
        "process.watch = told\nsys.exit(entry())"
    )
    arguments = ["compare", "microbot", "--via-deg", VIA_DEG, "--mesh", "400", "--out", "out"]
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )
    assert process.stderr is not None
    assert process.stderr.readline() == "ready\n"
    time.sleep(np.random.default_rng().uniform(0.0, 2.5))  # imports, or a solver
    begin = time.monotonic()
    process.send_signal(getattr(signal, number))
    out, err = process.communicate(timeout=60)
    assert process.returncode == expected
    assert time.monotonic() - begin < 3.0  # 0.7 s, and what else the machine does
    assert (out, err) == ("", "")
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "unloaded"),
    [
        ("--help", {"rich", "casadi"}),
        ("robots", {"casadi"}),
        ("fk planar_2r --q 0,1", {"microbot_ocp.planning", "microbot_ocp.ocp"}),
    ],
)
def test_what_is_not_needed_is_not_loaded(words, unloaded):
    code = (
        f"import sys\nfrom microbot_ocp.cli import main\nmain({words.split()!r})\n"
        f"heavy = {unloaded | {'matplotlib', 'rerun', 'trimesh', 'xacro'}!r}\n"
        "sys.exit(bool(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_list_of_commands_says_what_each_says_of_itself():
    for name in commands.COMMANDS:
        command = commands.ProgramCommand(name)
        assert command.get_short_help_str() == command.loaded.get_short_help_str()
        assert command.loaded.name == name


def test_the_page_of_the_command_line_is_as_the_program_declares():
    page = make_commands.PAGE.read_text("utf-8")
    assert make_commands.updated(page) == page, "run docs/make_commands.py"
    for command in make_commands.declared().values():
        for option in (option for kind in command.kinds.values() for option in kind.options()):
            assert option.default.help, f"{option.name} has no help"


@pytest.mark.parametrize("name", ["mesh", "starts", "tries", "slack", "time_limit"])
def test_defaults_and_help_of_settings_are_those_of_the_library(name):
    kind = make_commands.declared()["time-optimal"].kinds[name]
    assert kind.default == getattr(mo.planning.TimeOptimalSettings, name)
    first_words = " ".join(kind.text.split()[:6]).lower()
    assert first_words in " ".join((mo.planning.TimeOptimalSettings.__doc__ or "").lower().split())


def test_export_takes_the_robot_that_the_motion_names(call, ask, tmp_path):
    assert call("simulate", "microbot", "--q-deg", "0,30,20", "--out", "fall.npz")[0] == 0
    code, answer = ask("export", "fall.npz", "fall.csv", "--rate", "50")
    assert (code, answer["samples"], answer["written"]) == (0, 51, ["fall.csv"])
    heads, *rows = (tmp_path / "fall.csv").read_text().splitlines()
    assert heads.startswith("t [s],q waist [rad]")
    assert len(rows) == 51
    code, _, err = call("export", "fall.npz", "fall.txt")
    assert code == 2
    assert ".csv" in err


def test_every_command_takes_json():
    assert list(commands.COMMANDS) == COMMANDS


# watching a solve ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_iterations_of_a_solve_are_recorded(ask, tmp_path):
    path = tmp_path / "iterations.rrd"
    given = [*SHORT, "--mesh", "20", "--starts", "1"]
    code, answer = ask("time-optimal", *given, "--rerun-iterations", str(path))
    assert code == 0
    assert answer["written"] == [str(path)]
    chunks = RrdReader(path).stream().filter(content="/convergence/cost", is_static=False)
    batches = [chunk.to_record_batch() for chunk in chunks.to_chunks()]
    costs = [v[0] for batch in batches for v in batch.column("Scalars:scalars").to_pylist()]
    assert costs[-1] == pytest.approx(answer["duration"], rel=1e-4)
    assert len(costs) > 10


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--live", "--live-serve"], ["--live, --live-serve", "--live-connect"]),
        (
            ["--live-connect", "10.0.0.1:9876"],
            ["viewer", "HOST:PORT", "127.0.0.1, localhost", "'10.0.0.1:9876'"],
        ),
        (["--rerun-iterations", "a.txt"], ["--rerun-iterations", ".rrd"]),
    ],
)
def test_who_watches_is_checked_before_the_solve(refused, arguments, words):
    via = ["--via-deg", "0,0,0 -90,90,90"]
    tells(refused("time-optimal", "microbot", *via, *arguments), *words)


def test_a_warning_is_one_line_without_its_place_in_the_program(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(
        "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='revolute'>"
        "<parent link='a'/><child link='b'/></joint></robot>"
    )
    words = [sys.executable, "-m", "microbot_ocp.cli", "show", str(path)]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stderr == (
        "warning: arm.urdf: joints without lower and upper limit are read as unlimited: 'j'\n"
    )


def test_a_current_folder_that_is_gone_is_named(tmp_path, monkeypatch, capsys):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    via = ["--via-deg", "0,0,0 -90,90,90"]
    assert main(["compare", "microbot", *via, "--methods", "cubic", "--out", "a"]) == 2
    tells(capsys.readouterr().err, "current folder", "no such file")
