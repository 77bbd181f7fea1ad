"""Public names, loaded on first use."""

from ._flat_program import FlatTranscription as FlatTranscription, flat_form as flat_form
from ._initial_guesses import (
    InitialGuess as InitialGuess,
    guess_along as guess_along,
    guesses_along as guesses_along,
    initial_guesses as initial_guesses,
)
from ._least_violation import (
    guesses_from as guesses_from,
    judged as judged,
    least_violation as least_violation,
)
from ._problem import (
    BUDGET as BUDGET,
    JERK_WEIGHT as JERK_WEIGHT,
    OF_VARIABLES as OF_VARIABLES,
    accelerations_jump as accelerations_jump,
    effort_scale as effort_scale,
    excess_along as excess_along,
    excess_between as excess_between,
    joined as joined,
    limited_rates as limited_rates,
    phase_names as phase_names,
    phase_shapes as phase_shapes,
    polynomial as polynomial,
    transcription as transcription,
    via_times as via_times,
)
from ._progress import MotionIteration as MotionIteration, with_motion as with_motion
from ._switching import in_arcs as in_arcs
from ._within_limits import (
    LARGEST_SLOWDOWN as LARGEST_SLOWDOWN,
    MOST_GRIDS as MOST_GRIDS,
    Slowed as Slowed,
    known_ways as known_ways,
    largest_excess as largest_excess,
    slowed_together as slowed_together,
    with_steady_ends as with_steady_ends,
    within_limits as within_limits,
)
