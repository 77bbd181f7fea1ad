"""Pages: whose axes, whose style, which files."""

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from microbot_ocp._base.checks import InputError
from microbot_ocp.views.plots import _page as page


def test_a_new_page_shows_itself_in_a_notebook():
    with page.styled():
        made = page.axes_page(None, 2, 3, size=(4.0, 3.0), title="a $ sign")
    assert made.axes.shape == (2, 3)
    assert made.axes._repr_png_().startswith(b"\x89PNG")
    assert made.axes[0, 0]._repr_png_().startswith(b"\x89PNG")


def test_a_transposed_page_keeps_its_indices():
    made = page.axes_page(None, 2, 3, size=(4.0, 3.0), transposed=True, sharex=True)
    assert made.axes.shape == (2, 3)
    assert made.axes[1, 2].get_subplotspec().rowspan.start == 2
    assert made.axes[1, 2].get_subplotspec().colspan.start == 1


def test_figures_look_alike_in_any_style_of_the_user():
    with matplotlib.rc_context({"axes.facecolor": "black", "lines.linewidth": 9.0}):
        with page.styled():
            made = page.axes_page(None, 1, 1, size=(3.0, 2.0))
        assert made.axes[0, 0].get_facecolor() == (1.0, 1.0, 1.0, 1.0)
        assert matplotlib.rcParams["lines.linewidth"] == 9.0


def test_figure_of_anything_drawn():
    figure = Figure()
    grid = figure.subplots(2, 2)
    inner = figure.subfigures(1, 1).subplots()
    for drawn in (figure, grid, grid[0, 0], inner):
        assert page.figure_of(drawn) is figure
    with pytest.raises(InputError, match="a figure or its axes"):
        page.figure_of(np.zeros(2))


def test_save_needs_a_name_and_makes_the_folder(tmp_path):
    figure = Figure()
    with pytest.raises(InputError, match="stem must be given"):
        page.save(figure, tmp_path / "new")
    assert not (tmp_path / "new").exists()
    written = page.save({"one": figure, "two": figure.subplots()}, tmp_path / "new")
    assert [path.name for path in written] == ["one.png", "one.pdf", "two.png", "two.pdf"]
    assert all(path.stat().st_size > 0 for path in written)


def test_the_same_figure_is_the_same_file(tmp_path):
    figure = Figure()
    figure.subplots().plot([0, 1])
    one, other = (page.write(figure, tmp_path / name) for name in ("a.pdf", "b.pdf"))
    assert one.read_bytes() == other.read_bytes()
