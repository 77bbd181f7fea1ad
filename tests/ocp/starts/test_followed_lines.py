"""Controls that follow straight lines, where the default guess gives them no influence."""

import casadi as ca
import numpy as np
import pytest

from microbot_ocp.ocp import solve
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.starts import default_guess, following_lines
from microbot_ocp.ocp.transcription import sampled

SHARES = np.linspace(0.0, 1.0, 7)


def tunnel(angle: float) -> OptimalControlProblem:
    """Fastest way from rest through a ball of radius 1 to a point of its surface."""
    problem = OptimalControlProblem("gravity tunnel")
    phase = problem.phase("fall", (0.1, 20.0))
    x = phase.state("x", initial=1.0, final=np.cos(angle))
    y = phase.state("y", initial=0.0, final=np.sin(angle))
    v = phase.state("v", initial=0.0)
    heading = phase.control("heading")
    phase.derivative(x, v * ca.cos(heading))
    phase.derivative(y, v * ca.sin(heading))
    phase.derivative(v, -(x * ca.cos(heading) + y * ca.sin(heading)))
    phase.end_cost(phase.duration)
    return problem


def followed(problem: OptimalControlProblem) -> dict[str, np.ndarray] | None:
    usual = default_guess(problem)
    ((name, after),) = following_lines(problem, usual).items()
    before = usual[name]
    return (
        None
        if after is before
        else {
            variable.name: sampled(after.values[variable.name], variable, SHARES)
            for variable in problem.phases[0].variables
        }
    )


@pytest.mark.parametrize("angle", [2.0, 1.2, -2.6])
def test_headings_follow_the_line_where_the_guessed_speed_is_zero(angle):
    values = followed(tunnel(angle))
    assert values is not None
    slope = np.array([np.cos(angle) - 1.0, np.sin(angle)])
    heading = values["heading"]
    velocity = values["v"] * np.hstack([np.cos(heading), np.sin(heading)])
    duration = default_guess(tunnel(angle))["fall"].duration
    assert duration is not None
    assert velocity * duration == pytest.approx(np.tile(slope, (SHARES.size, 1)), rel=1e-9)


def test_controls_with_influence_stay_as_guessed():
    problem = OptimalControlProblem("double integrator")
    phase = problem.phase("move", 1.0)
    x, v = (phase.state(name, initial=0.0, final=end) for name, end in (("x", 1.0), ("v", 0.0)))
    force, lamp = phase.control("force"), phase.control("lamp")
    phase.derivative(x, v)
    phase.derivative(v, force)
    phase.running_cost(force**2 + lamp**2)
    assert followed(problem) is None


def test_a_boat_at_rest_in_a_current_follows_its_line():
    problem = OptimalControlProblem("boat")
    phase = problem.phase("cross", 2.0)
    x, y = (phase.state(name, initial=0.0, final=1.0) for name in "xy")
    speed = phase.control("speed", lower=0.0, upper=3.0)
    rudder = phase.control("rudder")
    phase.derivative(x, speed * ca.cos(rudder))
    phase.derivative(y, speed * ca.sin(rudder) + 0.1)
    phase.running_cost(speed**2)
    values = followed(problem)
    assert values is not None
    speeds = np.full((SHARES.size, 1), np.hypot(0.5, 0.4))
    assert values["speed"] == pytest.approx(speeds, rel=1e-6)
    assert np.tan(values["rudder"]) == pytest.approx(np.full((SHARES.size, 1), 0.8), rel=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("angle", [2.0, 1.2])
def test_gravity_tunnels_take_the_time_of_their_hypocycloid(angle):
    assert solve(tunnel(angle)).cost == pytest.approx(
        np.sqrt(angle * (2 * np.pi - angle)), rel=1e-4
    )
