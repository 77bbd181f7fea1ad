"""The embedded viewer: what it is sent, and where its program comes from."""

import importlib.util
import os
import subprocess
import sys
import textwrap
from urllib.request import urlopen

import pytest

import microbot_ocp as mo
from microbot_ocp.views import embedded


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("microbot")


@pytest.fixture(scope="module")
def motion(robot):
    shape = mo.cubic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 3.0])
    return mo.Motion.from_polynomial(robot, shape, label="cubic")


def test_the_viewer_is_sent_the_recording_and_its_program_is_local(tmp_path):
    # in another process: Rerun reads the address once, when it is imported
    code = """
    import microbot_ocp as mo, rerun_notebook
    robot = mo.load_robot("microbot")
    comparison = mo.compare(robot, [[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], ["cubic"])
    viewer = mo.show(comparison)
    sent = sum(len(buffer) for _, buffers in viewer._viewer._event_queue for buffer in buffers)
    print(sent > 50_000, rerun_notebook.ESM_MOD)
    """
    environment = {k: v for k, v in os.environ.items() if k != embedded.ASSET}
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        check=False,
        env={**environment, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    enough, address = done.stdout.split()
    assert enough == "True"
    assert address.startswith("http://127.0.0.1:")


def test_the_server_has_the_program_and_nothing_else():
    address = embedded._local_server()
    with urlopen(f"{address}/widget.js") as answer:
        assert answer.headers["Content-Type"] == "text/javascript"
        assert answer.headers["Access-Control-Allow-Origin"] == "*"
        assert b"re_viewer" in answer.read()
    with urlopen(f"{address}/re_viewer_bg.wasm") as answer:
        assert answer.headers["Content-Type"] == "application/wasm"
        assert answer.read(4) == b"\0asm"
    with pytest.raises(OSError, match="404"):
        urlopen(f"{address}/../__init__.py")


def test_without_the_extra_one_line_says_what_to_install(robot, motion, monkeypatch, capsys):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        embedded, "find_spec", lambda n: None if n == "rerun_notebook" else found(n)
    )
    assert embedded.show(motion, robot) is None
    assert "pip install 'microbot_ocp[notebook]'" in capsys.readouterr().out


def test_what_cannot_be_shown_is_refused(robot, motion):
    with pytest.raises(mo.InputError, match="needs the robot of a motion"):
        mo.show(motion)
    with pytest.raises(mo.InputError, match="not Robot"):
        mo.show(robot)
