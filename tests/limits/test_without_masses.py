"""Limits of torques of robots without masses: refused where given, named where brought along."""

import json
from pathlib import Path

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp.cli import main
from microbot_ocp.views.recording import of_comparison
from microbot_ocp.views.tables import comparison_rows

NOT_JUDGED = "torque not judged: no masses"
BARE = mo.Robot.from_dh([0, 0], [0, 1], [0, 0], tool=(0, 0.8, 0, 0), name="bare")
SHAPE = mo.quintic([[0.0, 0.0], [0.5, 0.8]], [0.0, 2.0])
POSES = [[0.0, 0.0], [0.5, 0.8]]
MOTION = mo.Motion.from_polynomial(BARE, SHAPE, label="quintic")
CALLS = {
    "certify": lambda limits: mo.certify(BARE, MOTION, limits),
    "certify stops": lambda limits: mo.certify(
        BARE, MOTION, limits, via_q=[mo.Stop(q) for q in POSES]
    ),
    "limit_history": lambda limits: mo.limits.limit_history(BARE, MOTION, limits),
    "shortest_duration": lambda limits: mo.shortest_duration(BARE, SHAPE, limits),
    "time_optimal": lambda limits: mo.time_optimal(BARE, POSES, limits),
    "time_optimal_path": lambda limits: mo.time_optimal_path(BARE, mo.straight_path(POSES), limits),
    "compare": lambda limits: mo.compare(BARE, POSES, methods=["cubic"], limits=limits),
}


@pytest.mark.parametrize("key", ["tau_max", "taud_max"])
@pytest.mark.parametrize("name", CALLS)
def test_limits_of_torques_that_are_given_are_refused(name, key):
    with refused(key, "'bare'", "no masses", f"leave out {key}"):
        CALLS[name](mo.Limits(qd_max=1.0, **{key: 5.0}))


@pytest.mark.thorough
def test_those_of_a_file_are_named_as_not_judged():
    robot = BARE.with_limits(qd_max=1.0, tau_max=5.0)
    for more in ({}, {"limits": robot.limits}, {"via_q": POSES}):
        certificate = mo.certify(robot, MOTION, **more)
        assert certificate.ok
        assert certificate.unjudged == ("torque",)
        tells(certificate.verdict, "every limit but", "torque")
    assert NOT_JUDGED in mo.time_optimal(robot, POSES, mesh=10, starts=1).note


def test_every_view_says_what_is_not_judged(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "bare.toml"
    robot = BARE.with_limits(qd_max=1.0, tau_max=5.0)
    mo.save_robot(robot, path)
    comparison = mo.compare(robot, POSES, methods=["cubic"])
    (row,) = comparison_rows(comparison)
    assert row["verdict_short"] == "ok, torque not judged"
    assert row["unjudged"] == ["torque"]
    assert row["work"] is None
    assert NOT_JUDGED.capitalize() + "." in of_comparison(comparison).summary.notes
    task = [str(path), "--via", "0,0 0.5,0.8"]
    for command in (["show", str(path)], ["compare", *task, "--methods", "cubic"]):
        assert main(command) == 0
        assert NOT_JUDGED.capitalize() in capsys.readouterr().out
    task += ["--mesh", "10", "--starts", "1"]
    assert main(["time-optimal", *task]) == 0
    assert f"Certificate: ok, {NOT_JUDGED}" in capsys.readouterr().out
    assert main(["time-optimal", *task, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["certificate"]["unjudged"] == ["torque"]


@pytest.mark.filterwarnings("error")
def test_links_without_any_mass_warn_of_nothing():
    robot = BARE.with_links([mo.Link(0.0, np.zeros(3))] * 2)
    motion = mo.Motion.from_polynomial(robot, SHAPE, label="quintic")
    certificate = mo.certify(robot, motion, mo.Limits(tau_max=5.0))
    assert certificate.undetermined_fraction == pytest.approx(1.0)
    tells(certificate.verdict, "joint 1", "1 more direction", "inverse dynamics")
