"""The embedded viewer: what it is sent, and where its program comes from."""

import base64
import re
import sys
from urllib.request import urlopen

import pytest
import rerun_notebook

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp.views.recording import of_motion

ASSET = "RERUN_NOTEBOOK_ASSET"


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("microbot")


@pytest.fixture(scope="module")
def motion(robot):
    shape = mo.cubic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 3.0])
    return mo.Motion.from_polynomial(robot, shape, label="cubic")


def test_the_viewer_is_sent_the_recording_and_its_program_is_local(robot, motion, monkeypatch):
    monkeypatch.delenv(ASSET, raising=False)
    viewer = mo.show(motion, robot)
    sent = b"".join(bytes(part) for _, parts in viewer._viewer._event_queue for part in parts)
    assert len(sent) > 50_000
    assert of_motion(robot, motion).application.encode() in sent  # a layout of its own
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/widget\.js", viewer._viewer._esm)
    assert (
        viewer._viewer._esm
        in base64.b64decode(
            re.findall(r"atob\('([^']*)'", viewer._error_widget._html.value)[0]
        ).decode()
    )


def test_a_chosen_address_of_the_program_is_left(robot, motion, monkeypatch):
    chosen = "https://example.org/widget.js"
    monkeypatch.setenv(ASSET, chosen)
    monkeypatch.setattr(rerun_notebook.Viewer, "_esm", chosen)  # as Rerun did when it was imported
    assert mo.show(motion, robot)._viewer._esm == chosen


def test_the_server_has_the_program_and_nothing_else(robot, motion, monkeypatch):
    monkeypatch.delenv(ASSET, raising=False)
    address = mo.show(motion, robot)._viewer._esm.removesuffix("/widget.js")
    with urlopen(f"{address}/widget.js") as answer:
        assert answer.headers["Content-Type"] == "text/javascript"
        assert answer.headers["Access-Control-Allow-Origin"] == "*"
        assert b"re_viewer" in answer.read()
    with urlopen(f"{address}/re_viewer_bg.wasm") as answer:
        assert answer.headers["Content-Type"] == "application/wasm"
        assert answer.read(4) == b"\0asm"
    with refused("404", error=OSError):
        urlopen(f"{address}/../__init__.py")


def test_without_the_extra_one_line_says_what_to_install(robot, motion, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rerun_notebook", None)
    assert mo.show(motion, robot) is None
    tells(capsys.readouterr().out, "pip install 'microbot_ocp[notebook]'")


def test_what_cannot_be_shown_is_refused(robot, motion):
    with refused("show", "motion", "robot"):
        mo.show(motion)
    with refused("show", "Comparison", "Motion", "Robot"):
        mo.show(robot)
