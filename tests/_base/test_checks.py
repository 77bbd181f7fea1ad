"""Input checks: what passes, what is refused, and what the refusal says."""

from __future__ import annotations

import numpy as np
import pytest

from helpers import refused
from microbot_ocp import InputError
from microbot_ocp._base import checks


@pytest.mark.parametrize(
    ("value", "expected"),
    [(2, 2.0), (2.5, 2.5), (np.float32(0.5), 0.5), (np.int64(3), 3.0), (np.array(1.5), 1.5)],
)
def test_number_takes_whatever_is_one_number(value: object, expected: float) -> None:
    result = checks.number("mass", value)
    assert type(result) is float
    assert result == expected


@pytest.mark.parametrize(
    "value",
    ["4", "heavy", b"4", True, np.True_, None, [4.0], np.array([4.0]), {}, 1j, 10**400],
    ids=repr,
)
def test_number_refuses_what_is_not_one_number(value: object) -> None:
    with refused("mass", "number"):
        checks.number("mass", value, "kg")


@pytest.mark.parametrize(
    ("value", "bounds", "message"),
    [
        (np.nan, {}, "mass must be finite, not nan kg"),
        (np.inf, {}, "mass must be finite, not inf kg"),
        (0.0, {"above": 0.0}, "mass must be above 0 kg, not 0.0"),
        (-1, {"at_least": 0.0}, "mass must be at least 0 kg, not -1"),
        (11, {"at_most": 10.0}, "mass must be at most 10 kg, not 11"),
    ],
)
def test_number_out_of_bounds_names_argument_value_unit_and_bound(
    value: float, bounds: dict[str, float], message: str
) -> None:
    with pytest.raises(InputError) as caught:
        checks.number("mass", value, "kg", **bounds)
    assert str(caught.value) == message


def test_number_on_a_closed_bound_passes() -> None:
    assert checks.number("x", 1.0, at_least=1.0, at_most=1.0) == 1.0


def test_array_is_a_read_only_copy() -> None:
    given = np.zeros(3)
    result = checks.array("q", given, (3,))
    given[0] = 7.0
    assert result[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        result[0] = 1.0


@pytest.mark.parametrize(
    ("value", "shape", "wanted", "have"),
    [
        ([1.0, 2.0], (3,), "[3]", "[2]"),
        ([[1.0, 2.0]], (None, 3), "[any, 3]", "[1, 2]"),
        (1.0, (3,), "[3]", "[]"),
        (np.zeros((3, 3, 1)), (3, 3), "[3, 3]", "[3, 3, 1]"),
    ],
)
def test_array_of_another_shape_names_both_shapes(
    value: object, shape: tuple[int | None, ...], wanted: str, have: str
) -> None:
    with pytest.raises(InputError) as caught:
        checks.array("q", value, shape)
    assert str(caught.value) == f"q must have shape {wanted}, not {have}"


@pytest.mark.parametrize(
    "value",
    [
        ["1", "2", "3"],
        [1.0, "2", 3.0],
        [1.0, True, 3.0],
        [[1.0], [2.0, 3.0], [4.0]],
        np.array(["1", "2", "3"]),
        np.array([True, False, True]),
        np.array(["2020-01-01"] * 3, dtype="datetime64[D]"),
        {"x": 1.0},
        [1j, 0, 0],
        "abc",
    ],
    ids=str,
)
def test_array_refuses_what_is_not_numbers(value: object) -> None:
    with refused("q", "array", "numbers"):
        checks.array("q", value, (3,))


def test_array_says_which_entry_is_not_finite() -> None:
    table = np.zeros((2, 3))
    table[1, 2] = np.nan
    with pytest.raises(InputError) as caught:
        checks.array("q", table, (None, 3), "rad")
    assert str(caught.value) == "q must be finite, but entry [1, 2] is nan rad"


def test_array_lets_infinity_pass_where_it_may_but_never_nan() -> None:
    assert checks.array("limit", [np.inf], (1,), finite=False)[0] == np.inf
    with refused("limit", "[0]", "nan"):
        checks.array("limit", [np.nan], (1,), finite=False)
    with refused("limit", "[0]", "nan"):
        checks.array("limit", [None], (1,), finite=False)


def test_one_of_lists_what_is_allowed() -> None:
    assert checks.one_of("method", "b", ("a", "b")) == "b"
    with refused("method", "a, b", "'c'"):
        checks.one_of("method", "c", iter(["a", "b"]))


def test_input_error_is_a_value_error() -> None:
    assert issubclass(InputError, ValueError)
