"""What `make fuzz` tries: each case ends with a result or a short InputError.

``python tests/reliability/fuzz.py TARGET COUNT [SEED]`` tries so many cases at random and prints
what came of them; TARGET may be "all". With ``--record FILE`` each piece of 1000 is a line of that
file, and the next run goes on where it ends; ``--minutes`` ends a run between pieces. With
``--atheris`` the cases are those that reach new lines of the package.
"""

import argparse
import contextlib
import copy
import csv
import inspect
import io
import itertools
import json
import os
import random
import re
import sys
import tempfile
import time
import tomllib
import traceback
import warnings
import zipfile
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import typer
from border_calls import Hang, declared, not_long, random_call
from pyarrow.parquet import read_table
from scipy.io import loadmat

import microbot_ocp as mo
from microbot_ocp._base import deadline
from microbot_ocp.cli import main as program
from microbot_ocp.motion import EXPORT_FORMATS
from microbot_ocp.robot.files import robot_text
from microbot_ocp.scene import load_scene
from microbot_ocp.sweeps import load_sweep, read_study
from microbot_ocp.sweeps._study import outcome_columns
from microbot_ocp.tasks import is_cell_file, read_cell, read_task

SLOW = 10.0  # s of processor time
MOST_MEMORY = 1_000_000  # kB that one case may add to the most that was ever taken
PIECE = 1000  # cases of a line of the record
MOST_MESSAGE = 400  # characters: a whole sentence, with what is quoted cut short
VIA = np.radians([[0, 0, 0], [-90, 90, 90]])
ODD = [
    None, True, False, 0, 1, -1, 3, 10**400, 1e308, -1e308, 1e-320, 0.5, float("nan"), float("inf"),
    "", "text", "x" * 5000, "../../x", "/dev/null", "\ud800", "a\0b", [], {}, [[]], [None], ["a"],
    [0.0, 0.0, 0.0], [1e308] * 3, [float("nan")] * 3, [[0, 0, 0], [1, 1, 1]], {"a": 1},
    [[1, 2], [3]], [1, 2, 3, 4, 5, 6, 7], "solved", "cubic", "microbot",
]  # fmt: skip
TASK = """schema = 1
robot = "microbot"
methods = ["cubic", "time_optimal"]
outputs = ["json"]
[via]
q_deg = [[0, 0, 0], [-90, 90, 90]]
t = [0.0, 2.0]
[limits]
qd_max_deg = 90
tau_max = [400, 500, 200]
[settings]
mesh = 20
"""
CELL = """schema = 1
robot = "microbot"
cycle = true
[[stop]]
name = "pick"
q_deg = [0, 20, 10]
payload = { mass = 2.0, center_of_mass = [0.1, 0.0, 0.0] }
dwell = 0.1
[[stop]]
name = "place"
position = [3.0, 1.5, 4.0]
tolerance = 0.05
payload = 0
[[segment]]
after = "place"
kind = "line"
tolerance = 0.01
[scene]
clearance = 0.02
[[scene.obstacle]]
kind = "box"
size = [1, 1, 1]
center = [9, 9, 0]
[settings]
mesh = 20
"""
STUDY = """schema = 1
robot = "microbot"
methods = ["cubic", "time_optimal"]
time_limit = 60.0
[cases]
kind = "random"
count = 100
seed = 0
[quantities]
start_q_deg = { from = [-180, 0, -150], to = [180, 180, 150] }
goal_q_deg = { from = [-180, 0, -150], to = [180, 180, 150] }
payload = { from = 0.0, to = 5.0 }
"""
SCENE = """clearance = 0.02
self_collision = true
ignore = [["elbow", "post"]]
[[obstacle]]
name = "post"
kind = "cylinder"
radius = 0.2
length = 1.0
center = [3, 0, 0]
rotation_deg = [0, 90, 0]
[[obstacle]]
kind = "sphere"
center = [0, 5, 0]
radius = 0.3
[[obstacle]]
kind = "half_space"
normal = [0, 0, 1]
offset = -1.0
[[obstacle]]
kind = "capsule"
start = [1, 2, 3]
end = [1, 2, 4]
radius = 0.1
[[obstacle]]
name = "wedge"
kind = "mesh"
vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
matrix = [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""
WORDS = [
    "", "-", "--", "-1", "0", "1e999", "nan", "inf", "9" * 400, "x" * 5000, "0,0,0", "0,0,0 1,1,1",
    "0,0 1e-9,0", ",,,", "3,-1,4.5", "microbot", "panda", "none.toml", "../x", "/proc", "/dev/null",
    "'", "\udcff", "ä", "1e-320", "0x10", "1_0", "[0]", "{}", "True", "cubic", "1:2",
    "a=b", "\n", "%s",
]  # fmt: skip
COMMANDS = {  # with what makes each end at once
    "fk": ["microbot", "--q-deg", "0,45,30"],
    "ik": ["microbot", "--position", "3,-1,4.5", "--time-limit", "0.05"],
    "show": ["microbot"],
    "robots": [],
    "compare": ["microbot", "--via-deg", "0,0,0 -90,90,90", "--time-limit", "0.02"],
    "time-optimal": ["microbot", "--via-deg", "0,0,0 -90,90,90", "--time-limit", "0.02"],
    "simulate": ["microbot", "--q-deg", "0,30,20", "--time-limit", "0.02"],
    "replay": ["comparison", "--json"],
    "export": ["good.motion", "out.csv"],
    "solve": ["none.toml", "--out", "none/out"],
    "sweep": ["none.toml", "--out", "none/out"],
}


def edited(document, draw):
    """A document with one to three values replaced, removed, repeated or moved."""
    for _ in range(draw.randint(1, 3)):
        places = list(_places(document))
        if not places:
            return copy.deepcopy(draw.choice(ODD))
        holder, key = draw.choice(places)
        way = draw.random()
        if way < 0.15:
            del holder[key]
        elif way < 0.3:
            other, name = draw.choice(places)
            with contextlib.suppress(LookupError):
                holder[key] = json.loads(json.dumps(other[name]))
        elif isinstance(holder[key], int | float) and way < 0.6:
            with contextlib.suppress(OverflowError):  # an integer of 400 digits
                holder[key] = holder[key] * draw.choice([-1, 0, 2, 1e-9, 1e9, 1e200, 0.999])
        else:
            holder[key] = copy.deepcopy(draw.choice(ODD))
    return document


def _places(document):
    entries = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in list(entries):
        yield document, key
        if isinstance(value, dict | list):
            yield from _places(value)


def damaged(content, draw):
    """Bytes with some changed, cut, repeated, or replaced by what has a meaning."""
    data = bytearray(content)
    for _ in range(draw.randint(1, 6)):
        place = draw.randrange(len(data) + 1)
        way = draw.random()
        if way < 0.5 and place < len(data):
            data[place] = draw.randrange(256 if draw.random() < 0.3 else 128)
        elif way < 0.6:
            del data[place : place + draw.randint(1, 40)]
        elif way < 0.7:
            data[place:place] = data[: draw.randint(1, 40)]
        elif way < 0.9:
            numbers = list(re.finditer(rb"-?\d+\.?\d*", data))
            if numbers:
                found = draw.choice(numbers)
                other = ("nan", "inf", "-1", "0", "1e308", "9" * 400, "[]", '"a"', "1e-320")
                data[found.start() : found.end()] = draw.choice(other).encode()
        else:
            data = data[:place]
    return bytes(data)


@cache
def robot():
    return mo.load_robot("microbot")


@cache
def microbot_text():
    return robot_text("microbot", None)


@cache
def problem():
    return declared()["problem"]


@cache
def folder():
    return Path(tempfile.mkdtemp(prefix="fuzz-"))


@cache
def saved(kind):
    """Content of a good file."""
    path = folder() / f"good.{kind}"
    if kind == "motion":
        shape = mo.quintic([[0, 0, 0], [1, 1, 1]], [0, 1])
        mo.Motion.from_polynomial(robot(), shape, label="a").save(path)
    elif kind == "solution":
        mo.ocp.save_solution(mo.ocp.solve(problem(), 40), path)
    elif kind == "comparison":
        mo.compare(robot(), VIA, ["cubic", "lspb"]).save(folder() / "comparison", ("json",))
        path = folder() / "comparison/comparison.json"
    elif kind == "urdf":
        mo.save_robot(robot(), path)
    return path.read_bytes()


@cache
def saved_arrays(kind):
    """What a good archive holds, without the digest."""
    with np.load(io.BytesIO(saved(kind))) as stored:
        return {name: stored[name] for name in stored.files if name != "digest"}


def archive(kind, draw):
    """A damaged archive: its bytes, or what it holds, without the digest that would tell."""
    if draw.random() < 0.3:
        return damaged(saved(kind), draw)
    arrays = dict(saved_arrays(kind))
    metadata = json.loads(str(arrays.pop("metadata")))
    if draw.random() < 0.6:
        metadata = edited(metadata, draw)
    else:
        name = draw.choice(list(arrays))
        value = np.array(arrays[name], dtype=float).clip(-1e8, 1e8)
        if value.size:
            value.flat[draw.randrange(value.size)] = draw.choice([np.nan, np.inf, -1, 0, 1e308])
        changed = draw.choice(
            [value, value[::-1], value[:1], value.ravel(), value * 1e290, value > 0]
        )
        arrays[name] = changed if draw.random() < 0.8 else np.array(draw.choice(["a", 1j, 2]))
    stream = io.BytesIO()
    np.savez(stream, **{**arrays, "metadata": np.array(json.dumps(metadata))})
    content = stream.getvalue()
    if draw.random() < 0.1:
        content = _with_header(content, draw)
    return content


def _with_header(content, draw):
    """An archive with another header of one of its arrays."""
    stream = io.BytesIO()
    shapes = ["(10**9,)", "(1000000000000,)", "(-1,)", "((((((", "(True,)", "(5.5,)", "(1,)" * 500]
    kinds = ["<f8", "|O", "<c16", "<U9", "|V0", "<i8", "<M8[s]"]
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(stream, "w") as new:
        chosen = draw.choice(old.namelist())
        for name in old.namelist():
            data = old.read(name)
            if name == chosen:
                shape, kind = draw.choice(shapes), draw.choice(kinds)
                head = (
                    f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
                )
                data = data[:8] + len(head).to_bytes(2, "little") + head + b"\0" * 80
            new.writestr(name, data)
    return stream.getvalue()


def _file(name, content):
    path = folder() / name
    path.write_bytes(content)
    return path


_held = cache(tomllib.loads)


def toml(text, draw):
    """A damaged TOML file: its text, or what it holds."""
    if draw.random() < 0.3:
        return damaged(text.encode(), draw)
    found = edited(copy.deepcopy(_held(text)), draw)
    if not isinstance(found, dict):
        return repr(found).encode("utf-8", "replace")
    lines = (f"{json.dumps(str(key))} = {_in_toml(value)}" for key, value in found.items())
    return "\n".join(lines).encode("utf-8", "replace")


def _in_toml(value):
    if isinstance(value, dict):
        entries = (f"{json.dumps(str(k))} = {_in_toml(v)}" for k, v in value.items())
        return f"{{ {', '.join(entries)} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_in_toml, value))}]"
    if isinstance(value, float):
        return repr(value)
    return '"none"' if value is None else json.dumps(value)


def motion(draw):
    mo.Motion.load(_file("motion.npz", archive("motion", draw)))


def solution(draw):
    path = _file("solution.npz", archive("solution", draw))
    way = draw.random()
    if way < 0.6:
        mo.ocp.load_solution(path)
    elif way < 0.9:
        mo.ocp.load_solution(path, problem())
    else:
        mo.ocp.repeat(path, problem())


def comparison(draw):
    document = json.loads(saved("comparison"))
    place = folder() / "comparison/comparison.json"
    if draw.random() < 0.9:
        document.pop("digest")
    if draw.random() < 0.2:
        place.write_bytes(damaged(json.dumps(document).encode(), draw))
    else:
        place.write_text(json.dumps(edited(document, draw)))
    mo.load_comparison(place.parent)


def robot_file(draw):
    mo.load_robot(_file("robot.toml", toml(microbot_text(), draw)))


def urdf(draw):
    content = saved("urdf")
    if draw.random() < 0.3:
        content = damaged(content, draw)
    else:
        root = ElementTree.fromstring(content)
        for _ in range(draw.randint(1, 3)):
            _edit_element(draw.choice(list(root.iter())), root, draw)
        content = ElementTree.tostring(root, "utf-8", xml_declaration=True)
    mo.load_robot(_file("robot.urdf", content))


def _edit_element(element, root, draw):
    """Replace an attribute, or remove, repeat or move an element."""
    way = draw.random()
    if way < 0.7 and element.attrib:
        name = draw.choice(sorted(element.attrib))
        texts = ["", "nan", "1e308", "-1", "0", "1 2", "a", "0 0 0 0", "9" * 400, "fixed", "1e-320"]
        others = [other.attrib[name] for other in root.iter() if name in other.attrib]
        element.attrib[name] = draw.choice([*texts, *others])
    elif way < 0.8 and element.attrib:
        del element.attrib[draw.choice(sorted(element.attrib))]
    elif way < 0.9:
        element.append(copy.deepcopy(draw.choice(list(root.iter()))))
    elif len(element):
        element.remove(draw.choice(list(element)))


def task(draw):
    read_task(_file("task.toml", toml(TASK, draw)))


def cell(draw):
    path = _file("cell.toml", toml(CELL, draw))
    (read_cell if is_cell_file(path) else read_task)(path)


def study(draw):
    read_study(_file("study.toml", toml(STUDY, draw)))


def sweep(draw):
    about = {
        "schema": 1, "digest": "a", "version": "1", "origin": "", "robot": "microbot", "count": 10,
        "joints": ["a", "b", "c"], "chunk": 5, "kind": "random", "seed": 0, "quantities": {},
        "varying": [], "methods": ["cubic"], "settings": {}, "time_limit": 60.0, "limits": [],
        "columns": [["case", "int"], *map(list, outcome_columns(["cubic"], []))],
    }  # fmt: skip
    place = folder() / "sweep"
    (place / "cases").mkdir(parents=True, exist_ok=True)
    text = json.dumps(edited(about, draw)).encode()
    (place / "study.json").write_bytes(text if draw.random() < 0.8 else damaged(text, draw))
    repr(load_sweep(place))


def scene(draw):
    load_scene(_file("scene.toml", toml(SCENE, draw)))


def export(draw):
    """A motion in another program's format, read back as that program would."""
    motion, arm = _odd_motion(draw), draw.choice([None, _odd_robot(draw)])
    ending = draw.choice([*EXPORT_FORMATS, *EXPORT_FORMATS, ".npz", "", ".CSV", ".csv.gz", ".gif"])
    rates = [None, 1, 10.0, 333.3, *ODD[:14]]
    path = folder() / f"out{ending}"
    path.unlink(missing_ok=True)
    if ending == ".gif":  # drawing one takes seconds
        arm = None
    motion.export(path, rate=draw.choice(rates), robot=arm)
    content = path.read_bytes()
    if ending == ".csv":
        rows = list(csv.reader(io.StringIO(content.decode(), newline="")))
        assert {len(row) for row in rows} == {13}, "columns"
        assert np.isfinite(np.array(rows[1:], dtype=float)).all()
    elif ending == ".json":
        points = json.loads(content)["points"]
        stamps = [
            p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points
        ]
        assert (np.diff(stamps) > 0).all()
    elif ending == ".mat":
        assert loadmat(io.BytesIO(content))["q"].shape[1] == 3
    elif ending == ".parquet":
        assert read_table(io.BytesIO(content)).num_columns == 13
    else:
        assert ElementTree.fromstring(content).tag == "mujoco"


