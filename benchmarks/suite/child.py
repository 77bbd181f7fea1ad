"""One problem solved in one way in this fresh process; the last line printed is JSON.

python -m benchmarks.suite.child NAME WAY [--scheme SCHEME] [--controls SHAPE]
    [--mesh INTERVALS] [--limit SECONDS]

The system ends the process after its limit of processor time, because a solver that never returns
cannot be stopped from inside.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from typing import Any

import casadi as ca

from benchmarks.measure import limit_processor_time
from benchmarks.suite.peer import solve_by_opti
from benchmarks.suite.table import BY_NAME
from microbot_ocp import ocp
from microbot_ocp._base.deadline import processor_time

WAYS = ("solve", "refined", "peer")
AIM = 1e-6  # accuracy of the states in the way "refined"
INTERVALS = 50  # default of ocp.solve


def run(
    name: str,
    way: str,
    scheme: str | None = None,
    mesh: int | None = None,
    controls: str | None = None,
) -> dict[str, Any]:
    """Solve the problem; return plain values, in which an exception is a status, too."""
    problem = BY_NAME[name]
    guess = None if problem.guess is None else problem.guess()
    chosen: dict[str, Any] = {"guess": guess}
    chosen |= {} if scheme is None else {"scheme": scheme}
    chosen |= {} if mesh is None else {"mesh": mesh}
    built = problem.build()
    if controls is not None and way != "peer":
        _shape_controls(built, controls)
    begin = processor_time()
    try:
        if way == "peer":
            peer = solve_by_opti(built, mesh or INTERVALS, guess)
            found = {"cost": peer.cost, "solved": peer.solved, "status": peer.status}
            found["iterations"] = peer.iterations
        else:
            chosen |= {"accuracy": AIM} if way == "refined" else {}
            solution = ocp.solve(built, **chosen)
            found = {"cost": solution.cost, "solved": solution.status.solved}
            found["status"] = _words(solution.status)
            found["iterations"] = sum(max(a.iterations, 0) for a in solution.attempts)
            found["gap"] = _relative_gap(solution)
            found["intervals"] = sum(p.mesh.size - 1 for p in solution.phases)
            found["attempts"] = [a.as_dict() for a in solution.attempts]
            found["ledger"] = solution.ledger.as_dicts()
    except Exception as error:  # any exception that a user would see is a result, too
        text = str(error).splitlines()
        found = {"cost": None, "solved": False, "iterations": 0}
        found["status"] = f"{type(error).__name__}: {text[0] if text else ''}"
    return {**found, "seconds": processor_time() - begin}


def _shape_controls(problem: ocp.OptimalControlProblem, shape: str) -> None:
    """Declare every control with another shape."""
    for phase in problem.phases:
        phase.controls = [
            replace(c, shape=shape, rate=ca.MX.sym("rate", c.size) if shape == "linear" else None)
            for c in phase.controls
        ]


def _relative_gap(solution: ocp.Solution) -> float:
    return solution.gap.total / max(abs(solution.cost), 1e-300)


def _words(status: ocp.Status) -> str:
    return status.name.lower().replace("_", " ")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=sorted(BY_NAME))
    parser.add_argument("way", choices=WAYS)
    parser.add_argument("--scheme")
    parser.add_argument("--controls", choices=("constant", "linear", "polynomial"))
    parser.add_argument("--mesh", type=int)
    parser.add_argument("--limit", type=int, default=60, help="processor time, s")
    options = parser.parse_args()
    limit_processor_time(options.limit, options.limit + 1)
    print()
    found = run(options.name, options.way, options.scheme, options.mesh, options.controls)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
