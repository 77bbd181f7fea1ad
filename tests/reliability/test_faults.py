"""Kills at random instants, full disks and races: a file is whole or absent, the next run mends.

``make faults`` repeats each of them as often as ``MICROBOT_OCP_KILLS`` says, and prints counts.
"""

import contextlib
import ctypes
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from border_calls import declared
from rerun.chunk import RrdReader

import microbot_ocp as mo
from helpers import sampled
from microbot_ocp._base import codegen
from microbot_ocp._base.child_process import in_child
from microbot_ocp._base.codegen import compile_function
from microbot_ocp.cli import main
from microbot_ocp.sweeps import load_sweep, read_study, repeat_case
from microbot_ocp.sweeps._sweep import opened
from microbot_ocp.tasks import Cell

KILLS = int(os.environ.get("MICROBOT_OCP_KILLS", "3"))
MANY = KILLS >= 100  # else a glance at the quick ones
VIA = np.radians([[0, 0, 0], [-90, 90, 90]])
STUDY = """schema = 1
robot = "microbot"
methods = ["cubic"]
[cases]
kind = "grid"
[quantities]
start_q_deg = [0, 45, -30]
goal_q_deg = { from = [-90, 30, -90], to = [90, 120, 90], steps = 2 }
"""
COMMAND = ["compare", "microbot", "--via-deg", "0,0,0 -90,90,90", "--methods", "cubic,time_optimal"]
COMMAND += ["--mesh", "10", "--out", "out"]

resource = pytest.importorskip("resource")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs fork and Linux's limits")


def told(capsys, sentence):
    if "MICROBOT_OCP_KILLS" in os.environ:
        with capsys.disabled():
            print(f"\n{sentence}")


@cache
def robot():
    return mo.load_robot("microbot")


@cache
def versions(kind):
    """Two things of a kind, which a reader can tell apart."""
    if kind == "motion":
        shape = mo.quintic([[0, 0, 0], [1, 1, 1]], [0, 1])
        one = mo.Motion.from_polynomial(robot(), shape, label="version 0")
        return one, replace(one, tau=2 * one.tau, label="version 1")
    if kind == "comparison":
        return tuple(mo.compare(robot(), VIA, names) for names in (["cubic"], ["cubic", "lspb"]))
    if kind == "figure":
        return (mo.plots.arms(robot(), {"start": VIA[0]}),) * 2
    if kind == "robot":
        return robot(), replace(robot(), name="version 1")
    if kind == "solution":
        return tuple(mo.ocp.solve(declared()["problem"], mesh) for mesh in (5, 6))
    if kind == "cell":
        stops = tuple(mo.Stop(q=q) for q in VIA)
        certificate = versions("comparison")[0].certificates["cubic"]
        return tuple(Cell(robot(), stops, None, False, m, certificate) for m in versions("motion"))
    return tuple(mo.Table.of_text(["version"], [[str(k)] * 9]) for k in range(2))


def export(path, motion):
    motion.export(path, robot=robot())


def film(path, motion):
    motion.resample(50, robot()).export(path, rate=1, robot=robot())


WRITERS = {  # by name: what it is, and how it is written at a path
    "motion.npz": ("motion", lambda path, motion: motion.save(path)),
    "motion.csv": ("motion", export),
    "motion.json": ("motion", export),
    "motion.mat": ("motion", export),
    "motion.parquet": ("motion", export),
    "motion.xml": ("motion", export),
    "motion.rrd": ("motion", lambda path, motion: motion.to_rerun(robot(), path)),
    "figure.png": ("figure", lambda path, axes: axes.savefig(path)),
    "figure.pdf": ("figure", lambda path, axes: axes.savefig(path)),
    "film.gif": ("motion", film),
    "solution.npz": ("solution", lambda path, solution: mo.ocp.save_solution(solution, path)),
    "robot.toml": ("robot", lambda path, robot: mo.save_robot(robot, path)),
    "robot.urdf": ("robot", lambda path, robot: mo.save_robot(robot, path)),
    "table.csv": ("table", lambda path, table: table.write_csv(path)),
    "comparison": ("comparison", lambda path, run: run.save(path, ("json", "csv", "motions"))),
    "cell": ("cell", lambda path, cell: cell.save(path, ("json", "motion"))),
    "sweep": ("sweep", lambda path, version: sweep(path)),
}
SLOW = ("motion.rrd", "figure.png", "figure.pdf", "film.gif")
QUICK = ("motion.npz", "motion.csv", "robot.toml", "robot.urdf", "table.csv", "comparison")
FULL_DISK = WRITERS if MANY else (*QUICK, "motion.parquet", "motion.rrd", "sweep")
KILLED = [name for name in WRITERS if name not in SLOW] if MANY else QUICK
PAGE = 4096
CANNOT, WRONG = 77, 1  # exit codes
CLONE_NEWNS, CLONE_NEWUSER, MS_REC, MS_PRIVATE = 0x20000, 0x10000000, 0x4000, 0x40000  # of Linux
SIGNALS = {"SIGTERM": 143, "SIGHUP": 129, "SIGINT": 130}


