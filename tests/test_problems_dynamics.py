"""The scripts of parts 4 to 7: exit codes, key numbers, files."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from helpers import sampled, tells

pytestmark = pytest.mark.slow

PROBLEMS = Path(__file__).parent.parent / "problems"
SCRIPTS = {
    "04a_inverse_dynamics.py": [
        "M11 = 34 + 24 cos(q3) + 18 cos(2 q2) + 24 cos(2 q2 + q3) + 16 cos(2 q2 + 2 q3)",
        "M33 = 32",
        "C32 = (24 sin(q3)) qd2",
        "G2 = 117.6 cos(q2) + 78.4 cos(q2 + q3)",
        # t = 0: gravity along Z, along Y, off
        "235.6194 2058.5851 1059.9022 294.4194 1861.1922 1004.4650 235.6194 1975.4294 1059.9022",
        "peak is 520.39 N m",
    ],
    "04b_forward_dynamics.py": [
        "Euler, step 0.05 s 25.2826 179.9434 -198.7090",
        "Euler loop -36536.6580",
        "the report differs",
    ],
    "05_baselines.py": [
        "cubic qd 10.000 40.000 20.000 jump -3.054 -0.436 0.960",
        "LSPB qd 10.000 40.000 20.000 jump -2.909 -1.164 0.465",
        "clamped spline qd -33.750 33.750 33.750 jump 0.000 0.000 0.000",
        "86.573 276.111 132.854",
        "81.356 323.060 149.057",
        "1.119 0.698 0.713",
        "0.983 0.698 0.640",
    ],
    "06_computed_torque.py": [
        "0.1 -39.0285 -39.0285",
        "1 -18.2703 -18.2703",
        "sampled at 100 Hz 0.0733 0.1870",
        "masses 20 % larger 0.6922 1.5183",
    ],
    "07_time_optimal.py": [
        "cubic, textbook velocities 2.512 1.211",
        "times and velocities 2.074 1.000",
        "Ratio: to cubic",
        "time-optimal, free: Passed",
    ],
}


def run(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(PROBLEMS / script), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Output of a script by its name, and its folder; each runs once."""
    done: dict[str, tuple[subprocess.CompletedProcess[str], Path]] = {}

    def of(script: str) -> tuple[subprocess.CompletedProcess[str], Path]:
        if script not in done:
            folder = tmp_path_factory.mktemp("out") / "made"
            done[script] = run(script, "--out", str(folder)), folder
        return done[script]

    return of


@pytest.mark.pages
@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_prints_its_numbers_and_draws(script, ran):
    done, folder = ran(script)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    printed = re.sub(r"[ \n]+", " ", done.stdout)
    for wanted in SCRIPTS[script]:
        assert wanted in printed
    pictures = sorted(folder.glob("*.png"))
    assert pictures
    assert all(path.stat().st_size > 10_000 for path in pictures)
    assert all(path.with_suffix(".pdf").exists() for path in pictures)
    recordings = list(folder.glob("*.rrd"))
    assert recordings
    assert all(path.stat().st_size > 100_000 for path in recordings)


@pytest.mark.pages
def test_every_integrator_gets_better_with_its_tolerance(ran):
    printed = ran("04b_forward_dynamics.py")[0].stdout
    for name in ("cvodes", "idas", "collocation", "rk"):
        row = next(line for line in printed.splitlines() if line.strip().startswith(name))
        errors = [float(entry) for entry in re.findall(r"(\d\.\de[-+]\d\d) \(", row)]
        assert len(errors) == 5
        assert errors[3] < 1e-5  # deg, at a tolerance of 1e-10
        assert errors[3] < 0.01 * errors[0]


@pytest.mark.pages
def test_every_integrator_follows_the_closed_loop(ran):
    printed = ran("06_computed_torque.py")[0].stdout
    for name in ("cvodes", "idas", "collocation", "rk"):
        found = re.search(rf"^ +{name} +(\d\.\de-\d\d) .*solved$", printed, re.MULTILINE)
        assert found
        assert float(found[1]) < 1e-6  # rad, at a tolerance of 1e-8


@pytest.mark.pages
def test_the_closed_form_of_the_error_dynamics(ran):
    printed = ran("06_computed_torque.py")[0].stdout
    rows = re.findall(r"^ +[\d.]+ +-?[\d.e-]+ +-?[\d.e-]+ +(\d\.\de-\d\d)$", printed, re.MULTILINE)
    assert len(rows) == 6
    assert all(float(difference) < 1e-6 for difference in rows)


@pytest.mark.parametrize("script", sampled(SCRIPTS, 2))
def test_bad_input_ends_with_2_and_one_line(script, tmp_path):
    done = run(script, "--out", str(tmp_path), "--robot", "nobody")
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.thorough
def test_a_bad_gain_and_a_bad_folder(tmp_path):
    done = run("06_computed_torque.py", "--out", str(tmp_path), "--kp", "-1")
    assert done.returncode == 2
    tells(done.stderr, "kp", "above 0", "-1.0")
    taken = tmp_path / "taken"
    taken.write_text("a file")
    done = run("05_baselines.py", "--out", str(taken))
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("script", sampled(SCRIPTS, 3))
def test_help_shows_an_example(script):
    done = run(script, "--help")
    assert done.returncode == 0
    assert f"example: python problems/{script}" in " ".join(done.stdout.split())
