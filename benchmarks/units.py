"""Problems in unfortunate units, solved with automatic scales and without."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from microbot_ocp.ocp import SolverSettings, solve
from ocp.odd_units import EARTH, GODDARD, goddard_in_si, robot_arm

ARM = 9.14093  # optimum of COPS 3.0, problem 8, s
CASES = {
    "rocket in m, s, kg": (goddard_in_si, lambda cost: 1 - cost / EARTH, GODDARD),
    "arm in its own units": (lambda: robot_arm(1.0, 1.0), lambda cost: cost, ARM),
    "arm in mm, ms": (lambda: robot_arm(1e3, 1e3), lambda cost: cost / 1e3, ARM),
    "arm in km, us": (lambda: robot_arm(1e-3, 1e6), lambda cost: cost / 1e6, ARM),
}


def run(_: int = 0) -> None:
    """Solve each once by Hermite-Simpson on 100 intervals, from the default guess."""
    columns = ("problem", "solver", "scaling", "status", "iterations", "found", "published")
    table = Table(*columns, title="Units and scales")
    for name, (build, figure, published) in CASES.items():
        for solver in ("ipopt", "fatrop"):
            for scaling in ("declared", "auto"):
                settings = SolverSettings(solver=solver, scaling=scaling)
                solution = solve(build(), 100, settings=settings, scheme="hermite_simpson")
                table.add_row(
                    name,
                    solver,
                    scaling,
                    solution.status,
                    str(solution.attempts[-1].iterations),
                    f"{figure(solution.cost):.6g}",
                    f"{published:.6g}",
                )
    Console(width=110).print(table)
