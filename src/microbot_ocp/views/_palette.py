"""Colours of recordings, films and scenes: red, green, blue and opacity, 0 to 255."""

from __future__ import annotations

from microbot_ocp.views._style import Color

# Colours of the use of a limit: interpolated from neutral to near below the limit. They are
# distinct on a dark screen for any colour vision.
NEUTRAL: Color = (130, 142, 160, 255)
NEAR: Color = (240, 228, 66, 255)
SATURATED: Color = (255, 60, 150, 255)  # at the limit
BROKEN: Color = (225, 50, 40, 255)  # above the limit
BRIGHT: Color = (245, 245, 245, 255)  # marked places
DULL: Color = (165, 165, 165, 255)  # limits and base
SPEED: Color = (86, 180, 233, 255)  # limits other than torque
MOTION: Color = (170, 235, 255, 255)  # velocities
MASS: Color = (60, 200, 160, 255)  # centres of mass
VARIABLE: Color = (240, 150, 80, 255)  # variables of an optimal-control problem
OBSTACLE: Color = (205, 160, 105, 255)
CAPSULE: Color = (150, 190, 230, 60)  # capsules of the arm
TUBE: Color = (0, 158, 115, 110)  # tubes of tool lines
PART: Color = (160, 120, 255, 255)  # carried parts
METAL: Color = (190, 195, 205, 255)  # geometry without a colour
