"""Reprs: one line each as text, a table as HTML, names of users escaped."""

from dataclasses import replace
from xml.etree import ElementTree

import pytest

from helpers import tells
from microbot_ocp.tasks import Comparison


@pytest.fixture(params=["robot", "motion", "comparison", "certificate"])
def shown(request, comparison):
    entry = comparison.entries[0]
    things = {
        "robot": replace(comparison.robot, name="<b>&"),
        "motion": replace(entry.motion, label="<b>&"),
        "comparison": comparison,
        "certificate": replace(entry.certificate, label="<b>&"),
    }
    return things[request.param]


def test_one_line_and_well_formed_html(shown):
    assert len(repr(shown).splitlines()) == 1
    assert len(repr(shown)) < 100
    page = ElementTree.fromstring(shown._repr_html_())
    title = shown.table().title if isinstance(shown, Comparison) else repr(shown)
    assert "".join(page.find("b").itertext()) == title
    assert page.find("table") is not None


def test_a_method_without_a_motion_and_a_broken_limit_are_told(comparison):
    text = comparison._repr_html_()
    tells(text, "not solved", "infeasible")
    assert text.count("inline-block") == 3  # a bar for each ratio
    assert "FAILED" in repr(comparison.entries[2].certificate)
    tells(repr(comparison), "Comparison", "4 methods", "'microbot'", "3 solved")
