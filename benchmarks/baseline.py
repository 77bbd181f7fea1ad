"""Record of the package's answers, and its comparison with an earlier record.

    python -m benchmarks baseline --out FILE [--only GROUP ...] [--count N] [--jobs 2]
    python -m benchmarks baseline --out FILE --against EARLIER
    python -m benchmarks baseline --out FILE --without "by fatrop" --against EARLIER
    python -m benchmarks baseline --out FILE --without planning.search._refinement.FAR_BARRIER=0.1
    python -m benchmarks baseline --ledger FILE [--markdown]

Groups: the demo's methods, the suite of published problems by ``solve`` without and with an
accuracy, random tasks by seed, scenes with obstacles, cells, switching times, and the arms of the
table of speeds. Every case is solved in its own process and writes a line of JSON to FILE (cost or
duration, status, verdict of its certificate, processor time, a digest of the answer's bits). A run
that was interrupted continues with the cases missing in FILE. ``--against`` prints the changes and
exits with 1 if an answer got worse by more than 1e-4, a certificate was lost, or the processor time
of a group grew by more than a tenth. ``--ledger`` prints for each strategy its runs, the answers
that came from it, its time, and the cases that needed it if they are few; ``--markdown`` prints
this table for the documentation. ``--without`` removes a strategy from the tables, or sets a number
of a module; only cases that ran the strategy in EARLIER are solved (all of them
for a number).
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import course_report
import microbot_ocp as mo
from benchmarks import arms, cell, scenes, switching_times, torture
from benchmarks.measure import limit_processor_time
from benchmarks.suite.table import PROBLEMS
from microbot_ocp import ocp
from microbot_ocp._base.deadline import processor_time

WORSE = 1e-4  # relative growth of a cost or duration that is reported
SLOWER = 0.1  # relative growth of a group's processor time that is reported
AIM = 1e-6  # accuracy of the group "refined"
LIMIT = 600  # processor time of a case, s
TASKS, SCENES = 300, 60
FEW = 12  # number of decided cases up to which a strategy's cases are named
SEEDS = 3  # seeds of each class of switching times and of each arm

Row = dict[str, Any]


def of_motion(robot: mo.Robot, motion: mo.Motion, **task: Any) -> Row:
    """Return the record of a motion, with its certificate for the task."""
    arrays = (motion.t, motion.q, motion.qd, motion.qdd, motion.tau)
    return {
        "cost": float(motion.duration),
        "status": str(motion.status),
        "solved": bool(motion.solved),
        "certified": bool(mo.certify(robot, motion, **task).ok),
        "ledger": motion.outcome.ledger.as_dicts() or None,
        "bits": digest(*(a for a in arrays if a is not None)),
    }


def digest(*arrays: Any) -> str:
    """Return a digest of the bits of arrays."""
    state = hashlib.sha256()
    for array in arrays:
        state.update(np.ascontiguousarray(array, dtype=float).tobytes())
    return state.hexdigest()[:16]


def of_problem(name: str, way: str) -> Row:
    """Solve a problem of the suite; return its record with the verdict of ``verify``."""
    problem = next(p for p in PROBLEMS if p.name == name)
    built, guess = problem.build(), None if problem.guess is None else problem.guess()
    solution = ocp.solve(built, guess=guess, accuracy=AIM if way == "refined" else None)
    bits = digest(*(phase[v] for phase in solution.phases for v in phase.values))
    return {
        "cost": float(solution.cost),
        "status": str(solution.status),
        "solved": solution.solved,
        "certified": bool(ocp.verify(built, solution).ok),
        "error": problem.error(solution.cost),
        "ledger": solution.ledger.as_dicts(),
        "bits": bits,
    }


def of_task(seed: str) -> Row:
    """Solve a random task; return its record."""
    task = torture.task_of(int(seed))
    solved = mo.time_optimal if task.path is None else mo.time_optimal_path
    motion = solved(task.robot, task.via if task.path is None else task.path, time_limit=LIMIT / 4)
    row = of_motion(task.robot, motion, via_q=task.via if task.path is None else None)
    return row | {"kind": task.kind}


def of_scene(number: str) -> Row:
    """Solve a task among obstacles; return its record."""
    name, kind = scenes.ROBOTS[int(number) % 5], scenes.KINDS[int(number) // 5 % 4]
    drawn = scenes.draw(name, kind, int(number))
    if drawn is None:
        return {"cost": None, "status": "no task drawn", "solved": True, "certified": True}
    robot, scene, via = drawn
    motion = mo.time_optimal(robot, via, scene=scene, time_limit=LIMIT / 4)
    return of_motion(robot, motion, via_q=via, scene=scene) | {"kind": f"{name}, {kind}"}


def of_demo(method: str) -> Row:
    """Run a method of the demo's comparison; return its record."""
    robot = mo.load_robot("microbot")
    times = {"via_t": course_report.VIA_T, "via_qd": course_report.VIA_QD}
    comparison = mo.compare(robot, course_report.VIA_Q, **times, methods=[method], mesh=200)
    return of_motion(robot, comparison[method].motion, via_q=course_report.VIA_Q)


