"""IPOPT for programs of CasADi expressions: one table of options, one meaning of a time limit."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline

# Options of CasADi's interface for any solver. Solvers return the multipliers of their bounds
# themselves, and advice reports failed evaluations.
USUAL: dict[str, Any] = {
    "print_time": False,
    "calc_lam_p": False,
    "calc_lam_x": False,
    "error_on_fail": False,
    "show_eval_warnings": False,
}
# MUMPS by default pairs pivots before it orders them, which fills the factors of linked phases:
# three iterations of delta_launch (benchmarks/suite) take 0.4 s instead of 0.06 s, others minutes.
# Its default memory is eleven times the estimate, and each factorisation pays for new pages: 13 %
# more time in a free motion of six joints. IPOPT requests more if twice the estimate is too
# little.
OPTIONS: dict[str, Any] = {
    "print_level": 0,
    "sb": "yes",
    "mumps_pivtol": 1e-7,
    "mumps_permuting_scaling": 0,
    "mumps_pivot_order": 0,
    "mumps_mem_percent": 100,
    "acceptable_iter": 0,  # a point at IPOPT's acceptable level is no optimum
}
LEAST_TIME = np.finfo(float).eps  # IPOPT takes no time limit of 0 s


def ipopt(
    name: str, program: Mapping[str, Any], options: Mapping[str, Any], **interface: Any
) -> ca.Function:
    """Return IPOPT for a program with the expressions x, p, f and g.

    Parameters
    ----------
    name : str
    program : mapping
    options : mapping
        Options of IPOPT beside the usual ones.
    **interface
        Options of CasADi's interface, such as ``cache`` with derivatives.
    """
    of_ipopt = {**OPTIONS, **options}
    return ca.nlpsol(name, "ipopt", program, {**USUAL, **interface, "ipopt": of_ipopt})


def time_limits(seconds: float) -> dict[str, float]:
    """Return options with which IPOPT stops after a processor time, s, and at the deadline.

    IPOPT counts the processor time of all threads.
    """
    limits = {"max_cpu_time": seconds, "max_wall_time": deadline.until() - time.perf_counter()}
    return {key: max(limit, LEAST_TIME) for key, limit in limits.items() if np.isfinite(limit)}
