"""Public names; loaded when they are first asked for."""

from ._history import (
    QUANTITY_NAMES as QUANTITY_NAMES,
    SATURATED as SATURATED,
    LimitHistory as LimitHistory,
    Spell as Spell,
    dense_times as dense_times,
    limit_history as limit_history,
)
from ._peaks import (
    Demand as Demand,
    Peak as Peak,
)
from ._use import (
    ROUNDING as ROUNDING,
    LimitUse as LimitUse,
)
