"""Nothing phones home: the sockets of what is started are watched by strace."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from microbot_ocp.views.live import find_viewer

ROOT = Path(__file__).parents[2]


def can_trace():
    command = ["strace", "-f", "--seccomp-bpf", "-o", "/dev/null", "true"]
    return shutil.which("strace") and not subprocess.run(command, check=False).returncode


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not can_trace(), reason="needs strace, and the right to trace"),
]

SOLVE = """
import numpy as np, time
import microbot_ocp as mo
from microbot_ocp.views import live
with live.served(print) as progress:
    mo.time_optimal(
        mo.load_robot("microbot"), np.radians([[0, 0, 0], [-90, 90, 90]]), mesh=10, starts=1,
        progress=progress,
    )
    time.sleep(3.0)  # analytics would be sent within 2 s
"""
EMBED = """
import numpy as np
import microbot_ocp as mo
from microbot_ocp.views import notebook
robot = mo.load_robot("microbot")
motion = mo.Motion.from_polynomial(robot, mo.quintic([[0, 0, 0], [1, 1, 1]], [0, 1]), label="a")
notebook.show(motion, robot)
"""
DEMO = """
import numpy as np
import microbot_ocp as mo
via = np.radians([[0, 0, 0], [-90, 90, 90]])
mo.compare(mo.load_robot("microbot"), via, ["cubic"]).save("out", ["recording", "report"])
"""


def reached(trace):
    """Addresses beyond this machine that a traced program named."""
    text = trace.read_text(errors="replace")
    found = re.findall(r'inet_addr\("([\d.]+)"\)|inet_pton\(AF_INET6, "([^"]+)"', text)
    near = ("127.", "0.0.0.0", "::1", "::ffff:127.")
    return {a or b for a, b in found if (a or b) != "::" and not (a or b).startswith(near)}


def traced(tmp_path, arguments, home):
    trace = tmp_path / "trace"
    calls = "trace=connect,sendto,sendmsg,sendmmsg"
    command = ["strace", "-f", "--seccomp-bpf", "-qq", "-e", calls, "-o", trace]
    environment = {
        "HOME": str(home),
        "PATH": "/usr/bin:/bin",
        "PYTHONPATH": str(ROOT / "src"),
        "MICROBOT_OCP_CACHE": os.environ["MICROBOT_OCP_CACHE"],
    }
    done = subprocess.run(
        [*command, sys.executable, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    return reached(trace)


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


@pytest.mark.parametrize("code", [SOLVE, EMBED, DEMO], ids=["live", "notebook", "save"])
def test_no_other_machine_is_asked(tmp_path, home, code):
    assert traced(tmp_path, ["-c", code], home) == set()


def test_the_trace_sees_what_a_program_asks(tmp_path, home):
    code = (
        "import socket\ns = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "s.connect(('192.0.2.1', 9))"
    )
    assert traced(tmp_path, ["-c", code], home) == {"192.0.2.1"}


@pytest.mark.skipif(find_viewer() is None, reason="no Rerun viewer")
@pytest.mark.parametrize(("name", "expected"), [("SIGTERM", 143), ("SIGHUP", 129), ("SIGINT", 130)])
def test_a_signal_ends_the_servers(tmp_path, name, expected):
    command = [sys.executable, "-m", "microbot_ocp.cli", "time-optimal", "microbot"]
    options = ["--via-deg", "0,0,0 -90,90,90", "--mesh", "10", "--starts", "1", "--live-serve"]
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
