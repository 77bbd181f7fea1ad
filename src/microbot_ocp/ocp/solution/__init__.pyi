"""Public names; loaded when they are first asked for."""

from ._gap import (
    UNKNOWN as UNKNOWN,
    Gap as Gap,
    cost_size as cost_size,
    gap_of as gap_of,
)
from ._initial_guess import (
    completed as completed,
    default_guess as default_guess,
    guess_from as guess_from,
    starting_point as starting_point,
)
from ._problem_data import (
    problem_data as problem_data,
    with_problem_data as with_problem_data,
)
from ._progress import (
    Iteration as Iteration,
    Progress as Progress,
    StepProgress as StepProgress,
    Watch as Watch,
    quiet as quiet,
    watching as watching,
)
from ._rollout import (
    Ranges as Ranges,
    Rollouts as Rollouts,
    rollout as rollout,
    rollouts as rollouts,
)
from ._scaling import (
    cost_change as cost_change,
    cost_scale as cost_scale,
    scaled as scaled,
)
from ._solution import (
    RIVALS as RIVALS,
    Attempt as Attempt,
    PhaseSolution as PhaseSolution,
    Solution as Solution,
    StartingPoint as StartingPoint,
    Status as Status,
    entry as entry,
    pack as pack,
    unpack as unpack,
)
