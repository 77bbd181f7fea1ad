"""Public names, loaded on first use."""

from ._clearance import (
    Clearance as Clearance,
    clearance as clearance,
    clearance_along as clearance_along,
    levers_of as levers_of,
)
from ._contact import (
    Nearest as Nearest,
    contact_model as contact_model,
    facing as facing,
    guiding_pairs as guiding_pairs,
    has_coal as has_coal,
    room_along as room_along,
    rotation_to as rotation_to,
)
from ._detours import (
    FIRST_SEARCHES as FIRST_SEARCHES,
    Detour as Detour,
    Surroundings as Surroundings,
    detour as detour,
)
from ._moveit import (
    Request as Request,
    load_request as load_request,
    read_request as read_request,
)
from ._obstacles import (
    Box as Box,
    ConvexMesh as ConvexMesh,
    Cylinder as Cylinder,
    HalfSpace as HalfSpace,
    Sphere as Sphere,
)
from ._pairs import ACCURACY as ACCURACY
from ._scene import (
    Pair as Pair,
    Scene as Scene,
    clearances as clearances,
    with_arm_capsules as with_arm_capsules,
)
from ._scene_file import (
    load_scene as load_scene,
)
