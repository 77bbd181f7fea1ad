"""Public names; loaded when they are first asked for."""

from ._certificate import (
    Certificate as Certificate,
    LimitCheck as LimitCheck,
    ViaCheck as ViaCheck,
    certificate_of as certificate_of,
    certify as certify,
)
from ._task_certificate import (
    SegmentCheck as SegmentCheck,
)
