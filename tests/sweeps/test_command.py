"""The command ``sweep``: refusals, Ctrl-C, going on, one case, the summary."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from helpers import tells
from microbot_ocp.cli import main

STUDY = """
schema = 1
robot = "microbot"
methods = ["cubic"]
[cases]
kind = "grid"
[quantities]
start_q_deg = [0, 45, -30]
goal_q_deg = { from = [-90, 30, -90], to = [90, 120, 90], steps = 4 }
"""


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    return path


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], ("study file", "--summary")),
        (["study.toml"], ("--out FOLDER",)),
        (["nothing.toml", "--out", "a"], ("nothing.toml", "read")),
        (["study.toml", "--out", "a", "--workers", "0"], ("workers", "1, not 0")),
        (["study.toml", "--out", "a", "--workers", "99999"], ("workers", "99999")),
        (
            ["study.toml", "--out", "a", "--workers", "2", "--scheduler", "tcp://x:1"],
            ("--workers", "--scheduler"),
        ),
        (["study.toml", "--case", "64"], ("case", "0 to 63", "64")),
        (["--summary", "nothing"], ("nothing", "saved sweep")),
    ],
)
def test_bad_commands_are_refused(
    study: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: tuple[str, ...]
) -> None:
    assert main(["sweep", *arguments]) == 2
    tells(capsys.readouterr().err, *said)


def test_one_case(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "study.toml", "--case", "1", "--out", "one", "--json"]) == 0
    row = json.loads(capsys.readouterr().out)
    assert row["case"] == 1
    assert row["cubic_status"] == "solved"
    assert sorted(path.name for path in Path("one").iterdir()) == ["cubic.npz"]


@pytest.mark.thorough
def test_without_a_compiler_the_row_is_the_same_and_says_so(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = "[settings]\nmesh = 10\nstarts = 1\n"
    study.write_text(STUDY.replace('"cubic"', '"time_optimal"') + settings)
    arguments = ["sweep", "study.toml", "--case", "1", "--json"]
    assert main(arguments) == 0
    row = json.loads(capsys.readouterr().out)
    known = {**os.environ, "PATH": "", "CC": "", "MICROBOT_OCP_CACHE": str(Path.cwd() / "cache")}
    command = [sys.executable, "-m", "microbot_ocp.cli", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=known)
    other = json.loads(done.stdout)
    assert (row["compiled"], other["compiled"]) == (True, False)
    name = "time_optimal_duration"
    assert other[name] == pytest.approx(row[name], rel=1e-6)


@pytest.mark.thorough
@pytest.mark.slow
def test_an_interrupted_sweep_says_how_to_continue(study: Path) -> None:
    command = [sys.executable, "-m", "microbot_ocp.cli", "sweep", "study.toml", "--out", "out"]
    process = subprocess.Popen(
        [*command, "--workers", "1"], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    while not list(Path("out/cases").glob("part-*")):
        assert process.poll() is None
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    tells(said, "microbot-ocp sweep study.toml --out out")
    assert "Traceback" not in said
    kept = len(list(Path("out/cases").glob("part-*")))
    assert 1 <= kept < 64
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline and _group_lives(process.pid):
        time.sleep(0.05)
    assert not _group_lives(process.pid)


def _group_lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