def of_cell(name: str) -> Row:
    """Return the period of a pick-and-place cycle."""
    robot_name, place = name.split()
    robot, line = mo.load_robot(robot_name), mo.Line(tolerance=0.002)
    stops = cell.with_part(*cell.ARMS[robot_name])
    task: dict[str, Any] = {"segments": [line, None, line, None], "cycle": place != "once"}
    if place == "once":
        task["segments"] = task["segments"][:3]
    if place == "table":
        low = cell.ARMS[robot_name][0] - 0.13
        task["scene"] = mo.Scene([mo.Box([0.4, 1.0, 0.02], [0.5, 0.0, low - 0.01], "table")])
    motion = mo.time_optimal(robot, stops, **task)
    return of_motion(robot, motion, via_q=stops, **task)


def of_switching(name: str) -> Row:
    """Return the exact duration of a random task, or the reason why there is none."""
    arm, family, seed = name.split("/")
    robot, poses = switching_times.task(arm, family, 0, int(seed))
    motion = mo.time_optimal(robot, poses, starts=1, switching_times=True)
    exact = motion.provenance.get("on_a_mesh") is not None
    return of_motion(robot, motion, via_q=poses) | {"exact": exact}


def of_arm(name: str) -> Row:
    """Return the motion of an arm of the table of speeds."""
    what, arm, seed = name.split()
    robot = mo.load_robot(arm)
    if what == "path":
        path = mo.spline(arms.via_points(robot, int(seed), 5), np.arange(5.0))
        return of_motion(robot, mo.time_optimal_path(robot, path))
    via = arms.via_points(robot, int(seed), 3)
    return of_motion(robot, mo.time_optimal(robot, via), via_q=via)


SOLVE: Mapping[str, Callable[[str], Row]] = {
    "demo": of_demo,
    "solve": lambda name: of_problem(name, "solve"),
    "refined": lambda name: of_problem(name, "refined"),
    "tasks": of_task,
    "scenes": of_scene,
    "cells": of_cell,
    "switching": of_switching,
    "arms": of_arm,
}


