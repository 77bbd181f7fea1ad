"""Calls of everything public with one argument, or all, of a kind that nobody foresaw.

A call ends well with a result or an ``InputError`` of less than 300 characters; the ``TypeError``
of a call that does not fit the signature is Python's own. All else is *foreign*.
"""

import contextlib
import enum
import importlib
import inspect
import re
import signal
import time
import traceback
import warnings
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np

import microbot_ocp as mo
from microbot_ocp._base import deadline
from microbot_ocp.ocp.transcription import Guess

PAGES = Path(__file__).parents[2] / "docs/api"  # what is public
# what asks for a screen, a browser or a terminal, or changes the process
LEFT_OUT = {"show", "register_view", "fit_capsules", "TimeOptimalSliders", "figure_of", "Writer"}
LEFT_OUT |= {"Recording", "SolutionRecording", "file_writer", "IterationRecorder"}
SLOW = 10.0  # s of processor time
KNOWN = (mo.InputError, KeyError, StopIteration)  # a name that is not there is a KeyError


def public():
    """Name and callable of everything public: functions, classes, methods of what there is."""
    found = {}
    for page in sorted(PAGES.glob("*.md")):
        for path in re.findall(r"^::: (\S+)", page.read_text("utf-8"), re.MULTILINE):
            face, _, name = path.rpartition(".")
            with contextlib.suppress(ImportError, AttributeError):
                thing = getattr(importlib.import_module(face), name)
                kind = thing if inspect.isclass(thing) else object
                odd = issubclass(kind, enum.Enum | BaseException)
                if callable(thing) and not (odd or getattr(thing, "_is_protocol", False)):
                    found[path.removeprefix("microbot_ocp.")] = thing
    found = {k: v for k, v in found.items() if k.rpartition(".")[2] not in LEFT_OUT}
    seen, unique = set(), {}
    for name, thing in found.items():
        if id(thing) not in seen:
            seen.add(id(thing))
            unique[name] = thing
    for thing in things().values():
        kind = type(thing)
        if not kind.__module__.startswith("microbot_ocp"):
            continue
        for name, _ in inspect.getmembers(kind, callable):
            owner = next(base for base in kind.__mro__ if name in vars(base))
            if not owner.__module__.startswith("microbot_ocp"):  # of symbols, which are CasADi's
                continue
            if not name.startswith("_") or name == "__call__":
                with contextlib.suppress(Exception):
                    unique[f"{kind.__name__}.{name}"] = getattr(thing, name)
    return {k: v for k, v in unique.items() if _signature(v) is not None}


def _signature(thing):
    try:
        return inspect.signature(thing)
    except (TypeError, ValueError):
        return None


def declared():
    """A problem that calls may change, with a phase and an expression of it."""
    problem = mo.ocp.OptimalControlProblem("double integrator")
    phase = problem.phase("move", duration=(0.1, 10.0))
    x = phase.state("x", initial=0.0, final=1.0, unit="m")
    v = phase.state("v", initial=0.0, final=0.0, unit="m/s")
    u = phase.control("u", lower=-1.0, upper=1.0, unit="N")
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.end_cost(phase.duration)
    return {"problem": problem, "phase": phase, "expression": x}


_things = {}


def things():
    """A good value by the name of a parameter."""
    if _things:
        return _things
    robot = mo.load_robot("microbot")
    via = np.radians([[0.0, 0.0, 0.0], [-90.0, 90.0, 90.0]])
    shape = mo.quintic(via, [0.0, 2.0])
    motion = mo.Motion.from_polynomial(robot, shape, label="a motion")
    known = declared()
    problem = known["problem"]
    solution = mo.ocp.solve(problem, 5)
    comparison = mo.compare(robot, via, ["cubic"])
    simulation = mo.simulate(robot, q0=via[0], t=[0.0, 0.1])
    tracking = mo.track(robot, shape, mo.ComputedTorque(kp=100.0), duration=0.05)
    _things.update(
        robot=robot,
        plant=robot,
        via_q=via,
        via_t=[0.0, 2.0],
        polynomial=shape,
        path=shape,
        make_motion=shape,
        shape=shape,
        motion=motion,
        solution=solution,
        comparison=comparison,
        certificate=comparison.certificates["cubic"],
        scaled=mo.shortest_duration(robot, shape),
        simulation=simulation,
        tracking=tracking,
        ik=mo.solve_ik(robot, [3, -1, 4.5]),
        ik_path=mo.follow_ik(robot, [[3, -1, 4.5]]),
        controller=mo.ComputedTorque(kp=100.0),
        limits=robot.limits,
        limit=mo.limits.tool_speed(1.0),
        link=robot.links[0],
        position=[3.0, -1.0, 4.5],
        positions=[[3.0, -1.0, 4.5]],
        q=via[0],
        q0=via[0],
        t=[0.0, 0.1],
        blend_time=0.2,
        name="name",
        label="label",
        rate=100.0,
        guess=Guess(1.0, {}),
        timing=mo.planning.time_path(robot, shape),
        table=comparison.table(),
        mesh=5,
        time=0.5,
        times=[0.0, 0.5],
        value=1.0,
        upper=1.0,
        solver=mo.ocp.ParametricSolver(problem, 5),
        transcription=mo.ocp.Transcription(problem),
        **known,
    )
    return _things


def _unprintable():
    class Odd:
        def __repr__(self):
            raise RuntimeError("no repr")

    return Odd()


