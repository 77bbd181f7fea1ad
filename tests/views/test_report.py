"""The printed page: one page, everything on it, failures in words."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from importlib.metadata import version

import pytest

import microbot_ocp as mo
from helpers import tells
from microbot_ocp.robot import Limits
from microbot_ocp.tasks import Cell
from microbot_ocp.views.plots import report_figure


def words(figure):
    """All text of a figure; the cell of a table answers with its text as an artist."""
    found = [text.get_text() for text in figure.findobj(lambda a: hasattr(a, "get_text"))]
    return "\n".join(text if isinstance(text, str) else text.get_text() for text in found)


@pytest.fixture(scope="module")
def page(comparison):
    return report_figure(comparison, footer="")


def test_the_page_tells_task_limits_methods_and_verdicts(comparison, page):
    text = words(page)
    tells(text, "microbot", "3 joints", "waist, shoulder, elbow")
    tells(text, "(0, 0, 0), (-8, 45, 30), (-90, 90, 90) deg")
    tells(text, "torque", "±400 / ±500 / ±200 N m")
    tells(text, "position", "±360 / ±360 / ±360 deg")
    assert "2.600" in text
    tells(text, "lspb", "not solved", "infeasible")
    flat = " ".join(text.split())
    for entry in comparison.entries:
        if entry.certificate is not None:
            assert f"{entry.title}: {entry.certificate.verdict}" in flat


def test_the_page_shows_the_reference_and_the_best(comparison, page):
    text = words(page)
    assert "time-optimal, free, 1.500 s" in text
    reference = comparison.entries[0].title
    assert f"{reference}, 3.400 s" in text
    assert "cubic, scaled, 2.600 s" not in text


def test_nothing_is_outside_the_page(page):
    page.draw_without_rendering()
    box = page.get_tightbbox(page.canvas.get_renderer()).transformed(page.dpi_scale_trans)
    assert page.bbox.x0 <= box.x0
    assert page.bbox.y0 <= box.y0
    assert box.x1 <= page.bbox.x1
    assert box.y1 <= page.bbox.y1


@pytest.mark.slow
@pytest.mark.parametrize("names", [[], [0], [3]], ids=["none", "reference", "failure"])
def test_fewer_methods_or_no_limits(comparison, names):
    entries = tuple(comparison.entries[k] for k in names)
    fewer = replace(comparison, entries=entries, limits=Limits().for_joints(3))
    tells(words(report_figure(fewer, footer="")), "torque: none")


@pytest.mark.thorough
@pytest.mark.slow
def test_one_page_of_vectors(comparison, tmp_path):
    path = comparison.report(tmp_path / "report.pdf")
    content = path.read_bytes()
    assert content.startswith(b"%PDF")
    assert content.count(b"/Type /Page\n") + content.count(b"/Type /Page ") == 1
    assert b"/Subtype /Image" not in content


def test_the_footer_tells_versions_and_command(comparison):
    text = words(report_figure(comparison))
    assert f"microbot_ocp {version('microbot_ocp')} casadi {version('casadi')}" in text


class Reader(HTMLParser):
    """Text, titles and pictures of a page, and what it would load."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.text, self.images, self.loaded, self.alternatives = "", [], [], 0
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        if tag == "img":
            kind, _, data = found["src"].partition(";base64,")
            self.images.append((kind, base64.b64decode(data)))
            self.alternatives += bool(found["alt"])
        self.loaded += [v for k, v in attrs if k in ("src", "href") and not v.startswith("data:")]

    def handle_data(self, data):
        self.text += data


@pytest.mark.thorough
@pytest.mark.slow
def test_one_file_to_send_has_words_table_film_figures_and_verdicts(comparison, tmp_path):
    robot = replace(mo.load_robot("planar_2r"), name="<b>arm & co")
    short = mo.compare(robot, [[0, 0], [0.03, 0.05]], ["cubic", "lspb"])  # a film of few pictures
    comparison = replace(short, entries=(*short.entries, comparison.entries[3]))
    path = comparison.report(tmp_path / "report.html")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    page = Reader(path.read_text("utf-8"))
    assert page.loaded == []
    assert page.alternatives == len(page.images)
    film, *figures = page.images
    assert film[0] == "data:image/gif"
    assert film[1].startswith(b"GIF8")
    assert [kind for kind, _ in figures] == ["data:image/png"] * 2
    assert "<b>arm & co" in page.text
    tells(page.text, "fastest")
    for entry in comparison.entries:
        assert entry.title in page.text
        if entry.certificate is not None:
            assert entry.certificate.verdict in page.text


@pytest.mark.thorough
def test_a_cell_says_how_often_an_hour(tmp_path):
    robot = mo.load_robot("planar_2r")
    stops = (mo.Stop(q=[0.0, 0.5], name="here"), mo.Stop(q=[0.8, 0.2], name="there"))
    motion = mo.time_optimal(robot, list(stops), cycle=True, mesh=12, starts=1)
    certificate = mo.certify(robot, motion, via_q=list(stops), cycle=True)
    cell = Cell(robot, stops, (None, None), True, motion, certificate)
    (path,) = cell.save(tmp_path, ["report"])
    page = Reader(path.read_text("utf-8"))
    assert page.loaded == []
    hourly = rf"{3600 / motion.duration:.0f} parts per hour, compared with \d+ by the controller"
    assert re.search(hourly, page.text)
    assert "here again" not in page.text
    assert "here" in page.text
    assert "there" in page.text
    assert certificate.verdict in page.text
    assert len(page.images) == 2
