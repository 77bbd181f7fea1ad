"""Optimal-control problems with published optima: published cost, our cost, iterations and time.

Every problem is solved by two schemes and by every solver; the statements are in
``tests/external/published_problems.py``. An optimum counts as met if, for every scheme, at least
one solver reaches it; runs that miss it are shown. The SQP method, intended for small programs, is
stopped after some seconds.

    python problems/10_published_optima.py --only robot_arm
    python problems/10_published_optima.py --by-solver --solver fatrop ipopt sqp
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from microbot_ocp import InputError
from microbot_ocp.ocp import Solution, Status

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from external.published_problems import PROBLEMS, PublishedProblem

COLUMNS = ("problem", "optimum", "scheme", "mesh", "solver", "ours", "error", "iterations", "time")


@dataclass(frozen=True)
class Run:
    """Run of one problem by one scheme and one solver."""

    problem: PublishedProblem
    scheme: str
    mesh: int
    solver: str
    solution: Solution

    @property
    def error(self) -> float:
        return self.problem.error(self.solution)

    @property
    def met(self) -> bool:
        return self.solution.status.solved and self.error <= self.problem.tolerance

    @property
    def verdict(self) -> str:
        if self.solution.status.solved:
            return f"{self.error:.1e}"
        stopped = self.solution.status is Status.INTERRUPTED
        said = "stopped" if stopped else self.solution.status
        return f"{self.error:.1e} {said}"

    @property
    def iterations(self) -> int:
        return sum(attempt.iterations for attempt in self.solution.attempts)

    @property
    def seconds(self) -> float:
        spent = sum(a.wall_time + a.create_time for a in self.solution.attempts)
        return spent + self.solution.build_time


def solve_all(problem: PublishedProblem, options: argparse.Namespace) -> list[Run]:
    """Solve one problem by every scheme and every solver."""
    runs = []
    for scheme in options.scheme:
        for solver in options.solver:
            until = time.perf_counter() + options.most_time

            def watch(_: object, until: float = until) -> None:
                if time.perf_counter() > until:
                    raise KeyboardInterrupt

            mesh = options.mesh or problem.mesh
            progress = watch if solver == "sqp" else None
            solution = problem.solve(scheme, solver, mesh, progress=progress)
            runs.append(Run(problem, scheme, mesh, solver, solution))
    return runs


def long_table(runs: list[Run]) -> Table:
    """Return a table with one row for every run."""
    table = Table(*COLUMNS, title="Published optima")
    for run, before in zip(runs, [None, *runs[:-1]], strict=True):
        first = before is None or before.problem is not run.problem
        if first and table.rows:
            table.rows[-1].end_section = True
        table.add_row(
            run.problem.name if first else "",
            f"{run.problem.optimum:.9g}" if first else "",
            run.scheme,
            str(run.mesh),
            run.solver,
            f"{run.problem.sign * run.solution.cost:.8f}",
            run.verdict,
            str(run.iterations),
            f"{run.seconds:.2f} s",
            style=None if run.met else "yellow",
        )
    return table


def table_by_solver(runs: list[Run], solvers: list[str]) -> Table:
    """Return a table with a row for every problem and scheme and a column for every solver."""
    table = Table("problem", "source", "scheme", "mesh", "ours", "error", *solvers)
    table.title = "Published optima: iterations and time by solver"
    cases = dict.fromkeys((run.problem.name, run.scheme) for run in runs)
    for name, scheme in cases:
        own = [run for run in runs if (run.problem.name, run.scheme) == (name, scheme)]
        best = min(own, key=lambda run: (not run.met, run.error))
        cells = [f"{r.iterations}, {r.seconds:.2f} s" if r.met else missed(r) for r in own]
        table.add_row(
            name,
            f"{best.problem.optimum:.9g}",
            scheme,
            str(best.mesh),
            f"{best.problem.sign * best.solution.cost:.8f}",
            best.verdict,
            *cells,
            style=None if best.met else "red",
        )
    return table


def missed(run: Run) -> str:
    """Return the cell of a solver that missed the optimum: its status and time."""
    status = run.solution.status
    what = "stopped" if status is Status.INTERRUPTED else status
    return f"[yellow]{'missed' if status.solved else what}, {run.seconds:.1f} s[/yellow]"


def main() -> int:
    names = [problem.name for problem in PROBLEMS]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="NAME")
    parser.add_argument("--scheme", nargs="+", default=["radau", "hermite_simpson"])
    parser.add_argument("--solver", nargs="+", default=["fatrop", "ipopt"])
    parser.add_argument("--mesh", type=int, help="intervals a phase instead of each problem's own")
    parser.add_argument("--by-solver", action="store_true", help="one column for every solver")
    parser.add_argument("--most-time", type=float, default=10.0, help="of the SQP method, s")
    options = parser.parse_args()
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 160)
    chosen = [problem for problem in PROBLEMS if problem.name in options.only]
    try:
        runs = [run for problem in chosen for run in solve_all(problem, options)]
    except InputError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 2
    by_solver = table_by_solver(runs, options.solver) if options.by_solver else None
    console.print(by_solver or long_table(runs))
    for problem in chosen:
        printed = f", printed as {problem.printed}" if problem.printed else ""
        console.print(f"{problem.name}: {problem.statement}. {problem.source}{printed}.")
    cases = dict.fromkeys((run.problem.name, run.scheme) for run in runs)
    met = {(run.problem.name, run.scheme) for run in runs if run.met}
    missing = list(dict.fromkeys(name for name, scheme in cases if (name, scheme) not in met))
    console.print(f"missed: {', '.join(missing)}" if missing else f"{len(chosen)} optima met")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
