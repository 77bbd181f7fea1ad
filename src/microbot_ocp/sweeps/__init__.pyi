"""Public names, loaded on first use."""

from ._cases import (
    Between as Between,
    Cases as Cases,
    CaseSource as CaseSource,
    OneOf as OneOf,
)
from ._quantities import (
    task_of as task_of,
)
from ._run import (
    SweepStopped as SweepStopped,
    run_study as run_study,
    sweep as sweep,
)
from ._solve import (
    repeat_case as repeat_case,
)
from ._study import (
    Study as Study,
    read_study as read_study,
)
from ._sweep import (
    TIMES as TIMES,
    CaseFailure as CaseFailure,
    Quartiles as Quartiles,
    Sweep as Sweep,
    SweepSummary as SweepSummary,
    load_sweep as load_sweep,
)
