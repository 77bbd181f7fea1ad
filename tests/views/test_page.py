"""Pages: whose axes, whose style, which files."""

import matplotlib
import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.views import plots


@pytest.fixture(scope="module")
def robot():
    return mo.load_robot("planar_2r")


@pytest.fixture(scope="module")
def motion(robot):
    shape = mo.cubic([[0.0, 0.0], [0.5, 0.8]], [0.0, 1.0])
    return mo.Motion.from_polynomial(robot, shape, label="a $ sign", step=0.1)


@pytest.mark.thorough
@pytest.mark.slow
def test_axes_show_their_figure_in_a_notebook(robot, motion):
    grid = motion.plot(robot)
    assert grid.shape == (3, 2)
    assert grid._repr_png_().startswith(b"\x89PNG")
    assert grid[0, 0]._repr_png_().startswith(b"\x89PNG")


def test_figures_look_alike_in_any_style_of_the_user(robot, motion):
    with matplotlib.rc_context({"axes.facecolor": "black", "lines.linewidth": 9.0}):
        panel = motion.plot(robot)[0, 0]
        assert panel.get_facecolor() == (1.0, 1.0, 1.0, 1.0)
        assert matplotlib.rcParams["lines.linewidth"] == 9.0


def test_figure_of_anything_drawn():
    figure = Figure()
    grid = figure.subplots(2, 2)
    inner = figure.subfigures(1, 1).subplots()
    for drawn in (figure, grid, grid[0, 0], inner):
        assert plots.figure_of(drawn) is figure
    with refused("figure", "axes"):
        plots.figure_of(np.zeros(2))


@pytest.mark.thorough
def test_save_makes_the_folder_and_names_its_files(tmp_path):
    figure = Figure()
    written = plots.save({"one": figure, "two": figure.subplots()}, tmp_path / "new")
    assert [path.name for path in written] == ["one.png", "one.pdf", "two.png", "two.pdf"]
    assert all(path.stat().st_size > 0 for path in written)
    assert plots.save(figure, tmp_path) == [tmp_path / "figure.png", tmp_path / "figure.pdf"]
    assert plots.save(figure, tmp_path, "mine")[0] == tmp_path / "mine.png"


def test_save_takes_a_folder_not_a_file(tmp_path):
    with refused("axes.savefig('a.png')", "file"):
        plots.save(Figure(), tmp_path / "a.png")
    with refused("figure", "axes"):
        plots.save({"a": np.zeros(2)}, tmp_path / "new")
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_axes_of_every_kind_write_their_figure(robot, motion, tmp_path):
    grid = motion.plot(robot, quantities=["q"])
    space = mo.plots.arms(robot, {"zero": [0.0, 0.0]})
    assert grid.savefig(tmp_path / "grid.png", dpi=40) == tmp_path / "grid.png"
    pixels = matplotlib.image.imread(tmp_path / "grid.png")
    assert pixels.shape[1] == int(40 * grid.figure.get_figwidth())
    for name, axes in (("row", grid[0]), ("panel", grid[0, 1]), ("space", space)):
        assert axes.savefig(tmp_path / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_the_same_figure_is_the_same_file(tmp_path):
    figure = Figure()
    figure.subplots().plot([0, 1])
    one, other = (plots.write(figure, tmp_path / name) for name in ("a.pdf", "b.pdf"))
    assert one.read_bytes() == other.read_bytes()
