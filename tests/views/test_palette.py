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
    # white is no colour of the palette: a film mixes it into those on a dark page
    assert {path.name for path in others} == {"_style.py", "_film.py"}
    film = (VIEWS / "animation" / "_film.py").read_text("utf-8")
    assert set(colour.findall(film)) == {"#ffffff"}


def test_curves_without_a_colour_take_the_palette():
    with styled():
        from matplotlib import rcParams

        cycle = [entry["color"] for entry in rcParams["axes.prop_cycle"]]
    assert cycle == [color for color, _ in JOINT_LOOKS]
