"""Points that fill the unit cube evenly."""

import numpy as np
import pytest

from microbot_ocp._base.quasi_random import evenly_spread_step, quasi_random


def test_the_step_of_one_dimension_is_the_golden_ratio():
    assert evenly_spread_step(1)[0] == pytest.approx((np.sqrt(5.0) - 1.0) / 2.0, rel=1e-15)


@pytest.mark.parametrize("dimensions", [1, 2, 3, 5])
def test_each_orthant_has_its_share_of_points(dimensions):
    points = quasi_random(4096, dimensions)
    cells = (points >= 0.5) @ 2 ** np.arange(dimensions)
    shares = np.bincount(cells, minlength=2**dimensions) / len(points)
    assert shares == pytest.approx(np.full(2**dimensions, 2.0**-dimensions), rel=0.1)


def test_skipped_points_are_the_first_ones():
    assert np.array_equal(quasi_random(5, 3, skip=2), quasi_random(7, 3)[2:])
