"""The one reader of files: what is no file is refused at once, whatever asks for it."""

import json
import os

import pytest

import microbot_ocp as mo
from helpers import refused
from microbot_ocp._base import reading
from microbot_ocp.scene import load_scene
from microbot_ocp.sweeps import load_sweep, read_study
from microbot_ocp.tasks import read_task

READERS = {
    "robot.toml": mo.load_robot,
    "robot.urdf": mo.load_robot,
    "task.toml": read_task,
    "study.toml": read_study,
    "scene.toml": load_scene,
    "scene.urdf": load_scene,
    "comparison/comparison.json": lambda path: mo.load_comparison(path.parent),
    "sweep/study.json": lambda path: load_sweep(path.parent),
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
@pytest.mark.parametrize("name", READERS)
def test_pipes_devices_and_huge_files_are_refused(tmp_path, monkeypatch, name):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    os.mkfifo(path)
    with refused(path.name, "a pipe"):
        READERS[name](path)
    path.unlink()
    path.symlink_to("/dev/zero")
    with refused(path.name, "a pipe"):
        READERS[name](path)
    path.unlink()
    path.write_text(json.dumps({"a": "b"}))
    monkeypatch.setattr(reading, "MOST_BYTES", 9)
    with refused(path.name, "9 bytes"):
        READERS[name](path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
@pytest.mark.parametrize("name", ["table.csv", "table.parquet"])
def test_tables_that_are_pipes_are_refused(tmp_path, name):
    os.mkfifo(tmp_path / name)
    (tmp_path / "study.toml").write_text(
        'schema = 1\nrobot = "microbot"\nmethods = ["cubic"]\n[cases]\nkind = "table"\n'
        f'file = "{name}"\n'
    )
    with refused(name, "a pipe"):
        read_study(tmp_path / "study.toml")


def test_a_byte_order_mark_is_no_part_of_a_text(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b'\xef\xbb\xbfname = "a"')
    assert reading.text_of(path, "robot file") == 'name = "a"'