def _odd_motion(draw):
    """A motion of odd label, times and values."""
    steps = np.array(
        [draw.choice([1e-9, 1e-5, 0.01, 0.1, 1.0]) for _ in range(draw.randint(1, 30))]
    )
    stretch = draw.choice([1, 1, 1e-6] if draw.random() < 0.97 else [100, 1e5, 1e9])
    t = np.append(0.0, np.cumsum(steps)) * stretch
    values = [
        np.array([[draw.choice([0, 1, -2.5, 1e-300, 1e6]) for _ in range(3)] for _ in t])
        for _ in range(4)
    ]
    label = draw.choice(["a", "", "ä <&>\"'", "a\0b", "\ud800", "x" * 5000, "\n\r,;", "\x01"])
    return mo.Motion(t, *values, label=label)


def _odd_robot(draw):
    names = [
        draw.choice(["a", "ä,b", 'q"', "line\nbreak", "<x>", "\x02", "t [s]"]) for _ in range(3)
    ]
    links = [replace(link, name=name) for link, name in zip(robot().links, names, strict=True)]
    return replace(robot(), links=tuple(links))


def border(draw):
    """A call of something public with arguments that nobody foresaw."""
    found = random_call(draw)
    if found is not None:
        raise AssertionError(" | ".join(map(str, found))[:500])