def write(name, path, version):
    kind, how = WRITERS[name]
    how(path, version if kind == "sweep" else versions(kind)[version])


@cache
def cases():
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "study.toml"
        file.write_text(STUDY)
        study = read_study(file)
    return study, [repeat_case(study, case) for case in range(study.source.count)]


def sweep(path):
    study, done = cases()
    target = opened(study, path)
    for number in range(0, len(done), study.chunk):
        target._write(number // study.chunk, done[number : number + study.chunk])


def read(name, path):
    """What a reader finds: nothing, or one version whole; else it raises."""
    if not path.exists():
        return None
    if name == "motion.npz":
        return mo.Motion.load(path).label
    if name == "motion.rrd":
        return RrdReader(path) and "recording"
    if name == "solution.npz":
        return mo.ocp.load_solution(path).phases[0].t.size
    if name.startswith("robot"):
        return mo.load_robot(path).name
    if name == "comparison":
        return len(mo.load_comparison(path).motions)
    if name == "cell":
        found = path / "motion.npz", path / "cell.json"
        return [len(json.loads(f.read_text()) if f.suffix == ".json" else mo.Motion.load(f).label)
                for f in found if f.exists()]  # fmt: skip
    if name == "sweep":
        if not (path / "study.json").exists():  # it comes first
            return None
        found = load_sweep(path)
        return found.done and len(found.read(["case"])["case"])
    content = path.read_bytes()
    begin = 128 if path.suffix == ".mat" else 0  # its head tells the time
    if name not in SLOW:
        assert content[begin:] in [known[begin:] for known in contents(name)], name
    return len(content)


@cache
def contents(name):
    """Bytes of both versions of a file that has no reader here."""
    place = Path(f"/dev/shm/faults-{os.getpid()}-{name}")
    found = []
    for version in range(2):
        write(name, place, version)
        found.append(place.read_bytes())
        place.unlink()
    return found


def leftovers(folder):
    return [path for path in folder.rglob("*") if path.name.endswith(".part")]


@pytest.fixture
def small_files():
    """No file may grow beyond a size: what a full disk does, to this process alone."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


def write_where_nothing_fits(name, path, reason):
    """Write over what is there, on a disk with too little room: that is refused, and it stays."""
    files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
    before = {p: p.read_bytes() for p in files}
    with pytest.raises(mo.NotWritten, match=f"(?i){reason}") as caught:
        write(name, path, 1)
    assert str(path.parent)[:40] in str(caught.value)
    assert not leftovers(path.parent)
    if path.is_file():
        assert path.read_bytes() == before[path]


def largest(path):
    files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
    return max(p.stat().st_size for p in files)


@pytest.mark.parametrize("name", sampled(FULL_DISK, 2))
def test_a_file_that_may_not_grow_leaves_the_old_one(tmp_path, small_files, capsys, name):
    draw, path = random.Random(name), tmp_path / name
    write(name, path, 0)
    for _ in range(times := repetitions(name)):
        small_files(draw.randrange(largest(path) // 2))
        write_where_nothing_fits(name, path, "file too large")
        small_files(resource.RLIM_INFINITY)
        assert read(name, path)
        if path.is_dir():
            write(name, path, 0)
    told(capsys, f"{name}: {times} writes of files that may not grow refused, the old file whole")


def repetitions(name):
    return KILLS // (25 if name in SLOW else 1) if MANY else 1


def on_a_disk_of_its_own(folder, size):
    """Put an empty file system of so many bytes at a folder, for this process alone."""
    system, (user, group) = ctypes.CDLL(None, use_errno=True), (os.getuid(), os.getgid())
    if system.unshare(CLONE_NEWNS):  # only root may
        if system.unshare(CLONE_NEWNS | CLONE_NEWUSER):
            return False
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
        Path("/proc/self/gid_map").write_text(f"{group} {group} 1")
    system.mount(None, b"/", None, MS_REC | MS_PRIVATE, None)
    settings = f"size={size}".encode()
    return not system.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", 0, settings)


def fill(path, left):
    """Let a file take all of a disk but ``left`` pages."""
    with path.open("wb", buffering=0) as stream, contextlib.suppress(OSError):
        while stream.write(bytes(PAGE)):
            pass
    os.truncate(path, max(0, path.stat().st_size - left * PAGE))


@pytest.mark.parametrize("name", sampled(FULL_DISK, 2))
def test_a_full_disk_leaves_the_old_file(tmp_path, capsys, name):
    """A file system that is full, of memory, which a child of this process sees alone."""
    draw, times = random.Random(name), repetitions(name)
    path, rest = tmp_path / "disk" / name, tmp_path / "disk/rest"
    path.parent.mkdir()
    write(name, tmp_path / name, 0)  # what is made once
    child = os.fork()
    if not child:
        code = CANNOT
        with contextlib.suppress(BaseException):
            if on_a_disk_of_its_own(path.parent, 2_000_000 + 3 * largest(tmp_path / name)):
                code = WRONG
                write(name, path, 0)
                for _ in range(times):
                    fill(rest, draw.randrange(1 + largest(path) // PAGE // 2))
                    write_where_nothing_fits(name, path, "no space left")
                    rest.unlink()
                    assert read(name, path)
                    if path.is_dir():
                        write(name, path, 0)
                code = 0
        os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code == CANNOT:
        pytest.skip("needs the right to mount a file system")
    assert code == 0
    told(capsys, f"{name}: {times} writes to a full file system refused, the old file whole")


def is_refused_for_a_kill(message):
    """Whether a folder is refused for a run that was killed: before its index came, or after."""
    no_index = "comparison.json" in message and "No such file" in message
    return no_index or any(words in message for words in ("another run", "missing"))


def test_a_comparison_without_its_index_is_refused(tmp_path):
    with pytest.raises(mo.InputError) as caught:
        mo.load_comparison(tmp_path)
    assert is_refused_for_a_kill(str(caught.value))


@pytest.mark.parametrize("name", sampled(KILLED, 2))
def test_a_kill_while_writing(tmp_path, capsys, name):
    path, found = tmp_path / name, Counter()
    write(name, tmp_path / f"first {name}", 0)  # what is made once
    begin = time.perf_counter()
    write(name, tmp_path / f"first {name}", 1)
    span = time.perf_counter() - begin
    times = KILLS // 4 if MANY else 1
    for _ in range(times):
        child = os.fork()
        if not child:
            version = 0
            while True:
                write(name, path, version)
                version = 1 - version
        time.sleep(random.uniform(0.0, 4.0 * span))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        try:
            found[str(read(name, path))] += 1
        except mo.InputError as problem:
            assert name == "comparison"
            assert is_refused_for_a_kill(str(problem))  # noqa: PT017
            found["refused"] += 1
        write(name, path, 0)
        assert read(name, path)
        assert not leftovers(path if path.is_dir() else tmp_path)
    told(capsys, f"{name}: {times} kills while writing: {dict(found)}")


def tripled(factor):
    x = ca.SX.sym("x", 2)
    return ca.Function("tripled", [x], [factor * x])


@pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler")
def test_a_kill_while_compiling(tmp_path, monkeypatch, capsys):
    folder, there = tmp_path / "cache", 0
    monkeypatch.setenv("MICROBOT_OCP_CACHE", str(folder))
    begin = time.perf_counter()
    compile_function(tripled(0.0))
    span = time.perf_counter() - begin
    for number in range(1, KILLS + 1):
        child = os.fork()
        if not child:
            compile_function(tripled(float(number)))
            os._exit(0)
        time.sleep(random.uniform(0.0, 1.5 * span))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        there += sum(map(codegen._is_whole, folder.glob("*.so"))) == number + 1
        made = compile_function(tripled(float(number)))
        assert made.class_name() == "External"
        assert np.array(made([1.0, 2.0])).ravel().tolist() == [number, 2.0 * number]
        assert not leftovers(folder)
    assert {path.suffix for path in folder.iterdir()} == {".so", ".sha256"}
    told(capsys, f"{KILLS} kills while compiling: {there} had a library, all were made whole")


@pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler")
def test_eight_compiles_at_once(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("MICROBOT_OCP_CACHE", str(tmp_path / "cache"))
    rounds = 1 + KILLS // 20
    for number in range(rounds):
        children = []
        for _ in range(8):
            child = os.fork()
            if not child:
                value = compile_function(tripled(number + 0.5))([1.0, 2.0])
                os._exit(0 if np.array(value).ravel()[1] == 2 * number + 1.0 else 1)
            children.append(child)
        assert [os.waitpid(child, 0)[1] for child in children] == [0] * 8
        assert len(list((tmp_path / "cache").iterdir())) == 2 * (number + 1)
    told(capsys, f"{rounds} times eight processes that compiled the same: all had it")


def test_two_writers_of_a_folder(tmp_path, capsys):
    children, found = [], Counter()
    for version in range(2):
        child = os.fork()
        if not child:
            for _ in range(5 + KILLS // 5):
                write("comparison", tmp_path / "out", version)
            os._exit(0)
        children.append(child)
    while children:
        children = [c for c in children if os.waitpid(c, os.WNOHANG)[0] == 0]
        try:
            found[str(read("comparison", tmp_path / "out"))] += 1
        except mo.InputError:
            found["refused"] += 1
    assert read("comparison", tmp_path / "out") in (1, 2)
    assert not leftovers(tmp_path)
    told(capsys, f"two writers of a comparison's folder, read meanwhile: {dict(found)}")


def test_what_a_killed_process_started_ends_with_it():
    reading, writing = os.pipe()

    def work(_):
        os.write(writing, os.getpid().to_bytes(8, "little"))
        time.sleep(60.0)  # a solver that says nothing

    parent = os.fork()
    if not parent:
        in_child(work, time.perf_counter() + 60.0)
    child = int.from_bytes(os.read(reading, 8), "little")
    os.kill(parent, signal.SIGKILL)
    os.waitpid(parent, 0)
    until = time.perf_counter() + 5.0
    while runs(child) and time.perf_counter() < until:
        time.sleep(0.01)
    assert not runs(child)


def runs(process):
    """Whether it is there, and no zombie that nobody has asked for."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


@pytest.mark.skipif(not MANY, reason="tried by make faults")
def test_a_kill_while_solving(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(COMMAND) == 0  # it compiles
    found, spans = Counter(), []

    def kept():
        """The same without what is drawn, which takes most of the time."""
        run = mo.compare(robot(), VIA, ["cubic", "time_optimal"], mesh=10)
        return not run.save("out", ("json", "csv", "motions"))

    for way in (kept, lambda: main(COMMAND)):
        begin = time.perf_counter()
        assert not way()
        spans.append(time.perf_counter() - begin)
    for number in range(KILLS):
        shutil.rmtree("out", ignore_errors=True)
        child = os.fork()
        if not child:
            os._exit(main(COMMAND) if number % 25 == 0 else kept())
        time.sleep(random.uniform(0.0, 1.2 * spans[number % 25 == 0]))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        try:
            there = Path("out/comparison.json").exists()
            found[str(len(mo.load_comparison("out").motions)) if there else "nothing"] += 1
        except mo.InputError:
            found["refused"] += 1
        if number % 50 == 49:
            told(capsys, f"{number + 1} kills while solving: {dict(found)}")
    assert main(COMMAND) == 0
    assert len(mo.load_comparison("out").motions) == 2
    assert not leftovers(tmp_path)
    told(capsys, f"the run after {KILLS} kills while solving is whole")


@pytest.mark.parametrize("name", SIGNALS if MANY else ["SIGTERM"])
def test_a_signal_at_any_instant(tmp_path, capsys, name):
    script = (
        "import sys\nfrom microbot_ocp.cli import _process\n_process.watch()\n"
        "print('ready', file=sys.stderr, flush=True)\n"
        "from microbot_ocp.cli import entry\nsys.exit(entry())"
    )
    found, latest = Counter(), 0.0
    for _ in range(1 + KILLS // 15):
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        child = subprocess.Popen(
            [sys.executable, "-c", script, *COMMAND],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
        )
        assert child.stderr is not None
        assert child.stderr.readline() == "ready\n"
        time.sleep(random.uniform(0.0, 1.5))
        begin = time.perf_counter()
        child.send_signal(getattr(signal, name))
        _, said = child.communicate(timeout=30)
        latest = max(latest, time.perf_counter() - begin)
        assert child.returncode in (SIGNALS[name], 0), said
        assert "Traceback" not in said
        assert not leftovers(tmp_path)
        if (tmp_path / "out/comparison.json").exists():
            mo.load_comparison(tmp_path / "out")
        found[child.returncode] += 1
    told(capsys, f"{name} at any instant: exit codes {dict(found)}, at most {latest:.2f} s later")
