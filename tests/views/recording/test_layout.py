"""Axes that can be read, and labels that do not hide each other."""

import numpy as np
import pytest
from reading import read

from microbot_ocp.views import _scene as scene
from microbot_ocp.views._style import LABEL_HEIGHT
from microbot_ocp.views.recording import PROGRESS, of_comparison
from microbot_ocp.views.recording._blueprint import labelled_range


@pytest.mark.parametrize(
    ("low", "high", "unchanged"),
    [
        (-95.0, 5.0, False),
        (-440.0, 440.0, True),
        (-560.0, 560.0, False),
        (0.3, 1.5, False),
        (-0.1, 8.0, True),
        (41.0, 49.9, True),
        (12.0, 12.5, True),
        (-1e-3, -2e-4, True),
    ],
)
def test_every_axis_has_two_labelled_values(low, high, unchanged):
    bottom, top = labelled_range(low, high)
    assert bottom <= low < high <= top
    assert ((bottom, top) == (low, high)) == unchanged
    assert top - bottom < 2.2 * (high - low)
    step = 10.0 ** np.floor(np.log10(top - bottom))
    if (top - bottom) / step > 9:
        step *= 10
    assert np.floor(top / step + 1e-9) - np.ceil(bottom / step - 1e-9) >= 1


@pytest.mark.parametrize(
    ("timeline", "clock"), [("sim_time", np.linspace(0, 3.4, 300)), (PROGRESS, np.arange(1001))]
)
def test_labels_are_apart_at_every_moment(comparison, recording, timeline, clock):
    """Seen from the recording's own eye, two labels of 18 letters are apart."""
    robot, eye = comparison.robot, of_comparison(comparison).eye
    towards = eye.position - eye.target
    right = np.cross(eye.up, towards)
    axes = np.array([right / np.linalg.norm(right), np.cross(towards, right)])
    axes[1] /= np.linalg.norm(axes[1])
    seen = {}
    for name in ("cubic_report", "cubic", "time_optimal"):
        tool = f"/world/{name}/tool"
        t, places = read(recording, tool, "Transform3D:translation", timeline)
        t_label, rows = read(recording, f"{tool}/label", "Points3D:positions", timeline)
        place = np.array(places)[np.searchsorted(t, clock, side="right") - 1, 0]
        above = np.array(rows)[np.searchsorted(t_label, clock, side="right") - 1, 0]
        seen[name] = (place + above) @ axes.T
    names = list(seen)
    for i, name in enumerate(names):
        for other in names[:i]:
            across, high = np.abs(seen[name] - seen[other]).T
            beside = across > 0.2 * scene.reach(robot)
            apart = beside | (high > 0.9 * LABEL_HEIGHT * scene.reach(robot))
            # between its own samples an arm may be late by one of another arm
            assert apart.mean() > 0.995


def test_the_label_of_a_switch_goes_after_a_while(recording):
    t, labels = read(recording, "/world/cubic/switches/latest", "Points3D:labels")
    _, switches = read(recording, "/world/cubic/switches", "Points3D:positions")
    told = [bool(row) for row in labels]
    assert told.count(True) == len(switches)
    assert not told[-1]
    assert t[-1] > t[told.index(True)]
