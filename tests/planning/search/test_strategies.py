"""Which answer a strategy works on next."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from microbot_ocp import Status
from microbot_ocp.planning.search._search import MotionAnswer, SearchState
from microbot_ocp.planning.search._strategies import next_splitting


def solution() -> Any:
    return SimpleNamespace(status=Status.SOLVED)


def searched_from(timed_path: Any) -> Any:
    return SimpleNamespace(problem=SimpleNamespace(timed_path=timed_path))


def test_among_obstacles_a_coarse_motion_is_left_where_its_full_mesh_fails() -> None:
    refiner: Any = None
    coarse = MotionAnswer("path 0", solution(), refiner, 1.0, strategy="timed path")
    refused = SearchState((coarse, replace(coarse, strategy="full mesh", before=coarse)))
    assert next_splitting(searched_from("path 0"), refused) is None
    elsewhere = next_splitting(searched_from(None), refused)
    assert elsewhere is not None
    assert elsewhere.answer is coarse
    finer = replace(refused.answers[1], solution=solution())
    among = next_splitting(searched_from("path 0"), SearchState((coarse, finer)))
    assert among is not None
    assert among.answer is finer
