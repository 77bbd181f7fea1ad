"""Times of the parts of a free motion through three random points, for the first time and again.

Each runs in a fresh process, without imports. The table has the shares of the parts below, from the
wall times in the motion's provenance (solves and threads run in parallel, so their sum exceeds the
wall time), and the processor time of all, s. "kernels": derivatives as graphs, their C text and its
compiler. "programs": assembly on each mesh. "solvers made": preparation of solvers. "functions":
values and derivatives that solvers evaluate. "steps": the rest of the solvers, their linear
algebra. Starts, ranking, error estimates and samples are in the processor time only.

``python -m benchmarks phases``, or one line: ``python -m benchmarks.phases ROBOT SEED``.
"""

from __future__ import annotations

import json
import sys
import tempfile

import microbot_ocp as mo
from benchmarks.arms import timed, via_points
from benchmarks.measure import in_fresh_process

ROBOTS = ("microbot", "ur5e", "puma560", "panda")


def child(name: str, seed: int) -> None:
    """Solve one task in a fresh process and print the times of its parts."""
    import casadi as ca

    for solver in ("ipopt", "fatrop"):  # loading a solver counts as an import
        ca.load_nlpsol(solver)
    assert callable(mo.time_optimal)
    robot = mo.load_robot(name)
    motion, (_, processor) = timed(lambda: mo.time_optimal(robot, via_points(robot, seed, 3)))
    solves = motion.provenance["solves"]
    attempts = [attempt for solve in solves for attempt in solve["attempts"]]
    made, functions = (sum(a[key] for a in attempts) for key in ("create_time", "function_time"))
    parts = {
        "kernels": motion.provenance["kernel_time"],
        "programs": sum(solve["build_time"] for solve in solves),
        "solvers made": made,
        "functions": functions,
        "steps": sum(attempt["wall_time"] for attempt in attempts) - functions,
    }
    print(json.dumps({"parts": parts, "processor": processor, "solves": len(solves)}))


def run(repetitions: int = 0) -> None:
    """Run one seed per arm, or more if asked for."""
    names = ("kernels", "programs", "solvers made", "functions", "steps")
    print("  arm       seed  time  " + "".join(f"{name:>13}" for name in names) + "    processor")
    for name in ROBOTS:
        for seed in range(repetitions or 1):
            with tempfile.TemporaryDirectory() as cache:
                for time in ("first", "again"):
                    told = in_fresh_process(__name__, [name, str(seed)], cache)
                    whole = sum(told["parts"].values())
                    shares = "".join(f"{told['parts'][k] / whole:13.0%}" for k in names)
                    end = f"{told['processor']:11.2f} s, {told['solves']} solves"
                    print(f"  {name:10}{seed:<6}{time:6}{shares}{end}", flush=True)


if __name__ == "__main__":
    child(sys.argv[1], int(sys.argv[2]))
