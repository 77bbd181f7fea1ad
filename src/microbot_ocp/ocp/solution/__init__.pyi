"""Public names, loaded on first use."""

from ._gap import (
    UNKNOWN as UNKNOWN,
    Gap as Gap,
    complementarity as complementarity,
    cost_size as cost_size,
    gap_of as gap_of,
)
from ._progress import (
    Iteration as Iteration,
    LastIterate as LastIterate,
    Progress as Progress,
    StepProgress as StepProgress,
    Watch as Watch,
    quiet as quiet,
)
from ._solution import (
    AGREEING_STARTS as AGREEING_STARTS,
    UNCOMPARED as UNCOMPARED,
    Attempt as Attempt,
    Given as Given,
    Journal as Journal,
    PhaseSolution as PhaseSolution,
    Solution as Solution,
    StartingPoint as StartingPoint,
    Status as Status,
    pack as pack,
    unpack as unpack,
)
