"""Colours of what every arm has alike, told apart on a dark screen with any colour vision.

Shares of a limit go from slate over yellow; at the limit they jump to a pink that nothing else has.
"""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.checks import FloatArray

Color = tuple[int, int, int, int]

NEUTRAL_COLOR: Color = (130, 142, 160, 255)
NEAR_COLOR: Color = (240, 228, 66, 255)
SATURATED_COLOR: Color = (255, 60, 150, 255)
BEYOND_COLOR: Color = (225, 50, 40, 255)
SPEED_COLOR: Color = (86, 180, 233, 255)
LIMIT_COLOR: Color = (165, 165, 165, 255)
BASE_COLOR: Color = (120, 120, 125, 255)
VIA_COLOR: Color = (245, 245, 245, 255)
MASS_COLOR: Color = (60, 200, 160, 255)
VELOCITY_COLOR: Color = (170, 235, 255, 255)
VARIABLE_COLOR: Color = (240, 150, 80, 255)
FORCE_COLOR: Color = (240, 228, 66, 255)


def share_colors(share: FloatArray, full: float) -> np.ndarray:
    """Colours [N,4] of shares [N] of a limit, which is met from ``full`` on."""
    part = np.clip(np.abs(share), 0.0, 1.0)[:, None]
    low, high = np.array(NEUTRAL_COLOR, dtype=float), np.array(NEAR_COLOR, dtype=float)
    colors = np.rint(low + part * (high - low)).astype(np.uint8)
    colors[np.abs(share) >= full] = SATURATED_COLOR
    return colors
