"""One of the three forms in this fresh process: its result and its times.

python -m benchmarks.cops_arm.child NAME FOLDER
"""

from __future__ import annotations

import importlib
import json
import runpy
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
COLOURING = "total_coloring.pkl"


def ours(names: Mapping[str, Any]) -> tuple[bool, float, int, float]:
    solution = names["solution"]
    attempts = solution.attempts
    iterations = sum(attempt.iterations for attempt in attempts)
    seconds = sum(attempt.wall_time for attempt in attempts)
    return solution.status.solved, solution.duration, iterations, seconds


def rockit_form(names: Mapping[str, Any]) -> tuple[bool, float, int, float]:
    solution, stats = names["solution"], names["solution"].stats
    found = float(solution.value(names["ocp"].T))
    return stats["success"], found, stats["iter_count"], stats["t_wall_total"]


def dymos_form(names: Mapping[str, Any]) -> tuple[bool, float, int, float]:
    problem = names["problem"]
    found = float(problem.get_val("trajectory.move.timeseries.time")[-1, 0])
    driver = problem.driver
    return driver.result.success, found, driver.iterations, driver.seconds


READ = {"ours": ours, "rockit_form": rockit_form, "dymos_form": dymos_form}
IMPORTS = {
    "ours": ("casadi", "microbot_ocp.ocp"),
    "rockit_form": ("rockit",),
    "dymos_form": ("dymos", "openmdao.api", "benchmarks.cops_arm.ipopt_driver"),
}


def keep_colouring(folder: Path) -> None:
    """Patch dymos to read the colouring of its Jacobian from the folder, and to keep it there."""
    from benchmarks.cops_arm.ipopt_driver import IpoptDriver

    made = IpoptDriver.declare_coloring

    def declare(driver: IpoptDriver, **options: Any) -> None:
        made(driver, **options)
        if (folder / COLOURING).exists():
            driver.use_fixed_coloring(str(folder / COLOURING))

    IpoptDriver.declare_coloring = declare


def main(name: str, folder: str) -> None:
    for module in IMPORTS[name]:
        importlib.import_module(module)
    if name == "dymos_form":
        keep_colouring(Path(folder))
    else:
        import casadi as ca

        for solver in ("ipopt", "fatrop"):
            ca.load_nlpsol(solver)
    begin = time.perf_counter()
    names = runpy.run_path(str(HERE / f"{name}.py"))
    seconds = time.perf_counter() - begin
    ok, found, iterations, solver = READ[name](names)
    if not ok:
        sys.exit(f"{name} did not converge")
    print()
    print(json.dumps({"found": found, "iterations": iterations, "code": seconds, "solver": solver}))
    for left in Path.cwd().rglob(COLOURING):
        left.rename(Path(folder) / COLOURING)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
