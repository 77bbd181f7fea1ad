"""Solvers that must not start."""

from __future__ import annotations

import sys

import casadi as ca
import pytest

import microbot_ocp.planning.search._through_stops
import microbot_ocp.planning.timing._path_timing  # noqa: F401


@pytest.fixture
def no_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any solver that is made fails the test."""

    def refuse(*arguments: object, **options: object) -> None:
        pytest.fail("a solver was started")

    monkeypatch.setattr(ca, "nlpsol", refuse)
    for module, name in (
        ("search._through_stops", "search_of"),
        ("timing._path_timing", "_PathSearch"),
    ):
        monkeypatch.setattr(sys.modules[f"microbot_ocp.planning.{module}"], name, refuse)
