"""One palette for figures, recordings, films, tables and the studio."""

import re
from pathlib import Path

import microbot_ocp as mo
from microbot_ocp.views._style import JOINT_LOOKS
from microbot_ocp.views.plots import styled

VIEWS = Path(mo.__file__).parent / "views"


def test_colours_are_written_in_one_place():
    colour = re.compile(r"#[0-9A-Fa-f]{6}\b|[\"']tab:")
    others = {path for path in VIEWS.rglob("*.py") if colour.search(path.read_text("utf-8"))}
    assert {path.name for path in others} == {"_style.py"}


def test_curves_without_a_colour_take_the_palette():
    with styled():
        from matplotlib import rcParams

        cycle = [entry["color"] for entry in rcParams["axes.prop_cycle"]]
    assert cycle == [color for color, _ in JOINT_LOOKS]