def command(draw):
    """A command of the program with some of its words replaced."""
    name = draw.choice(list(COMMANDS))
    words = list(COMMANDS[name])
    for _ in range(draw.randint(1, 3)):
        place = draw.randrange(len(words) + 1)
        if draw.random() < 0.3:
            words[place:place] = [draw.choice(OPTIONS), draw.choice(WORDS)]
        elif place < len(words):
            words[place] = draw.choice(WORDS)
    said, told = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(told),
        deadline.within(0.05),  # solvers are not what is tried here
    ):
        code = program([name, *words])
    if code not in (0, 1, 2):
        raise AssertionError(f"exit code {code} of {[name, *words]}: {told.getvalue()[:300]}"[:500])
    line = max(map(len, told.getvalue().splitlines()), default=0)
    if line >= MOST_MESSAGE + len("error: "):
        raise AssertionError(f"{line} characters of {[name, *words]}"[:500])


OPTIONS = [
    "--json", "--out", "--robot", "--tip", "--mesh", "--starts", "--qd-max", "--qd-max-deg",
    "--time", "--q-deg", "--via", "--via-deg", "--duration", "--rate", "--time-limit", "--tau-max",
    "--methods", "--case", "--workers", "--summary", "--seed", "--frame", "--position",
    "--rpy-deg", "--all",
]  # fmt: skip
TARGETS = {
    f.__name__: f
    for f in (
        motion,
        solution,
        comparison,
        robot_file,
        urdf,
        task,
        cell,
        study,
        sweep,
        scene,
        export,
        command,
        border,
    )
}


