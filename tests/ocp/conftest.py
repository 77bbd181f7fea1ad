"""Fixtures of the tests of the general layer."""

import casadi as ca
import pytest


@pytest.fixture
def no_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any solver that is made fails the test."""

    def refuse(*arguments: object, **options: object) -> None:
        pytest.fail("a solver was started")

    monkeypatch.setattr(ca, "nlpsol", refuse)
