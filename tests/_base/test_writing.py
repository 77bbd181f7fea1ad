import os
import stat
import subprocess
import sys
import threading

import pytest

import microbot_ocp as mo
from helpers import refused
from microbot_ocp import NotWritten
from microbot_ocp._base.writing import made_folder, temporary_path, whole_file, write_whole

needs_linux = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's limits and /dev")


def test_a_file_is_replaced_as_a_whole(tmp_path):
    path = tmp_path / "a.txt"
    write_whole(path, "old")

    def fail_halfway():
        with whole_file(path) as partial:
            partial.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_halfway()
    assert path.read_text() == "old"
    with whole_file(path) as partial:
        partial.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_permissions_are_those_of_a_new_file(tmp_path):
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "a", b"")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("folder/target")
    for text in ("one", "two"):
        write_whole(tmp_path / "link", text)
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "folder/target").read_text() == text


@pytest.mark.parametrize(
    ("place", "reason"),
    [("none/a", "exist"), ("", "is a folder"), ("x" * 300, "too long")],
)
def test_a_file_that_cannot_be_written_is_named_with_the_reason(tmp_path, place, reason):
    with refused("not written", reason, error=NotWritten) as caught:
        write_whole(tmp_path / place, "text")
    assert isinstance(caught.value, mo.InputError)
    assert str(tmp_path)[:40] in str(caught.value)
    assert len(str(caught.value)) < 300
    assert os.listdir(tmp_path) == []


def test_a_name_that_is_no_name(tmp_path):
    for call in (lambda path: write_whole(path, "text"), made_folder):
        with refused("not written", "null", error=NotWritten):
            call(f"{tmp_path}/a\0b")
    (tmp_path / "file").touch()
    with refused("file/folder", "not a directory", error=NotWritten):
        made_folder(tmp_path / "file/folder")


def test_names_as_long_as_the_disk_allows(tmp_path):
    name = "ä" * 127
    write_whole(tmp_path / name, "text")
    assert os.listdir(tmp_path) == [name]


@pytest.mark.skipif(sys.platform == "win32", reason="nobody knows which processes are dead")
def test_leftovers_of_the_dead_are_removed_and_no_others(tmp_path):
    child = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys, time\nfrom pathlib import Path\n"
            "from microbot_ocp._base.writing import whole_file\n"
            "with whole_file(sys.argv[1]) as partial:\n"
            "    partial.write_text('half'); print('ready', flush=True); time.sleep(60)\n",
            str(tmp_path / "a"),
        ],
        stdout=subprocess.PIPE,
    )
    assert child.stdout is not None
    child.stdout.readline()
    with temporary_path(tmp_path / "b") as own:
        own.mkdir()
        write_whole(tmp_path / "c", "text")
        assert own.is_dir()  # of this process, in use
    assert len(os.listdir(tmp_path)) == 2  # the other process lives
    child.kill()
    child.wait()
    child.stdout.close()
    write_whole(tmp_path / "c", "text")
    assert os.listdir(tmp_path) == ["c"]


def test_two_writers_do_not_disturb_each_other(tmp_path):
    path, contents = tmp_path / "a", [bytes([k]) * 200_000 for k in range(4)]
    stop, bad = threading.Event(), []

    def read():
        while not stop.is_set():
            if path.read_bytes() not in contents:
                bad.append(1)

    write_whole(path, contents[0])
    reader = threading.Thread(target=read)
    reader.start()
    writers = [
        threading.Thread(target=lambda c=c: [write_whole(path, c) for _ in range(20)])
        for c in contents
    ]
    for thread in writers:
        thread.start()
    for thread in writers:
        thread.join()
    stop.set()
    reader.join()
    assert not bad
    assert os.listdir(tmp_path) == ["a"]


@needs_linux
def test_devices_are_written_directly(tmp_path):
    write_whole("/dev/null", "text")
    with refused("/dev/full", "no space", error=NotWritten):
        write_whole("/dev/full", "text")
    os.mkfifo(tmp_path / "pipe")
    reader = threading.Thread(target=lambda: found.append((tmp_path / "pipe").read_text()))
    found = []
    reader.start()
    write_whole(tmp_path / "pipe", "text")
    reader.join()
    assert found == ["text"]
