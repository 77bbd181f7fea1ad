"""Where controls switch, and mesh points there."""

import numpy as np
import pytest

from microbot_ocp.ocp.arcs import Switch, find_switches, move_to_switches
from microbot_ocp.ocp.search import solve
from microbot_ocp.ocp.solvers import SolverSettings
from microbot_ocp.ocp.transcription.schemes import SCHEMES
from ocp.textbook import double_integrator

FINE = SolverSettings("ipopt", tolerance=1e-10)
by_every_scheme = pytest.mark.parametrize("scheme", SCHEMES)


@by_every_scheme
def test_the_switch_inside_an_interval_is_where_its_value_says(scheme):
    """On 5 intervals the third holds the switch in its middle, at the value zero."""
    phase = solve(double_integrator(), 5, scheme=scheme, settings=FINE)["move"]
    (switch,) = find_switches(phase)
    assert (switch.begin, switch.end) == pytest.approx((0.4, 0.6))
    assert switch.place == pytest.approx(0.5, abs=1e-6)
    assert not switch.rising
    assert switch.offset == pytest.approx(0.1, abs=1e-6)


def test_a_switch_at_a_mesh_point_is_no_way_off():
    (switch,) = find_switches(solve(double_integrator(), 6, settings=FINE)["move"])
    assert switch.place == switch.begin == switch.end == pytest.approx(0.5)
    assert switch.offset == 0.0


def test_the_nearest_point_moves_to_a_switch_unless_it_is_taken_and_others_gather():
    mesh = np.linspace(0, 1, 6)

    def at(place, begin, end, continuous=False):
        offset = (end - begin) / 2 if continuous else np.abs(mesh - place).min()
        return Switch("u", 0, place, begin, end, True, continuous, offset)

    moved = move_to_switches(mesh, [at(0.45, 0.4, 0.6)], 1e-3)
    np.testing.assert_allclose(moved, [0, 0.2, 0.435, 0.45, 0.465, 0.6, 0.8, 1])
    held = move_to_switches(mesh, [at(0.4, 0.4, 0.4), at(0.45, 0.4, 0.6)], 1e-3)
    np.testing.assert_allclose(held, [0, 0.2, 0.4, 0.445, 0.45, 0.455, 0.6, 0.8, 1])
    early = move_to_switches(mesh, [at(0.05, 0.0, 0.2)], 1e-3)
    np.testing.assert_allclose(early, [0, 0.045, 0.05, 0.055, 0.2, 0.4, 0.6, 0.8, 1])
    ramp = move_to_switches(mesh, [at(0.5, 0.2, 0.8, continuous=True)], 1e-3)
    np.testing.assert_allclose(ramp, [0, 0.2, 0.425, 0.575, 0.8, 1])
    near = move_to_switches(mesh, [at(0.4005, 0.4, 0.6)], 1e-3)
    np.testing.assert_array_equal(near, mesh)
