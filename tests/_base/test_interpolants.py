"""Tables that expressions read: their grids, wherever they stand, against the grids they had."""

import casadi as ca
import numpy as np
import pytest

from microbot_ocp._base.interpolants import lookups, reads

GRID = [0.5, 1.0, 1.5, 2.5, 4.0]
VALUES = [1.0, 2.0, 2.5, 2.0, 1.0]
x, y = ca.MX.sym("x"), ca.MX.sym("y")


def table(kind="linear", **options):
    return ca.interpolant("drag", kind, [GRID], VALUES, options)


def user(function):
    """A user's function around a table, of MX."""
    s = ca.MX.sym("s")
    return ca.Function("user", [s], [function(2 * s)])


def scalar(function):
    """The same of SX."""
    s = ca.SX.sym("s")
    return ca.Function("scalar", [s], [function(2 * s) + s])


KNOTS = [[0.5, 0.5, 0.5, 0.5, 2.0, 4.0, 4.0, 4.0, 4.0]]
FORMS = {
    "linear": lambda v: table()(v),
    "bspline": lambda v: table("bspline")(v),
    "linear written out": lambda v: table(inline=True)(v),
    "bspline written out": lambda v: table("bspline", inline=True)(v),
    "smoothed": lambda v: table("bspline", algorithm="smooth_linear")(v),
    "a spline by its knots": lambda v: ca.bspline(v, ca.MX(VALUES), KNOTS, [3], 1),
    "a function that is a spline": lambda v: ca.Function.bspline("s", KNOTS, VALUES, [3], 1)(v),
    "a grid that is given": lambda v: ca.interpolant("drag", "linear", [5], 1)(v, GRID, VALUES),
    "of several values": lambda v: ca.interpolant("drag", "linear", [GRID], [*VALUES, *VALUES])(v),
    "in a function": lambda v: user(table())(v / 2),
    "in a function of a function": lambda v: user(user(table()))(v / 4),
    "in a function of scalars": lambda v: scalar(table())(v / 2),
    "mapped": lambda v: user(table()).map(2)(ca.horzcat(v / 2, 1.0)),
    "on threads": lambda v: user(table()).map(2, "thread", 2)(ca.horzcat(v / 2, 1.0)),
    "several columns": lambda v: table()(ca.horzcat(v, 1.0)),
    "in a product": lambda v: y * ca.sin(table()(v)) ** 2,
}


@pytest.mark.parametrize("form", FORMS)
def test_a_table_is_found_with_its_grid(form):
    at = np.array([[0.7, 4.5, -1.0], [1.0, 1.0, 1.0]])
    expression = FORMS[form](x + 0.25)
    farthest = [
        max((each for each in reads([expression], [x, y], at)), key=lambda r: r.relative[k])
        for k in range(3)
    ]
    assert {(each.lower, each.upper) for each in farthest} == {(0.5, 4.0)}
    assert farthest[0].relative[0] < 0.0
    assert farthest[1].relative[1] == pytest.approx(0.75 / 1.75)
    assert farthest[2].relative[2] == pytest.approx(1.25 / 1.75)
    assert farthest[1].values[1] == pytest.approx(4.75)
    assert "4" in farthest[1].at(1)


def test_every_dimension_has_its_own_range():
    two = ca.interpolant("map", "linear", [[0.0, 1.0, 2.0], [10.0, 20.0]], list(range(6)))
    at = np.array([[1.0, 3.0, 1.0], [15.0, 15.0, 5.0]])
    first, second = reads([two(ca.vertcat(x, y))], [x, y], at)
    assert (first.lower, first.upper, second.lower, second.upper) == (0.0, 2.0, 10.0, 20.0)
    assert first.relative == pytest.approx([-1.0, 1.0, -1.0])
    assert second.relative == pytest.approx([-1.0, -1.0, 1.0])
    assert [each.component for each in (first, second)] == [0, 1]


def test_a_branch_that_is_not_taken_reads_nothing():
    guarded = ca.if_else(x <= 4.0, table()(x), 1.0)
    clipped = table()(ca.fmin(x, 4.0))
    for expression in (guarded, clipped):
        (read,) = reads([expression], [x], np.array([[1.0, 9.0]]))
        assert read.relative.max() <= 0.0


def test_a_table_is_found_once_and_nothing_where_there_is_none():
    drag = table()
    assert len(lookups([drag(x) + drag(x), drag(x) * y])) == 1
    assert lookups([ca.sin(x), x * y, user(ca.Function("f", [x], [x**2]))(x)]) == []
