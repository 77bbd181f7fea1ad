"""Which linear solvers IPOPT can load here."""

from __future__ import annotations

import faulthandler
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import InputError, shown
from microbot_ocp._base.child_process import Died, can_fork, in_child
from microbot_ocp.ocp.solvers._ldl import NAME

# that IPOPT knows, whether they are installed or not
LINEAR_SOLVERS = ("mumps", "ma27", "ma57", "ma77", "ma86", "ma97", "pardiso", "spral")


def check_linear_solver(name: Any) -> None:
    """Refuse one that is not there, with which IPOPT would stop at once, or end the process.

    Raises
    ------
    InputError
    """
    if name in (NAME, LINEAR_SOLVERS[0]):
        return
    if name not in LINEAR_SOLVERS or not _works(name):
        there = [NAME, *(other for other in LINEAR_SOLVERS if _works(other))]
        raise InputError(
            f"linear_solver of the options of ipopt must be one that is installed, "
            f"{', '.join(there)}, not {shown(name)}"
        )


@cache
def _works(name: str) -> bool:
    """Return whether IPOPT solves something by this linear solver; some end the process without
    it.
    """

    def tried() -> bool:
        x = ca.MX.sym("x")
        silent = {"print_level": 0, "sb": "yes", "linear_solver": name}
        options = {"print_time": False, "error_on_fail": False, "ipopt": silent}
        try:
            solver = ca.nlpsol("tried", "ipopt", {"x": x, "f": x**2}, options)
            solver(x0=1.0)
            return bool(solver.stats()["success"])
        except RuntimeError:
            return False

    def quietly(_: object) -> bool:
        faulthandler.disable()
        return tried()

    try:
        return in_child(quietly, np.inf) if can_fork() else tried()
    except Died:
        return False
