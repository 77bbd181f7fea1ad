"""Every problem in child processes, and the table of the results.

    python -m benchmarks suite [--only NAME ...] [--ways solve refined peer] [--scheme SCHEME]
        [--controls SHAPE] [--mesh INTERVALS] [--limit SECONDS] [--jobs N] [--json FILE]
        [--read FILE] [--markdown]

Errors are relative to the optimum in the table of problems. An answer counts as met if it is within
0.1 %, whatever its status; as a wrong success if it is reported as solved and is not met. A child
that uses up its limit of processor time is ended and counts as a timeout.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from benchmarks.suite.child import WAYS
from benchmarks.suite.problem import SuiteProblem
from benchmarks.suite.table import BY_NAME, PROBLEMS
from microbot_ocp._base.system import signals

MET = 1e-3  # relative error of an answer that counts as met
PATIENCE = 10  # wall time that a child may take, as a multiple of its processor time limit
TIMEOUT = "TIMEOUT"
ENDED = tuple(-number for number in signals("SIGXCPU", "SIGKILL"))
Result = Mapping[str, Any]


def run_child(name: str, way: str, options: argparse.Namespace) -> Result:
    """Solve one problem in one way; a missing answer is a status."""
    command = [sys.executable, "-m", "benchmarks.suite.child", name, way]
    command += ["--limit", str(options.limit)]
    if way != "peer" and options.scheme:
        command += ["--scheme", options.scheme]
    if options.controls:
        command += ["--controls", options.controls]
    if options.mesh:
        command += ["--mesh", str(options.mesh)]
    single = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **single},
    ) as child:
        try:
            said, complaint = child.communicate(timeout=PATIENCE * options.limit)
        except subprocess.TimeoutExpired:
            child.kill()
            child.communicate()
            return _nothing(TIMEOUT, options.limit)
    if child.returncode in ENDED:
        return _nothing(TIMEOUT, options.limit)
    lines = [line for line in said.splitlines() if line.startswith("{")]
    if child.returncode or not lines:
        last = complaint.strip().splitlines()[-1:] or [""]
        return _nothing(f"ended with {child.returncode}: {last[0]}", 0.0)
    return json.loads(lines[-1])


def _nothing(status: str, seconds: float) -> Result:
    return {"cost": None, "solved": False, "status": status, "iterations": 0, "seconds": seconds}


def error(problem: SuiteProblem, result: Result) -> float | None:
    """Return the relative error; None without a number."""
    cost = result["cost"]
    return None if cost is None or cost != cost else problem.error(cost)


def met(problem: SuiteProblem, result: Result) -> bool:
    off = error(problem, result)
    return off is not None and off <= MET


def verdict(problem: SuiteProblem, result: Result) -> str:
    """Return one cell: error, status if not solved, and a mark of a wrong success."""
    off = error(problem, result)
    number = "" if off is None else f"{off:.1e}"
    if result["solved"]:
        return number if met(problem, result) else f"{number} WRONG"
    return f"{number} {result['status']}".strip()


def cells(problem: SuiteProblem, way: str, result: Result) -> list[str]:
    """Return the cells of one way: value, verdict, gap relative to the cost, iterations, time."""
    cost = result["cost"]
    value = "" if cost is None else f"{problem.sign * cost:.7g}"
    seconds = f"{result['seconds']:.1f} s"
    found = [value, verdict(problem, result)[:40], str(result["iterations"]), seconds]
    if way != "peer":
        gap = result.get("gap")
        found.insert(2, "" if gap is None else f"{gap:.0e}")
    return found[1:] if way == "peer" else found


HEADS = {
    "solve": ["solve", "error", "gap", "iterations", "time"],
    "refined": ["refined", "error", "gap", "iterations", "time"],
    "peer": ["Opti, error", "iterations", "time"],
}
WIDTHS = {"solve": [13, 28, 6, 6, 8], "refined": [13, 28, 6, 6, 8], "peer": [28, 6, 8]}


def as_lines(
    rows: Iterable[tuple[SuiteProblem, Mapping[str, Result]]], ways: Iterable[str]
) -> Iterator[str]:
    """Yield the table in plain text, line by line."""
    ways = tuple(ways)
    yield _aligned(["problem", "optimum"], [c for w in ways for c in HEADS[w]], ways)
    for problem, results in rows:
        found = [c for way in ways for c in cells(problem, way, results[way])]
        yield _aligned([problem.name, f"{problem.optimum:.9g}"], found, ways)


def _aligned(first: list[str], rest: list[str], ways: tuple[str, ...]) -> str:
    widths = [w for way in ways for w in WIDTHS[way]]
    padded = [cell.ljust(w) for cell, w in zip(rest, widths, strict=True)]
    return f"{first[0]:28s} {first[1]:13s} " + " ".join(padded).rstrip()


def as_markdown(table: Mapping[str, Mapping[str, Result]], ways: Iterable[str]) -> str:
    """Return the table as Markdown, with the kind of every problem."""
    ways = tuple(ways)
    heads = ["problem", "kind", "optimum", *(c for w in ways for c in HEADS[w])]
    lines = [heads, ["---"] * len(heads)]
    for name, results in table.items():
        problem = BY_NAME[name]
        found = [c for way in ways for c in cells(problem, way, results[way])]
        lines.append([f"`{name}`", problem.kind, f"{problem.optimum:.9g}", *found])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def counts(table: Mapping[str, Mapping[str, Result]], way: str) -> str:
    """Return the last line of one way."""
    found = [(BY_NAME[name], results[way]) for name, results in table.items()]
    good = sum(met(p, r) for p, r in found)
    sure = sum(met(p, r) and r["solved"] for p, r in found)
    wrong = sum(r["solved"] and not met(p, r) for p, r in found)
    stopped = sum(r["status"] == TIMEOUT for _, r in found)
    name = {"solve": "ocp.solve", "refined": "ocp.solve to 1e-6", "peer": "Opti"}[way]
    return (
        f"{name}: {good} of {len(found)} within 0.1 % ({sure} of them reported as solved), "
        f"{wrong} wrong successes, {stopped} timeouts"
    )


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks suite", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=sorted(BY_NAME))
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--scheme", help="of ocp.solve; default: its own")
    parser.add_argument("--controls", metavar="SHAPE", help="of all; default: constant")
    parser.add_argument("--mesh", type=int, help="intervals a phase; default: theirs, Opti 50")
    parser.add_argument("--limit", type=int, default=60, help="processor time of a child, s")
    parser.add_argument("--jobs", type=int, default=2, help="children at once")
    parser.add_argument("--json", type=Path, metavar="FILE", help="everything that was found")
    parser.add_argument("--read", type=Path, metavar="FILE", help="print an earlier --json again")
    parser.add_argument("--markdown", action="store_true", help="as it stands in the documentation")
    options = parser.parse_args(arguments)
    chosen = [p for p in PROBLEMS if not options.only or p.name in options.only]
    if options.read is not None:
        known = json.loads(options.read.read_text())
        table = {p.name: known[p.name] for p in chosen if p.name in known}
        shown = ((BY_NAME[name], results) for name, results in table.items())
    else:
        table = {}
        shown = _solved(chosen, options, table)
    for text in as_lines(shown, options.ways):
        if not options.markdown:
            print(text, flush=True)
    if options.markdown:
        print(as_markdown(table, options.ways))
    print()
    for way in options.ways:
        print(counts(table, way))


def _solved(
    chosen: Iterable[SuiteProblem],
    options: argparse.Namespace,
    table: dict[str, Mapping[str, Result]],
) -> Iterator[tuple[SuiteProblem, Mapping[str, Result]]]:
    """Yield problems in their order as their children finish, and fill the table."""
    with ThreadPoolExecutor(options.jobs) as pool:
        waiting = [
            (p, {w: pool.submit(run_child, p.name, w, options) for w in options.ways})
            for p in chosen
        ]
        for problem, jobs in waiting:
            table[problem.name] = {way: job.result() for way, job in jobs.items()}
            if options.json is not None:
                options.json.write_text(json.dumps(table, indent=1))
            yield problem, table[problem.name]


if __name__ == "__main__":
    main()