def attempt(target, draw):
    """What is wrong with a case: nothing where it ended well."""

    try:
        with not_long(SLOW), deadline.within(5.0):
            TARGETS[target](draw)
    except mo.InputError as problem:
        if len(str(problem)) >= MOST_MESSAGE:
            return f"a message of {len(str(problem))} characters: {problem}"[:400]
        return "refused"
    except (Hang, Exception) as problem:
        last = [
            f for f in traceback.extract_tb(problem.__traceback__) if "microbot_ocp" in f.filename
        ]
        where = f"{last[-1].filename}:{last[-1].lineno}" if last else ""
        return f"{type(problem).__name__}: {str(problem)[:300]} {where}"
    return ""


def peak_memory():
    """The largest memory of this process so far, kB; 0 on Windows, which does not say it."""
    try:
        import resource
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak // 1024 if sys.platform == "darwin" else peak


def series(target, count, seed=0, tell=None, first=0):
    """Counts of what came of so many cases, and a list of (number of the case, what was wrong)."""
    found, wrong = Counter(), []
    for case in range(first, first + count):
        most = peak_memory()
        outcome = attempt(target, random.Random(f"{target} {seed} {case}"))
        more = peak_memory() - most
        if outcome in ("", "refused") and more > MOST_MEMORY:
            outcome = f"took {more} kB"
        kind = {"": "done", "refused": "refused"}.get(outcome, "wrong")
        found[kind] += 1
        if kind == "wrong":
            wrong.append((case, outcome))
            if tell is not None:
                tell(f"{target} {seed} {case}: {outcome}")
    return found, wrong


