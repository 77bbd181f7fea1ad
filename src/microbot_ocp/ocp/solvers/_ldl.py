"""Linear solvers for IPOPT: two without pivoting, and a check which others are installed.

The first is L D L' with AMD ordering: stage by stage, the matrices of an optimal-control program
are small, and MUMPS spends most of its time on bookkeeping. ``_ldl.c`` describes the method. AMD is
taken from the OSQP library that comes with CasADi. MUMPS is used if AMD or the library is missing,
and after IPOPT fails or finds a program infeasible with L D L'. The second solver, ``_band.c``, is
for programs with few equations and a banded matrix.

Theory: docs/theory/transcription.md, "Solvers".
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import compress
from pathlib import Path
from typing import Any

import casadi as ca

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import InputError, shortened, shown, warn_user
from microbot_ocp._base.codegen import (
    ANY_ORDER,
    CommonLibrary,
    NoCompiler,
    NotCompiled,
    compiler,
)

Options = Mapping[str, Mapping[str, Any]]  # keys: solver names

NAME = "ldl"  # value of ``linear_solver`` in the options of IPOPT
BAND = "band"  # value for the solver of banded programs with few equations


def asks_for_ldl(options: Options) -> bool:
    """Return True if the options of all solvers choose "ldl" for IPOPT."""
    return options.get("ipopt", {}).get("linear_solver") == NAME


def without_ldl(options: Options) -> Options:
    """Return the options with IPOPT's default linear solver."""
    usual = {k: v for k, v in options.get("ipopt", {}).items() if k != "linear_solver"}
    return {**options, "ipopt": usual}


def as_ipopt_knows(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options of IPOPT, with "ldl" or "band" replaced by the options that load it."""
    name = options.get("linear_solver")
    if name not in (NAME, BAND):
        return dict(options)
    built = linear_solver_library(name)
    if built is None:
        return {k: v for k, v in options.items() if k != "linear_solver"}
    return {
        **options,
        "linear_solver": "ma27",  # the libraries have MA27's interface
        "hsllib": str(built),
        "ma27_la_init_factor": 1.0,
        "ma27_liw_init_factor": 1.0,
        # Equal to its default maximum: IPOPT regularises instead of raising it.
        "ma27_pivtol": 1e-4,
        "min_refinement_steps": 0,  # the libraries refine their solutions
    }


_HERE = Path(__file__).parent
LIBRARIES = {
    NAME: CommonLibrary(NAME, (_HERE / "_ldl.c").read_text("utf-8"), ("-O2",)),
    BAND: CommonLibrary(BAND, (_HERE / "_band.c").read_text("utf-8"), ("-O3", *ANY_ORDER)),
}
_known: dict[tuple[str, str | None], Path | None] = {}  # keys: solver and compiler


def linear_solver_library(name: str = NAME) -> Path | None:
    """Return the library of "ldl" or "band"; None if it cannot be built, or AMD is missing."""
    cc = compiler()
    if (name, cc) not in _known:
        reason = ""
        try:
            built = LIBRARIES[name].path()
            if name == NAME:
                # It stays loaded: IPOPT opens this instance.
                ctypes.CDLL(str(built)).order_with(_amd_ordering())
        except NoCompiler:  # MUMPS is usual then; the doctor says so
            built = None
        except (OSError, AttributeError, RuntimeError, subprocess.SubprocessError) as problem:
            if deadline.over():  # compilation may succeed another time
                return None
            built, reason = None, shortened(str(problem), 160)
        _known[name, cc] = built
        if reason:
            warn_user(f"MUMPS replaces the linear solver {name!r}, slower: {reason}", NotCompiled)
    return _known[name, cc]


def _amd_ordering() -> Any:
    name = "libosqp.dylib" if sys.platform == "darwin" else "libosqp.so"
    return ctypes.CDLL(str(Path(ca.GlobalOptions.getCasadiPath()) / name)).amd_l_order


# installed solvers --------------------------------------------------------------------------------

# Linear solvers that IPOPT supports, installed or not.
LINEAR_SOLVERS = ("mumps", "ma27", "ma57", "ma77", "ma86", "ma97", "pardiso", "spral")


def check_linear_solver(name: Any) -> None:
    """Check that a linear solver is installed: IPOPT would fail, or end the process.

    Raises
    ------
    InputError
        The linear solver is unknown or not installed.
    """
    if name in (NAME, BAND, LINEAR_SOLVERS[0]):
        return
    if name not in LINEAR_SOLVERS or not _works(name):
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            works = pool.map(_works, LINEAR_SOLVERS)
        there = [NAME, *compress(LINEAR_SOLVERS, works)]
        raise InputError(
            f"linear_solver of the options of ipopt must be one that is installed, "
            f"{', '.join(there)}, not {shown(name)}"
        )


TRIAL = """
import sys, casadi as ca
x = ca.MX.sym("x")
ipopt = {"print_level": 0, "sb": "yes", "linear_solver": sys.argv[1]}
solver = ca.nlpsol("trial", "ipopt", {"x": x, "f": x**2}, {"print_time": False, "ipopt": ipopt})
solver(x0=1.0)
sys.exit(not solver.stats()["success"])
"""


@cache
def _works(name: str) -> bool:
    """Return True if IPOPT solves a small problem with a linear solver.

    Some missing solvers end the process, hence the child process.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", TRIAL, name]
    return not subprocess.run(command, env=environment, capture_output=True, check=False).returncode
