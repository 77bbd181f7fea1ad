"""Colours are told apart with any colour vision, on white and on dark paper; dark figures."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.views._style import FIXED, JOINT_LOOKS, OTHERS

# Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB
VISION = {
    "normal": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
APART = 10.0  # CIE 1976 difference of colours that are told apart at a glance side by side
PAPER, DARK = "#ffffff", "#131313"


def linear(color: str) -> np.ndarray:
    """Linear RGB of a colour, sRGB (IEC 61966-2-1)."""
    value = np.array(to_rgb(color))
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def lab(color: str, vision: str = "normal") -> np.ndarray:
    """CIELAB (D65) of a colour as it is seen."""
    seen = np.clip(np.array(VISION[vision]) @ linear(color), 0.0, 1.0)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    x, y, z = (np.array(to_xyz) @ seen) / [0.9505, 1.0, 1.089]
    fx, fy, fz = (v ** (1 / 3) if v > 0.008856 else 7.787 * v + 16 / 116 for v in (x, y, z))
    return np.array([116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)])


def contrast(color: str, paper: str) -> float:
    """Contrast ratio of WCAG 2."""
    weights = [0.2126, 0.7152, 0.0722]
    low, high = sorted(float(weights @ linear(each)) for each in (color, paper))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("vision", VISION)
def test_methods_are_told_apart_by_colour(vision: str) -> None:
    for first, second in combinations(FIXED, 2):
        apart = np.linalg.norm(lab(FIXED[first][0], vision) - lab(FIXED[second][0], vision))
        assert apart > APART, f"{first}, {second}: {apart:.1f}"


@pytest.mark.parametrize("vision", VISION)
def test_joints_are_told_apart_by_colour_or_by_lightness_and_dashes(vision: str) -> None:
    for (i, first), (j, second) in combinations(enumerate(color for color, _ in JOINT_LOOKS), 2):
        apart = np.linalg.norm(lab(first, vision) - lab(second, vision))
        assert apart > APART, f"joints {i}, {j}: {apart:.1f}"


def test_every_line_differs_in_grey() -> None:
    for looks in ((*FIXED.values(), *OTHERS), JOINT_LOOKS):
        dashes = [str(dash) for _, dash in looks]
        repeated = [dash for dash in set(dashes) if dashes.count(dash) > 1]
        assert all(dash == "solid" for dash in repeated)


@pytest.mark.parametrize("paper", [PAPER, DARK])
def test_lines_stand_out_from_the_paper(paper: str) -> None:
    for color in (color for color, _ in (*FIXED.values(), *JOINT_LOOKS[:5])):
        assert contrast(color, paper) > 2.0, color


def test_dark_figures_have_dark_paper_and_leave_the_figure_as_it_was(tmp_path) -> None:
    robot = mo.load_robot("planar_2r")
    shape = mo.cubic([[0.0, 0.0], [0.6, 0.9]], [0.0, 1.0])
    axes = mo.plots.motion(
        robot, mo.Motion.from_polynomial(robot, shape, label="cubic"), quantities=["q"]
    )
    _, light, dark, again = (  # the layout settles when it is drawn the first time
        np.asarray(Image.open(axes.savefig(tmp_path / f"{k}.png", theme=theme)).convert("L"))
        for k, theme in enumerate(("light", "light", "dark", "light"))
    )
    np.testing.assert_array_equal(light, again)
    assert np.median(light) == 255
    assert np.median(dark) < 30
    assert dark.max() > 200  # texts
    with refused("theme", "'sepia'"):
        axes.savefig(tmp_path / "a.png", theme="sepia")
