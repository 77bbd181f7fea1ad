"""Public names, loaded on first use."""

from ._closed_form import (
    elbow_arm_branches as elbow_arm_branches,
)
from ._path import (
    follow_ik as follow_ik,
)
from ._result import (
    IKPath as IKPath,
    IKSolution as IKSolution,
)
from ._search import (
    start_range as start_range,
)
from ._solve import (
    branches_by_nlp as branches_by_nlp,
    solve_ik as solve_ik,
    solve_ik_all as solve_ik_all,
    solve_ik_batch as solve_ik_batch,
    solve_ik_each as solve_ik_each,
)
