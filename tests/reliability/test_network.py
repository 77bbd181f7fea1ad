"""Nothing phones home: the sockets of what is started are watched by strace."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import nbformat
import pytest
import sockets

import microbot_ocp as mo
from microbot_ocp.views.live import find_viewer

ROOT = Path(__file__).parents[2]


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sockets.can_trace(), reason=sockets.WHY_NOT),
]

LIVE = """
import time
import microbot_ocp as mo
from border_calls import declared
from microbot_ocp.views import live
robot = mo.load_robot("microbot")
with live.served(print) as progress:
    mo.ocp.solve(declared()["problem"], 10, progress=progress)
    begin = time.perf_counter()
    comparison = mo.compare(robot, [[0, 0, 0], [-1, 1, 1]], ["cubic"])
    comparison.save("out", ["recording", "csv"])
    time.sleep(max(0.0, begin + 3.0 - time.perf_counter()))  # analytics would be sent within 2 s
"""
EMBED = """
import microbot_ocp as mo
from microbot_ocp.views import notebook
robot = mo.load_robot("microbot")
motion = mo.Motion.from_polynomial(robot, mo.quintic([[0, 0, 0], [1, 1, 1]], [0, 1]), label="a")
notebook.show(motion, robot)
"""


def traced(tmp_path, arguments, home):
    trace = tmp_path / "trace"
    environment = {
        "HOME": str(home),
        "PATH": "/usr/bin:/bin",
        "PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{ROOT / 'tests/reliability'}",
        "MICROBOT_OCP_CACHE": str(mo.cache_folder()),
    }
    done = subprocess.run(
        sockets.tracing(trace, [sys.executable, *arguments]),
        env=environment,
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    return sockets.reached(trace)


@pytest.fixture
def home(tmp_path):
    """A home where Rerun was asked before and may report: its first run never does."""
    settings = {
        "analytics_enabled": True,
        "analytics_id": "0123456789abcdef",
        "metadata": {},
        "config_file_path": str(tmp_path / "home/.config/rerun/analytics.json"),
        "data_dir_path": str(tmp_path / "home/.local/share/rerun/analytics"),
    }
    (tmp_path / "home/.config/rerun").mkdir(parents=True)
    (tmp_path / "home/.config/rerun/analytics.json").write_text(json.dumps(settings))
    return tmp_path / "home"


@pytest.mark.thorough
def test_a_live_view_and_saved_results_ask_no_other_machine(tmp_path, home):
    assert traced(tmp_path, ["-c", LIVE], home) == set()
    assert list((tmp_path / "out").glob("*.rrd"))


@pytest.mark.skipif("MICROBOT_OCP_KILLS" not in os.environ, reason="tried by make faults")
def test_the_demo_asks_no_other_machine(tmp_path, home):
    assert traced(tmp_path, ["-m", "microbot_ocp.cli", "demo"], home) == set()


@pytest.mark.thorough
def test_a_notebook_that_runs_and_is_exported_asks_no_other_machine(tmp_path, home):
    pytest.importorskip("nbconvert")
    page = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(EMBED)])
    nbformat.write(page, tmp_path / "page.ipynb")
    export = ["-m", "nbconvert", "--execute", "--to", "html", "page.ipynb"]
    assert traced(tmp_path, export, home) == set()
    assert "application/vnd.jupyter.widget-view+json" in (tmp_path / "page.html").read_text()


def test_the_trace_sees_what_a_program_asks(tmp_path, home):
    code = (
        "import socket\nfor place in ('192.0.2.1', 9), ('127.0.0.53', 53), ('127.0.0.1', 9):\n"
        "    socket.socket(socket.AF_INET, socket.SOCK_DGRAM).connect(place)"
    )
    assert traced(tmp_path, ["-c", code], home) == {"192.0.2.1", "127.0.0.53"}


@pytest.mark.skipif(find_viewer() is None, reason="no Rerun viewer")
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("SIGINT", 130),
        pytest.param("SIGTERM", 143, marks=pytest.mark.thorough),
        pytest.param("SIGHUP", 129, marks=pytest.mark.thorough),
    ],
)
def test_a_signal_ends_the_servers(tmp_path, name, expected):
    if signal.getsignal(getattr(signal, name)) is signal.SIG_IGN:
        pytest.skip(f"{name} is ignored here, as below nohup, and by what is started")
    command = [sys.executable, "-m", "microbot_ocp.cli", "compare", "microbot", "--live-serve"]
    options = ["--via-deg", "0,0,0 -90,90,90", "--methods", "cubic"]
    process = subprocess.Popen(
        [*command, *options], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    while "Ctrl-C ends the server" not in process.stderr.readline():
        assert process.poll() is None
    served = children(process.pid)
    assert served
    begin = time.monotonic()
    process.send_signal(getattr(signal, name))
    _, err = process.communicate(timeout=30)
    assert process.returncode == expected
    assert time.monotonic() - begin < 3.0
    assert "Traceback" not in err
    assert not [pid for pid in served if Path(f"/proc/{pid}/cmdline").exists() and alive(pid)]


def alive(pid):
    return " Z " not in Path(f"/proc/{pid}/stat").read_text()


def children(pid):
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        fields = entry.read_text().rsplit(")", 1)[-1].split()
        if int(fields[1]) == pid:
            child = int(entry.parent.name)
            found += [child, *children(child)]
    return found
