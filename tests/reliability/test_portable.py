"""The package without forks, signals and modules that Windows and macOS lack.

``windows/sitecustomize.py`` hides them from this project in a new Python process and in its child
processes: files are opened and flushed as on Windows, and no C code is compiled.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLACES = (Path(__file__).parent / "windows", ROOT / "src")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the true Windows runs all tests")

HIDDEN = """
import os, signal, sys
assert sys.platform == "win32"
for module, name in ((os, "fork"), (os, "killpg"), (signal, "SIGKILL"), (signal, "setitimer")):
    assert not hasattr(module, name), name
try:
    import fcntl
except ImportError:
    from microbot_ocp._base.child_process import can_fork
    from microbot_ocp._base import codegen
    assert not can_fork() and codegen.compiler() is None
    print("hidden")
"""
TIMED = """
import numpy as np
import time
import microbot_ocp as mo
robot = mo.load_robot("microbot")
via = np.radians([[0, 0, 0], [20, 60, -30], [-60, 30, 80]])
motion = mo.time_optimal(robot, via, mesh=20, starts=1, time_limit=60.0)
motion.save("motion.npz")
print(mo.Motion.load("motion.npz").duration == motion.duration, mo.certify(robot, motion).ok)
begin = time.monotonic()
mo.time_optimal(robot, via, time_limit=0.5)
print(time.monotonic() - begin < 5.0)
"""
SWEPT = """
import microbot_ocp as mo
if __name__ == "__main__":
    cases = mo.sweeps.Cases.grid(
        start_q=[0, 0, 0], goal_q_deg=[90, 45, 45], payload=mo.Between(0, 2, 2)
    )
    swept = mo.sweep(mo.load_robot("microbot"), cases, ["cubic"], out="swept", workers=1)
    print(swept.read(["cubic_duration"])["cubic_duration"].round(3))
"""
INTERRUPTED = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores it
import microbot_ocp as mo
def stop(step):
    signal.raise_signal(signal.SIGINT)
robot = mo.load_robot("microbot")
try:
    mo.compare(robot, [[0, 0, 0], [1, 1, 1]], progress=stop)
except KeyboardInterrupt:
    print("interrupted")
"""
RAN = {
    "names are hidden": (HIDDEN, "hidden\n"),
    "a motion in time, saved and loaded": (TIMED, "True True\nTrue\n"),
    "a sweep": (SWEPT, "[1.847 4.382]\n"),
    "an interrupt": (INTERRUPTED, "interrupted\n"),
}


def start(folder, *words, **options):
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, PLACES)),
        "PYTHONWARNDEFAULTENCODING": "1",  # see sitecustomize.py
    }
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(
        [sys.executable, *words], cwd=folder, env=environment, **streams, **options
    )


@pytest.mark.slow
@pytest.mark.parametrize(("script", "printed"), RAN.values(), ids=RAN.keys())
def test_the_package_runs(tmp_path, script, printed):
    (tmp_path / "script.py").write_text(script, "utf-8")
    said, complaint = start(tmp_path, "script.py").communicate(timeout=300)
    assert (said, complaint) == (printed, "")


@pytest.mark.thorough
def test_the_demo_runs(tmp_path):
    process = start(tmp_path, "-m", "microbot_ocp", "demo", "--out", "demo")
    said, complaint = process.communicate(timeout=500)
    assert process.returncode == 0, complaint
    assert "time-optimal, free" in said
    assert {"comparison.json", "comparison.rrd"} <= {p.name for p in (tmp_path / "demo").iterdir()}


def test_bad_input_is_refused(tmp_path):
    process = start(tmp_path, "-m", "microbot_ocp", "show", "no_robot")
    said, complaint = process.communicate(timeout=100)
    assert (process.returncode, said, complaint.count("\n")) == (2, "", 1)


@pytest.mark.slow
def test_ctrl_c_ends_the_program(tmp_path):
    process = start(tmp_path, "-m", "microbot_ocp", "demo", "--out", "demo")
    time.sleep(2.5)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGINT
    assert not list(tmp_path.rglob("*.part"))
