"""Results find their views by their class; views of a user's own take the place of ours."""

from __future__ import annotations

from importlib import import_module

import pytest

import microbot_ocp as mo
from helpers import refused
from microbot_ocp._base import showing
from microbot_ocp.motion import Motion


@pytest.fixture(autouse=True)
def restored(monkeypatch):
    monkeypatch.setattr(
        showing, "_views", {name: dict(views) for name, views in showing._views.items()}
    )


@pytest.fixture(scope="module")
def motion():
    return mo.Motion([0.0, 2.0], *[[[0.0], [1.0]]] * 4)


REGISTERED = [(name, kind) for name, views in showing._views.items() for kind in views]


@pytest.mark.parametrize(("name", "kind"), REGISTERED)
def test_every_registered_view_is_a_function_for_a_class(name, kind):
    module, _, cls = name.rpartition(".")
    shown = getattr(import_module(module), cls)
    assert callable(showing.view_for(shown.__new__(shown), kind))


def test_a_view_of_ones_own_takes_the_place_of_ours(motion):
    drawn = []
    mo.register_view(Motion, "plot", lambda robot, motion, axes: drawn.append((robot, axes)))
    robot = mo.load_robot("microbot")
    motion.plot(robot, axes="mine")
    assert drawn == [(robot, "mine")]


def test_a_view_by_its_name_is_imported_when_it_is_asked_for(motion):
    mo.register_view(Motion, "table", "no_such_module:function")
    with pytest.raises(ModuleNotFoundError):
        motion._repr_html_()
    mo.register_view(mo.Table, "html", "builtins:repr")
    assert mo.Table([], [])._repr_html_() == repr(mo.Table([], []))


def test_a_derived_class_has_its_own_view_and_inherits_the_others(motion):
    class Recorded(mo.Motion):
        pass

    mo.register_view(Recorded, "table", lambda motion: mo.Table([mo.Column("recorded")], []))
    recorded = Recorded(motion.t, motion.q, motion.qd, motion.qdd, motion.tau)
    assert "recorded" in recorded._repr_html_()
    assert motion._repr_html_().startswith("<div>")
    assert showing.view_for(recorded, "plot") is mo.plots.motion
    tracking = mo.simulation.Tracking.__new__(mo.simulation.Tracking)
    assert showing.view_for(tracking, "plot") is mo.plots.tracking


def test_what_cannot_be_registered_is_refused():
    with refused("kind", "plot, rerun, table", "'plots'"):
        mo.register_view(Motion, "plots", print)
    with refused("cls", "views", "not int"):
        mo.register_view(int, "plot", print)
    with refused("view", "'module:function'", "'print'"):
        mo.register_view(Motion, "plot", "print")
    with refused("'plot'", "int", error=LookupError):
        showing.view_for(1, "plot")