def names_of(group: str, count: int | None) -> list[str]:
    """Return the names of the cases of a group, evenly thinned to a number of them."""
    names = {
        "demo": lambda: list(mo.tasks.METHODS),
        "solve": lambda: [p.name for p in PROBLEMS],
        "refined": lambda: [p.name for p in PROBLEMS],
        "tasks": lambda: [str(seed) for seed in range(TASKS)],
        "scenes": lambda: [str(number) for number in range(SCENES)],
        "cells": lambda: [f"{arm} {p}" for arm in cell.ARMS for p in ("once", "cycle", "table")],
        "switching": lambda: [
            f"{arm}/{family}/{seed}"
            for arm in switching_times.ARMS
            for family in switching_times.FAMILIES
            for seed in range(SEEDS)
        ],
        "arms": lambda: [f"{w} {arm} {s}" for w, arm in arms.GOALS for s in range(SEEDS)],
    }[group]()
    if count is None or count >= len(names):
        return names
    return [names[k * len(names) // count] for k in range(count)]


def ablate(what: str) -> None:
    """Remove a strategy in this process, or set a number of a module."""
    name, is_number, value = what.partition("=")
    if is_number:
        module, _, number = name.rpartition(".")
        place = importlib.import_module(f"microbot_ocp.{module}")
        setattr(place, number, type(getattr(place, number))(float(value)))
    for strategy in ocp.search.STRATEGIES:
        if strategy.name == name:
            object.__setattr__(strategy, "propose", lambda task, tried: ())


def was_run(row: Row, strategy: str) -> bool:
    """Return True if a case ran a strategy; for a setting, if it has a ledger."""
    entries = row.get("ledger") or ()
    return bool(entries) if "=" in strategy else any(e["strategy"] == strategy for e in entries)


def solved_here(group: str, name: str) -> Row:
    """Return the record of one case, solved in this process."""
    before = processor_time()
    try:
        row = SOLVE[group](name)
    except Exception as problem:  # any exception that a user would see is a result, too
        text = str(problem).partition("\n")[0]
        row = {"cost": None, "status": f"{type(problem).__name__}: {text}", "solved": False}
        row["certified"] = False
    return {"group": group, "name": name, **row, "seconds": processor_time() - before}


def solved_apart(case: tuple[str, str], without: str | None = None) -> Row:
    """Return the record of one case, solved in a process of its own."""
    group, name = case
    command = [sys.executable, "-m", "benchmarks", "baseline", "--case", group, name]
    command += ["--without", without] if without else []
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = ended.stdout.splitlines()
    if lines and lines[-1].startswith("{"):
        return json.loads(lines[-1])
    status = f"ended with {ended.returncode}: {ended.stderr.strip().rpartition(chr(10))[2][:200]}"
    none = {"cost": None, "status": status, "solved": False, "certified": False}
    return {"group": group, "name": name, **none, "seconds": float(LIMIT)}


def read(path: Path) -> dict[tuple[str, str], Row]:
    """Return the records of a file by group and name; the last of a case counts."""
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    rows = [json.loads(line) for line in text.splitlines()]
    return {(row["group"], row["name"]): row for row in rows}


def changes(now: Mapping[Any, Row], before: Mapping[Any, Row]) -> Iterator[tuple[str, bool]]:
    """Yield a line for each change, and True if it is for the worse, group by group."""
    both = [key for key in now if key in before]
    for group in dict.fromkeys(key[0] for key in both):
        cases = [(now[key], before[key]) for key in both if key[0] == group]
        for new, old in cases:
            label = f"{group} {new['name']}"
            lost = [w for w in ("solved", "certified") if old[w] and not new[w]]
            won = [w for w in ("solved", "certified") if new[w] and not old[w]]
            if lost or won:
                words = ", ".join([f"no longer {w}" for w in lost] + [f"now {w}" for w in won])
                yield f"{label}: {words}; {old['status']} -> {new['status']}", bool(lost)
            if new["cost"] is not None and old["cost"] is not None:
                size = max(abs(old["cost"]), np.finfo(float).tiny)
                growth = (new["cost"] - old["cost"]) / size
                if abs(growth) > WORSE:
                    # If only one of two answers is certified, their costs are not comparable.
                    counts = growth > 0 and new["certified"] == old["certified"]
                    yield f"{label}: {old['cost']:.8g} -> {new['cost']:.8g} ({growth:+.2e})", counts
        spent, earlier = (sum(row["seconds"] for row in rows) for rows in zip(*cases, strict=True))
        same = sum(
            bool(new.get("bits")) and new.get("bits") == old.get("bits") for new, old in cases
        )
        counted = [
            sum(row["solved"] and row["certified"] for row in rows)
            for rows in zip(*cases, strict=True)
        ]
        yield (
            (
                f"{group}: {len(cases)} cases, solved and certified {counted[1]} -> {counted[0]}, "
                f"{same} with equal bits, processor time {earlier:.0f} -> {spent:.0f} s "
                f"({spent / max(earlier, 1e-9):.2f} times)"
            ),
            spent > (1.0 + SLOWER) * earlier,
        )


def ledger(path: Path) -> mo.Table:
    """Return the table of all strategies in a file, the one with the largest time first."""
    sums: dict[tuple[str, str], list[float]] = {}
    needed: dict[tuple[str, str], list[str]] = {}
    for (group, name), row in read(path).items():
        for entry in row.get("ledger") or ():
            key = group, entry["strategy"]
            own = sums.setdefault(key, [0, 0, 0, 0, 0.0])
            solves = entry["run"], entry["decided"], entry["iterations"], entry["seconds"]
            own[:] = [a + b for a, b in zip(own, (1, *solves), strict=True)]
            needed.setdefault(key, []).extend([name] if entry["decided"] else [])
    heads = (mo.Column(head, left=True) for head in ("group", "strategy"))
    counts = (mo.Column(head) for head in ("cases", "run", "decided", "iterations"))
    columns = [*heads, *counts, mo.Column("time", "s", ".1f"), mo.Column("needed by", left=True)]
    rows = [
        (*key, *own, ", ".join(needed[key]) if len(needed[key]) <= FEW else "")
        for key, own in sorted(sums.items(), key=lambda item: -item[1][-1])
    ]
    return mo.Table(columns, rows)


def main(arguments: Sequence[str]) -> None:
    """Solve the cases that FILE does not hold, and compare."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks baseline",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, default=Path("out/baseline.jsonl"))
    parser.add_argument("--only", nargs="+", choices=SOLVE, default=list(SOLVE), metavar="GROUP")
    parser.add_argument("--count", type=int, help="cases of each group; default: all")
    parser.add_argument("--names", nargs="+", help="these cases only")
    parser.add_argument("--jobs", type=int, default=2, help="processes at once")
    parser.add_argument("--against", type=Path, metavar="EARLIER")
    parser.add_argument("--without", metavar="WHAT", help="a strategy, or setting=value")
    parser.add_argument("--case", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--ledger", type=Path, metavar="FILE", help="print what FILE tells")
    parser.add_argument("--markdown", action="store_true", help="print it as markdown")
    options = parser.parse_args(arguments)
    if options.ledger:
        table = ledger(options.ledger)
        print(table.markdown() if options.markdown else table)
        return
    if options.case:
        limit_processor_time(LIMIT, LIMIT + 5)
        if options.without:
            ablate(options.without)
        print(json.dumps(solved_here(*options.case)))
        return
    options.out.parent.mkdir(parents=True, exist_ok=True)
    rows = read(options.out)
    cases = [(group, name) for group in options.only for name in names_of(group, options.count)]
    if options.names:
        cases = [case for case in cases if case[1] in options.names]
    if options.without:
        earlier = read(options.against)
        cases = [c for c in cases if c in earlier and was_run(earlier[c], options.without)]
    todo = [case for case in cases if case not in rows]
    with ThreadPoolExecutor(options.jobs) as pool, options.out.open("a", encoding="utf-8") as file:
        for row in pool.map(partial(solved_apart, without=options.without), todo):
            rows[row["group"], row["name"]] = row
            file.write(json.dumps(row) + "\n")
            file.flush()
            cost = "none" if row["cost"] is None else f"{row['cost']:.8g}"
            certified = "certified" if row["certified"] else "not certified"
            print(row["group"], row["name"], cost, row["status"], certified, flush=True)
    if options.against is None:
        return
    chosen = {case: rows[case] for case in cases if case in rows}
    worse = False
    for text, bad in changes(chosen, read(options.against)):
        print(("worse  " if bad else "       ") + text)
        worse = worse or bad
    sys.exit(int(worse))