def recorded(target, seed, record):
    """How many cases of a target a record has."""
    lines = record.read_text().splitlines() if record.exists() else []
    known = [
        line for line in map(json.loads, lines) if (line["target"], line["seed"]) == (target, seed)
    ]
    return sum(line["cases"] for line in known)


def goes_on(target, count, seed, record, until):
    """Try a target piece by piece from where its record ends; whether a case was wrong."""
    first, bad = recorded(target, seed, record), False
    while first < count and time.monotonic() < until:
        begin, size = time.process_time(), min(PIECE, count - first)
        found, wrong = series(target, size, seed, lambda text: print(text, flush=True), first)
        line = {"target": target, "seed": seed, "first": first, "cases": size, **found}
        line |= {"seconds": round(time.process_time() - begin, 2), "cases_that_were_wrong": wrong}
        with record.open("a") as stream:
            stream.write(json.dumps(line) + "\n")
        first, bad = first + size, bad or bool(wrong)
    print(f"{target}: {first} of {count} cases", flush=True)
    return bad


class _Bytes(random.Random):
    """Draws of the bytes that a fuzzer gives."""

    def __init__(self, data):
        super().__init__(0)
        self._data = io.BytesIO(data)

    def random(self):
        return int.from_bytes(self._data.read(2).ljust(2, b"\0"), "little") / 65536

    def getrandbits(self, count):
        size = (count + 7) // 8
        return int.from_bytes(self._data.read(size).ljust(size, b"\0"), "little") >> (
            8 * size - count
        )


