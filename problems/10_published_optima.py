"""Optimal-control problems with published optima: the source's figure, ours, and what it took.

Every problem by two schemes, each by fatrop and by IPOPT; the statements are in
``tests/external/published_problems.py``. An optimum counts as met where every scheme reaches it by
one solver at least; what a solver does not reach is shown.

    python problems/10_published_optima.py --only robot_arm
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from microbot_ocp.checks import InputError

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from external.published_problems import PROBLEMS, PublishedProblem

COLUMNS = ("problem", "optimum", "scheme", "mesh", "solver", "ours", "error", "iterations", "time")


def solve_all(problem: PublishedProblem, options: argparse.Namespace, table: Table) -> bool:
    """Add a row for every scheme and solver; True where every scheme meets the optimum."""
    met = {}
    for scheme in options.scheme:
        for solver in options.solver:
            solution = problem.solve(scheme, solver, options.mesh)
            error, attempt = problem.error(solution), solution.attempts[-1]
            good = solution.status.ok and error <= problem.tolerance
            met[scheme] = met.get(scheme, False) or good
            first = not table.rows or table.rows[-1].end_section
            table.add_row(
                problem.name if first else "",
                f"{problem.optimum:.9g}" if first else "",
                scheme,
                str(options.mesh or problem.mesh),
                solver,
                f"{problem.sign * solution.cost:.8f}",
                f"{error:.1e}" if good else f"{error:.1e} {solution.status.name.lower()}",
                str(attempt.iterations),
                f"{attempt.wall_time + attempt.create_time + solution.build_time:.2f} s",
                style=None if good else "red" if not met[scheme] else "yellow",
            )
    table.rows[-1].end_section = True
    return all(met.values())


def main() -> int:
    names = [problem.name for problem in PROBLEMS]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="NAME")
    parser.add_argument("--scheme", nargs="+", default=["radau", "hermite_simpson"])
    parser.add_argument("--solver", nargs="+", default=["fatrop", "ipopt"])
    parser.add_argument("--mesh", type=int, help="intervals a phase instead of each problem's own")
    options = parser.parse_args()
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 130)
    table = Table(*COLUMNS, title="Published optima")
    chosen = [problem for problem in PROBLEMS if problem.name in options.only]
    try:
        missed = [p.name for p in chosen if not solve_all(p, options, table)]
    except InputError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 2
    console.print(table)
    for problem in chosen:
        printed = f", printed as {problem.printed}" if problem.printed else ""
        console.print(f"{problem.name}: {problem.statement}. {problem.source}{printed}.")
    console.print(f"missed: {', '.join(missed)}" if missed else f"{len(chosen)} optima met")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
