"""Public names, loaded on first use."""

from ._certificate import (
    Certificate as Certificate,
    Check as Check,
    LimitCheck as LimitCheck,
)
from ._certification import (
    Tolerances as Tolerances,
    certificate_of as certificate_of,
    certified as certified,
    certify as certify,
    limit_checks_of as limit_checks_of,
)
from ._task_certificate import (
    stop_misses as stop_misses,
)