def guided(target, count, minutes):
    """Cases that atheris chooses, which reach new lines of the package; it ends the process."""
    import atheris

    tried = itertools.count(1)

    def one(data):
        if (number := next(tried)) % PIECE == 0:
            print(f"{target}: {number} cases by atheris", flush=True)
        outcome = attempt(target, _Bytes(data))
        if outcome not in ("", "refused"):
            raise AssertionError(outcome)

    attempt(target, random.Random(0))  # loads what it needs
    for name, module in list(sys.modules.items()):
        if name.startswith("microbot_ocp."):
            for key, value in list(vars(module).items()):
                if getattr(value, "__module__", "") == name and inspect.isfunction(value):
                    with contextlib.suppress(Exception):
                        setattr(module, key, atheris.instrument_func(value))
    options = [f"-atheris_runs={count}", "-max_len=400", "-verbosity=0"]
    if np.isfinite(minutes):
        options.append(f"-max_total_time={max(1, round(60 * minutes))}")
    atheris.Setup([sys.argv[0], *options], one)
    atheris.Fuzz()


def main():
    """Exit code 1 where a case was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("target", choices=[*TARGETS, "all"])
    parser.add_argument("count", type=int)
    parser.add_argument("seed", nargs="?", default="0")
    parser.add_argument("--record", type=Path)
    parser.add_argument("--minutes", type=float, default=np.inf)
    parser.add_argument("--atheris", action="store_true")
    given = parser.parse_args()
    record = (given.record or folder() / "record.jsonl").absolute()
    until = time.monotonic() + 60 * given.minutes
    names = list(TARGETS) if given.target == "all" else [given.target]
    os.chdir(folder())
    typer.main.get_command = cache(typer.main.get_command)  # else a third of each command's time
    warnings.simplefilter("ignore")
    if given.atheris:
        return guided(given.target, given.count, given.minutes)
    return int(max([goes_on(name, given.count, given.seed, record, until) for name in names]))


if __name__ == "__main__":
    sys.exit(main())
