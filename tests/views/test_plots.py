"""Figures: axes, units, legend, limits, failures."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import microbot_ocp as mo
from helpers import refused, sampled, tells
from microbot_ocp.motion import Outcome
from microbot_ocp.robot import Limits
from microbot_ocp.views import plots

# legend entry and colour of each solved method of the comparison of these tests
LOOKS = {
    "cubic_report": ("cubic, as in the report, 3.400 s (NOT CERTIFIED)", "#0072b2"),
    "cubic": ("cubic, scaled, 2.600 s (NOT CERTIFIED)", "#56b4e9"),
    "time_optimal": ("time-optimal, free, 1.500 s (NOT CERTIFIED)", "#d55e00"),
}


@pytest.fixture(scope="module")
def curves(comparison):
    return plots.comparison(comparison).figure


@pytest.fixture(scope="module")
def paths(comparison):
    return plots.paths(comparison).figure


def legend_texts(figure):
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def named_lines(axes, label):
    return [line for line in axes.lines if line.get_label() == label]


def test_grid_titles_and_units(curves):
    assert len(curves.axes) == 9
    assert [a.get_title() for a in curves.axes[:3]] == ["waist", "shoulder", "elbow"]
    labels = [a.get_ylabel() for a in curves.axes]
    assert labels == ["q [deg]", "", "", "qd [rad/s]", "", "", "tau [N m]", "", ""]
    assert {a.get_xlabel() for a in curves.axes[6:]} == {"t [s]"}


def test_curves_are_the_motions(comparison, curves):
    for entry in comparison.entries[:3]:
        motion, (title, color) = entry.motion, LOOKS[entry.name]
        for row, (quantity, factor) in enumerate((("q", 180 / np.pi), ("qd", 1), ("tau", 1))):
            for joint in range(3):
                (line,) = named_lines(curves.axes[3 * row + joint], title)
                np.testing.assert_allclose(line.get_xdata(), motion.t)
                expected = getattr(motion, quantity)[:, joint] * factor
                np.testing.assert_allclose(line.get_ydata(), expected)
                assert to_hex(line.get_color()) == color


def test_limits_near_the_data_only(curves):
    assert named_lines(curves.axes[0], "_limit") == []
    assert [t.get_text() for t in curves.axes[0].texts] == ["limits ±360 deg"]
    levels = [line.get_ydata()[0] for line in named_lines(curves.axes[3], "_limit")]
    assert levels == [-2.0, 2.0]
    low, high = curves.axes[3].get_ylim()
    assert low < -2.0
    assert high > 2.0
    one_sided = curves.axes[4]
    assert [line.get_ydata()[0] for line in named_lines(one_sided, "_limit")] == [2.0]
    assert [t.get_text() for t in one_sided.texts] == ["lower limit −2 rad/s"]


def test_no_limit_is_neither_drawn_nor_named(comparison):
    figure = plots.comparison(replace(comparison, limits=Limits().for_joints(3))).figure
    assert [line for axes in figure.axes for line in named_lines(axes, "_limit")] == []
    assert [text for axes in figure.axes for text in axes.texts] == []


def test_via_markers_at_their_times(curves):
    markers = named_lines(curves.axes[1], "_via")
    np.testing.assert_allclose(markers[1].get_xdata(), [0, 1.2, 2.6])
    np.testing.assert_allclose(markers[1].get_ydata(), [0, 45, 90], atol=1e-9)


def test_a_via_point_without_a_mark_is_left_out(comparison):
    entry = comparison.entries[1]
    unmarked = replace(entry, motion=replace(entry.motion, marks=()))
    figure = plots.comparison(replace(comparison, entries=(unmarked,))).figure
    (markers,) = named_lines(figure.axes[1], "_via")
    np.testing.assert_allclose(markers.get_xdata(), [0, 2.6])


def looks(comparison):
    """Colour, line style and width of each line by its label without the duration."""
    drawn = [
        line for line in plots.comparison(comparison)[0, 0].lines if line.get_label()[0] != "_"
    ]
    return {
        line.get_label().rpartition(", ")[0]: (
            line.get_color(), str(line._dash_pattern), line.get_linewidth()
        )
        for line in drawn
    }  # fmt: skip


def test_a_known_method_looks_the_same_in_every_comparison(comparison):
    every = looks(comparison)
    fewer = looks(replace(comparison, entries=comparison.entries[1:]))
    assert len(fewer) == 2
    assert fewer.items() < every.items()


def test_unknown_methods_have_different_looks(comparison):
    entries = tuple(
        replace(comparison.entries[0], name=f"mine {i}", title=f"mine {i}") for i in range(4)
    )
    drawn = looks(replace(comparison, entries=entries))
    assert len({look[:2] for look in drawn.values()}) == 4
    assert not {look[0].lower() for look in drawn.values()} & {color for _, color in LOOKS.values()}


def test_the_free_motion_or_else_the_last_one_is_drawn_wider(comparison):
    def widest(chosen):
        widths = {title: look[2] for title, look in looks(chosen).items()}
        return max(widths, key=widths.__getitem__)

    assert widest(comparison) == "time-optimal, free"
    assert widest(replace(comparison, entries=comparison.entries[:2])) == "cubic, scaled"


def test_legend_tells_durations_refusals_and_failures(curves):
    texts = legend_texts(curves)
    assert any("time-optimal, free" in text and "1.500 s (NOT C" in text for text in texts)
    assert not any("LSPB" in text for text in texts)
    title = curves.legends[0].get_title().get_text()
    tells(title, "lspb", "not solved", "infeasible", "blends")


def test_certified_entry_is_not_accused(comparison):
    entry = comparison.entries[0]
    good = replace(entry, certificate=replace(entry.certificate, ok=True))
    figure = plots.comparison(replace(comparison, entries=(good,))).figure
    assert legend_texts(figure)[0] == "cubic, as in the report, 3.400 s"


def test_paths_views(comparison, paths):
    space, above, side = paths.axes
    assert space.name == "3d"
    assert (space.get_xlabel(), space.get_ylabel(), space.get_zlabel()) == (
        "x [m]",
        "y [m]",
        "z [m]",
    )
    assert (above.get_xlabel(), above.get_ylabel()) == ("x [m]", "y [m]")
    assert side.get_ylabel() == "z [m]"
    assert above.get_aspect() == side.get_aspect() == 1.0
    assert [text.get_text() for text in above.texts] == ["1", "2", "3"]
    (line,) = named_lines(above, "cubic, scaled")
    assert (line.get_xdata()[0], line.get_ydata()[0]) == pytest.approx((7.0, 0.0))
    assert (line.get_xdata()[-1], line.get_ydata()[-1]) == pytest.approx((0.0, 4.0), abs=1e-9)
    (line,) = named_lines(side, "cubic, scaled")  # folded over the waist: r below zero
    assert (line.get_xdata()[-1], line.get_ydata()[-1]) == pytest.approx((-4.0, 5.0))


@pytest.mark.slow
@pytest.mark.parametrize("make", sampled([plots.paths, plots.comparison], 2))
def test_nothing_is_outside_the_page(comparison, make):
    figure = make(comparison).figure
    figure.canvas.draw()
    page = figure.bbox
    box = figure.get_tightbbox(figure.canvas.get_renderer()).transformed(figure.dpi_scale_trans)
    assert box.x0 >= page.x0 - 1
    assert box.y0 >= page.y0 - 1
    assert box.x1 <= page.x1 + 1
    assert box.y1 <= page.y1 + 1


@pytest.mark.slow
@pytest.mark.parametrize("make", sampled([plots.paths, plots.comparison], 2))
def test_without_any_motion_or_limit(comparison, make):
    nothing = replace(comparison, entries=comparison.entries[3:], limits=Limits().for_joints(3))
    figure = make(nothing).figure
    figure.canvas.draw()
    assert "not solved" in figure.legends[0].get_title().get_text()


@pytest.mark.slow
def test_save(tmp_path):
    figure = Figure()
    figure.subplots().plot([0, 1])
    png, pdf = plots.save(figure, tmp_path / "new", "paths")
    assert (png.name, pdf.name) == ("paths.png", "paths.pdf")
    assert png.read_bytes().startswith(b"\x89PNG")
    assert pdf.read_bytes().startswith(b"%PDF")


def test_a_motion_that_its_solver_disowns_says_so(comparison):
    entry = comparison.entries[2]
    doubtful = replace(
        entry,
        motion=entry.motion.ended(Outcome.of(mo.Status.ITERATION_LIMIT)),
        status="iteration limit",
    )
    figure = plots.comparison(replace(comparison, entries=(doubtful,))).figure
    title = "time-optimal, free, 1.500 s (NOT SOLVED: iteration limit)"
    assert legend_texts(figure)[0] == title


def test_comparison_of_some_methods_quantities_and_joints(comparison):
    grid = plots.comparison(comparison, quantities=["qdd"], joints=[2], methods=["cubic"])
    assert grid.shape == (1, 1)
    assert grid[0, 0].get_ylabel() == "qdd [rad/s^2]"
    assert legend_texts(grid.figure)[0] == "cubic, scaled, 2.600 s (NOT CERTIFIED)"
    with pytest.raises(KeyError):
        plots.comparison(comparison, methods=["mine"])


def test_paths_on_given_axes(comparison):
    figure = Figure()
    own = [figure.add_subplot(1, 3, 1, projection="3d")]
    own += [figure.add_subplot(1, 3, k) for k in (2, 3)]
    assert list(plots.paths(comparison, own).flat) == own
    with refused("axes", "3d"):
        plots.paths(comparison, figure.subplots(1, 3))


@pytest.mark.slow
def test_no_global_state():
    code = """
import sys, matplotlib, microbot_ocp as mo
before = matplotlib.rcParams.copy()
robot = mo.load_robot("planar_2r")
shape = mo.cubic([[0.0, 0.0], [0.5, 0.4]], [0.0, 1.0])
mo.Motion.from_polynomial(robot, shape, label="cubic").plot(robot)
assert matplotlib.rcParams.copy() == before
assert "matplotlib.pyplot" not in sys.modules
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
