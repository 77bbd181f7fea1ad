"""Inverse kinematics: one solution, every branch, a line followed; by Gauss-Newton and by NLPs.

``search`` runs many starts at once through one compiled step; the NLPs of ``kernels`` (IPOPT) take
over where limits, a seed, a missed target or a continuum of solutions ask for an optimum.
"""

from microbot_ocp.inverse_kinematics.closed_form import elbow_arm_branches
from microbot_ocp.inverse_kinematics.path import solve_ik_path
from microbot_ocp.inverse_kinematics.result import IKPath, IKSolution, IKStatus
from microbot_ocp.inverse_kinematics.solve import (
    branches_by_nlp,
    solve_ik,
    solve_ik_all,
    solve_ik_batch,
)

__all__ = [
    "IKPath",
    "IKSolution",
    "IKStatus",
    "branches_by_nlp",
    "elbow_arm_branches",
    "solve_ik",
    "solve_ik_all",
    "solve_ik_batch",
    "solve_ik_path",
]
