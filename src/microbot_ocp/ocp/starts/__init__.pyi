"""Public names, loaded on first use."""

from ._followed_lines import (
    following_lines as following_lines,
)
from ._initial_guess import (
    completed as completed,
    default_guess as default_guess,
    guess_from as guess_from,
    starting_point as starting_point,
)
from ._problem_data import (
    problem_data as problem_data,
    with_changes as with_changes,
    with_problem_data as with_problem_data,
)
from ._rollout import (
    Ranges as Ranges,
    Rollouts as Rollouts,
    rollouts as rollouts,
    within as within,
)
from ._scaling import (
    NEGLIGIBLE as NEGLIGIBLE,
    cost_scale as cost_scale,
    driving_ranges as driving_ranges,
    scaled as scaled,
)
