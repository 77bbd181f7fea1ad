"""Public names, loaded on first use."""

from ._faces import Faces as Faces, arm_bodies as arm_bodies
from ._film import Film as Film
from ._video import (
    animate_cell as animate_cell,
    animate_comparison as animate_comparison,
    animate_motion as animate_motion,
    write_animation as write_animation,
)
