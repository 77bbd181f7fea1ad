"""Recompute the published figures without the package: plain CasADi and IPOPT on fine meshes.

    python -m benchmarks.suite.confirm [NAME ...] [--meshes 50 200 400] [--limit 300] [--scaled]

Every mesh starts from the solution on the previous one. The output is the cost on each mesh, with
the sign of the source, and the distance of the last from the published figure.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

from benchmarks.suite.peer import solve_by_opti
from benchmarks.suite.table import BY_NAME, PROBLEMS

TOLERANCE = 1e-9
OPTIONS = {"max_iter": 3000, "mumps_mem_percent": 4000}


def chain(name: str, meshes: list[int], scaled: bool) -> None:
    """Solve one problem in this process; print a line of JSON per mesh."""
    problem = BY_NAME[name]
    guess = None if problem.guess is None else problem.guess()
    for index, intervals in enumerate(meshes):
        options = {**OPTIONS, "tol": TOLERANCE}
        if index:
            options |= {"mu_init": 1e-3}
        result = solve_by_opti(problem.build(), intervals, guess, options=options, scaled=scaled)
        line = {"intervals": intervals, "cost": result.cost, "status": result.status}
        print(json.dumps({**line, "seconds": result.seconds}), flush=True)
        guess = result.guesses


def confirmed(name: str, meshes: list[int], limit: float, scaled: bool) -> str:
    """Solve one problem in a child process with a time limit; return its line of the report."""
    command = [sys.executable, "-m", "benchmarks.suite.confirm", name, "--here"]
    command += ["--scaled"] if scaled else []
    command += ["--meshes", *map(str, meshes)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        try:
            said, complaint = child.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            child.kill()
            said, complaint = child.communicate()
    problem = BY_NAME[name]
    lines = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
    text = f"{name:28s} published {problem.published:.9g}"
    for line in lines:
        status = "" if line["status"] == "Solve_Succeeded" else f" {line['status']}"
        text += f" | {line['intervals']}: {problem.sign * line['cost']:.9g}{status}"
    if lines:
        last = problem.sign * lines[-1]["cost"]
        text += f" | off {last / problem.published - 1:+.1e}, allowed {problem.tolerance:.0e}"
        if problem.reference is not None:
            text += f", reference {last / problem.reference - 1:+.1e}"
    elif complaint:
        text += " | " + complaint.strip().splitlines()[-1]
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--meshes", nargs="+", type=int, default=[50, 200, 400])
    parser.add_argument("--limit", type=float, default=300.0, help="s, a problem")
    parser.add_argument("--scaled", action="store_true", help="by the size of the guess")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.here:
        chain(options.names[0], options.meshes, options.scaled)
        return
    names = options.names or [problem.name for problem in PROBLEMS]
    with ThreadPoolExecutor(2) as pool:
        jobs = [
            pool.submit(confirmed, name, options.meshes, options.limit, options.scaled)
            for name in names
        ]
        for job in jobs:
            print(job.result(), flush=True)


if __name__ == "__main__":
    main()
