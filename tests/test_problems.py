"""Problem scripts as a reader runs them: what they print, write and return."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import microbot_ocp as mo

pytestmark = pytest.mark.slow

PROBLEMS = Path(__file__).parent.parent / "problems"
COMPARISON = PROBLEMS / "07_time_optimal_comparison.py"


def run(script, *arguments, folder):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "COLUMNS": "80"}
    return subprocess.run(
        [sys.executable, str(script), *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        env=environment,
        timeout=300,
    )


@pytest.fixture(scope="module")
def comparison(tmp_path_factory):
    folder = tmp_path_factory.mktemp("comparison")
    return run(COMPARISON, "--mesh", "20", "--out", str(folder / "out"), folder=folder), folder


def test_the_comparison_writes_its_files(comparison):
    done, folder = comparison
    assert done.returncode == 0, done.stderr
    names = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    expected = {"comparison.json", "comparison.csv", "comparison.rrd", "report.pdf"}
    expected |= {f"{name}.{kind}" for name in ("comparison", "paths") for kind in ("png", "pdf")}
    expected |= {f"motions/{name}.npz" for name in mo.METHODS}
    assert names == {f"out/{name}" for name in expected}


def test_the_comparison_prints_plain_lines_where_there_is_no_terminal(comparison):
    done, _ = comparison
    lines = done.stdout.splitlines()
    assert "\x1b" not in done.stdout
    assert "\r" not in done.stdout
    assert all(line.isprintable() for line in lines)
    for method in mo.METHODS.values():
        assert any(line.startswith(f"solve   {method.title}: solving") for line in lines)
        assert any(line.startswith(f"{method.title}  ") for line in lines)
    assert "16 files in" in lines[-1]
    assert "Traceback" not in done.stderr


def test_an_unknown_robot_is_one_line_with_those_there_are(tmp_path):
    done = run(COMPARISON, "--robot", "robbie", "--out", str(tmp_path / "out"), folder=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    assert "robbie" in line
    assert all(name in line for name in mo.packaged_robots())
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_mesh_is_one_line(tmp_path):
    done = run(COMPARISON, "--mesh", "2", "--out", str(tmp_path / "out"), folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.splitlines() == ["error: mesh must be at least 4 intervals, not 2"]
    assert list(tmp_path.iterdir()) == []
