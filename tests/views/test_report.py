"""The printed page: one page, everything on it, failures in words."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import version

import pytest

from microbot_ocp.robot import Limits
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
    assert "Robot: microbot, 3 joints (waist, shoulder, elbow)" in text
    assert "through (0, 0, 0), (-8, 45, 30), (-90, 90, 90) deg" in text
    assert "Limits of torque: ±400 / ±500 / ±200 N m" in text
    assert "Limits of position: ±360 / ±360 / ±360 deg" in text
    assert "2.600" in text
    assert "lspb: not solved: infeasible" in text
    flat = " ".join(text.split())
    for entry in comparison.entries:
        if entry.certificate is not None:
            assert f"{entry.title}: {entry.certificate.verdict}" in flat


def test_the_page_shows_the_reference_and_the_best(page):
    text = words(page)
    assert "time-optimal, free, 1.500 s" in text
    assert "cubic, as in the report, 3.400 s" in text  # the reference of this comparison
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
    assert "Limits of torque: none" in words(report_figure(fewer, footer=""))


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