def _deep():
    value = []
    for _ in range(5000):
        value = [value]
    return value


BAD = [
    lambda: None, lambda: True, lambda: 0, lambda: 3, lambda: -1, lambda: 10**400, lambda: 2.5,
    lambda: float("nan"), lambda: float("inf"), lambda: -1e308, lambda: 1e-320, lambda: 1j,
    lambda: "", lambda: "text", lambda: "x" * 5000, lambda: "a\0b", lambda: b"bytes", list, dict,
    tuple, set, lambda: [1, 2], lambda: [[1, 2], [3]], lambda: ["a"], lambda: [None],
    lambda: [[1j, 0, 0], [0, 1, 2]], lambda: {"a": 1}, lambda: {1: None}, object, _unprintable,
    lambda: lambda *a, **k: None, lambda: range(3), _deep,
    lambda: Path("nowhere/x"), lambda: np.array([1j, 2]), lambda: np.array(["a"]),
    lambda: np.array([object()]), lambda: np.zeros((0, 3)), lambda: np.zeros((2, 3, 4)),
    lambda: np.full((2, 3), np.nan), lambda: np.array(5), lambda: np.float32(0.5),
    lambda: np.bool_(True), lambda: np.datetime64("2020-01-01"), lambda: memoryview(b"ab"),
    lambda: ca.SX.sym("s"), lambda: ca.MX.sym("m", 2), lambda: ca.DM([1, 2]), lambda: iter([1]),
    lambda: (x for x in "ab"), lambda: re.compile("a"), lambda: ..., lambda: mo.Status.SOLVED,
    lambda: np.ma.masked, lambda: [float("nan")] * 3, lambda: (1, 2, 3, 4, 5), lambda: "nan",
    lambda: [np.inf, -np.inf, 0.0], lambda: {"q": [1]}, lambda: things()["robot"],
    lambda: things()["motion"], lambda: things()["polynomial"], lambda: things()["solution"],
    lambda: things()["problem"], lambda: things()["limits"], lambda: things()["comparison"],
]  # fmt: skip


def call(function, picked, places=None):
    """Arguments for a call: good ones where they are known, bad ones at ``places`` (all: None)."""
    named, positional = {}, []
    for index, (name, parameter) in enumerate(_signature(function).parameters.items()):
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        bad = places is None or index in places
        if not bad and parameter.default is not parameter.empty:
            continue
        value = picked(index) if bad or name not in things() else things()[name]
        if parameter.kind is parameter.POSITIONAL_ONLY:
            positional.append(value)
        else:
            named[name] = value
    return positional, named


class Hang(BaseException):
    """What takes too long."""


@contextlib.contextmanager
def not_long(seconds=SLOW):
    """Raise :class:`Hang` after so much processor time, or six times that by the clock."""

    if not hasattr(signal, "setitimer"):  # Windows
        yield
        return

    def late(*_):
        raise Hang

    timers = {
        signal.ITIMER_PROF: (signal.SIGPROF, seconds),
        signal.ITIMER_REAL: (signal.SIGALRM, 6 * seconds),
    }
    before = {number: signal.signal(number, late) for number, _ in timers.values()}
    for timer, (_, span) in timers.items():
        signal.setitimer(timer, span)
    try:
        yield
    finally:
        for timer in timers:
            signal.setitimer(timer, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


def outcome(function, positional, named):
    """None where a call ended well, else what happened: kind, where, message."""

    begin = time.process_time()
    try:
        with (
            not_long(),
            warnings.catch_warnings(),
            deadline.within(0.05),
            contextlib.suppress(StopIteration),
        ):
            warnings.simplefilter("ignore")
            function(*positional, **named)
    except KNOWN as problem:
        if isinstance(problem, mo.InputError) and len(str(problem)) >= 300:
            return "long message", "", str(problem)[:400]
    except Hang:
        return "hang", traceback.format_exc()[-800:], ""
    except TypeError as problem:
        frames = traceback.extract_tb(problem.__traceback__)
        own = [
            f
            for f in frames
            if "microbot_ocp" in f.filename and not f.filename.endswith(("_types.py", "/border.py"))
        ]
        if (own and "argument" not in str(problem)) or len(own) > 1:
            return "TypeError", f"{own[-1].filename}:{own[-1].lineno}", str(problem)[:300]
    except BaseException as problem:
        frames = traceback.extract_tb(problem.__traceback__)
        own = [f for f in frames if "src/microbot_ocp" in f.filename]
        where = f"{own[-1].filename}:{own[-1].lineno}" if own else str(frames[-1])
        return type(problem).__name__, where, str(problem)[:300]
    if time.process_time() - begin > SLOW:
        return "slow", "", f"{time.process_time() - begin:.1f} s"
    return None


@cache
def callables():
    """What :func:`public` finds, once."""
    return list(public().items())


def random_call(draw):
    """One call with bad values at random places: None, or (name, kind, where, message, named)."""
    name, function = draw.choice(callables())
    size = len(_signature(function).parameters)
    places = {i for i in range(size) if draw.random() < 0.4} or None
    if name.startswith(("Phase.", "OptimalControlProblem.")):  # which the calls before changed
        things().update(declared())
        kind, _, method = name.partition(".")
        function = getattr(things()["phase" if kind == "Phase" else "problem"], method)
    positional, named = call(function, lambda _: draw.choice(BAD)(), places)
    found = outcome(function, positional, named)
    return None if found is None else (name, *found, repr(sorted(named))[:100])
