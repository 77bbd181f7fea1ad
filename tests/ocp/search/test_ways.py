"""Solves that end in time, whatever happens inside, and that are tried in other ways."""

import os
import time
from dataclasses import replace
from itertools import islice

import casadi as ca
import numpy as np
import pytest
from benchmarks.suite.table import BY_NAME

from external.published_problems import cart_pole_slopes
from helpers import refused, tells
from microbot_ocp import Status
from microbot_ocp._base import deadline
from microbot_ocp._base.child_process import Died, OutOfTime, in_child
from microbot_ocp.ocp import verify
from microbot_ocp.ocp.problem import OptimalControlProblem
from microbot_ocp.ocp.search import _other_starts, _solve, solve
from microbot_ocp.ocp.solvers import SolverSettings, _run
from microbot_ocp.ocp.starts import Rollouts, completed, default_guess, scaled
from microbot_ocp.ocp.transcription import Guess
from microbot_ocp.ocp.transcription.schemes import within_bounds
from microbot_ocp.ocp.verification import better_controls
from ocp.textbook import double_integrator


def hypersensitive(duration=1e4):
    problem = OptimalControlProblem("hypersensitive")
    phase = problem.phase("all", duration)
    x = phase.state("x", initial=1.5, final=1.0)
    u = phase.control("u", shape="linear")
    phase.derivative(x, -(x**3) + u)
    phase.running_cost(0.5 * (x**2 + u**2))
    return problem


# time ---------------------------------------------------------------------------------------------


def test_fatrop_ends_at_the_time_limit_where_it_would_never():
    began = deadline.worked()
    settings = SolverSettings("fatrop")
    solution = solve(hypersensitive(), 50, None, settings, scheme="shooting", time_limit=0.5)
    assert deadline.worked() - began < 2.0
    assert solution.status is Status.TIME_LIMIT
    assert solution.attempts[0].iterations == 0


def test_a_mesh_that_is_too_coarse_for_the_dynamics_is_no_success():
    solution = solve(hypersensitive(), 50)
    assert solution.status is Status.TOO_COARSE
    tells(solution.advice, "one interval", "0.052")
    assert all(attempt.way != "on a finer mesh" for attempt in solution.attempts)
    assert abs(solution.cost / 1.3308069 - 1) > 1.0


@pytest.mark.thorough
@pytest.mark.slow
def test_controls_that_are_constant_do_not_replace_a_far_cheaper_answer():
    reactor = BY_NAME["kinetic_batch_reactor"]
    assert reactor.guess is not None
    solution = solve(reactor.build(), guess=reactor.guess(), time_limit=300.0)
    assert solution.solved, solution.advice
    assert reactor.error(solution.cost) < 1e-4


@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", [None, 1e-6])
def test_what_never_returned_is_solved_by_default(accuracy):
    solution = solve(hypersensitive(), accuracy=accuracy)
    assert solution.status.solved
    assert solution.cost == pytest.approx(1.3308069, rel=1e-4)


def test_a_solve_in_progress_is_stopped():
    began = deadline.worked()
    solution = solve(hypersensitive(), 4000, time_limit=0.3)
    assert solution.status is Status.TIME_LIMIT
    refined = solve(hypersensitive(), 4000, accuracy=1e-9, time_limit=0.3)
    assert refined.status is Status.TIME_LIMIT
    assert deadline.worked() - began < 20.0  # most of it builds the program
    with refused("time_limit", "above 0 s", "0.0"):
        solve(double_integrator(), 4, time_limit=0.0)


def test_work_in_a_child_comes_back_or_ends():
    soon = time.perf_counter() + 5.0
    begun = []

    def begins(then):
        def work(send):
            send(os.getpid())
            return then()

        return work

    def heard(process):
        begun.append(process)
        return True

    found = in_child(begins(lambda: {"x": np.arange(3.0), "process": os.getpid()}), soon, heard)
    assert begun == [found["process"]]
    assert found["x"].tolist() == [0.0, 1.0, 2.0]
    assert found["process"] != os.getpid()
    with pytest.raises(OutOfTime):
        in_child(begins(lambda: time.sleep(60.0)), time.perf_counter() + 0.1, heard)
    with pytest.raises(Died):
        in_child(begins(lambda: os._exit(3)), soon, heard)
    with pytest.raises(KeyboardInterrupt):
        in_child(begins(lambda: None), soon, lambda process: not heard(process))
    assert len(begun) == 4
    for process in begun:  # nothing is left
        with pytest.raises(ChildProcessError):
            os.waitpid(process, os.WNOHANG)


# meshes -------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_the_default_mesh_is_fine_enough_for_layers():
    """x and u decay within a few seconds at both ends; by quadrature 1.3308069 over 25 s."""
    problem = hypersensitive(25.0)
    solution = solve(problem)
    assert solution.status.solved
    assert solution.cost == pytest.approx(1.3308069, rel=1e-4)
    assert solution.attempts[-1].way == "on a finer mesh"


# other ways ---------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_another_duration_is_tried_where_the_first_fails():
    """Bang-bang control of an oscillator that needs longer than the first guess, Luus."""
    problem = OptimalControlProblem("oscillator")
    phase = problem.phase("calm", (1.0, 100.0))
    x = phase.state("x", initial=10.0, final=0.0)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, -x + u)
    phase.end_cost(phase.duration)
    solution = solve(problem, 40)
    assert solution.status.solved
    alone = solve(problem, 40, settings=SolverSettings("ipopt"))
    assert len({attempt.way for attempt in alone.attempts}) == 1


# guesses and scales -------------------------------------------------------------------------------


def test_a_free_end_is_guessed_at_the_value_of_the_start():
    problem = OptimalControlProblem("tank")
    phase = problem.phase("drain", 1.0)
    volume = phase.state("volume", initial=7.0)
    phase.derivative(volume, -1 / volume)
    phase.end_cost(volume)
    line = default_guess(problem)["drain"].values["volume"]
    assert line(np.array([0.0, 1.0])).ravel().tolist() == [7.0, 7.0]
    assert solve(problem, 10).cost == pytest.approx(np.sqrt(47.0), rel=1e-8)


def test_a_rollout_follows_the_dynamics():
    problem = OptimalControlProblem("decay")
    phase = problem.phase("fall", 2.0)
    x = phase.state("x", initial=3.0)
    u = phase.control("u", lower=0.0, upper=2.0)
    phase.derivative(x, -x * u)
    phase.running_cost(u**2 + x)
    guess = completed(problem, "rollout")["fall"]
    times = np.linspace(0.0, 1.0, 5)
    share = guess.values["u"].item()
    np.testing.assert_allclose(
        guess.values["x"](times).ravel(), 3 * np.exp(-2 * share * times), rtol=1e-3
    )
    assert solve(problem, 10, "rollout").status.solved
    with refused("guess", "'rollout'", "'simulate'"):
        solve(problem, 10, "simulate")


def test_rounding_errors_of_a_guess_are_no_scale():
    problem = double_integrator()
    guess = {"move": Guess(2.0, {"u": 1e-16 * np.ones(21)[:, None], "v": 1e-17})}
    (phase,) = scaled(problem, guess).phases
    assert [float(v.scale[0]) for v in (*phase.states, *phase.controls)] == [1.0, 1.0, 1.0]
    assert solve(problem, 20, guess).status.solved


# controls between the collocation points ----------------------------------------------------------


def test_polynomial_controls_keep_their_bounds_and_their_mean():
    points = [0.155051, 0.644949, 1.0]
    weights = np.array([0.376403, 0.512486, 0.111111])
    values = np.array([[[1.0], [1.0], [-1.0]], [[0.1], [0.2], [0.3]], [[-1.0], [1.0], [1.0]]])
    kept = within_bounds(values, points, np.array([-1.0]), np.array([1.0]))
    np.testing.assert_array_equal(kept[1], values[1])
    s = np.linspace(0, 1, 201)
    for own, old in zip(kept[..., 0], values[..., 0], strict=True):
        along = np.polyval(np.polyfit(points, own, 2), s)
        assert np.abs(along).max() < 1 + 1e-3
        assert own @ weights == pytest.approx(old @ weights, abs=1e-5)


@pytest.mark.thorough
def test_a_bang_bang_answer_is_within_its_bounds_everywhere():
    problem = double_integrator("auto")
    solution = solve(problem, 15)
    u = solution["move"].sample(np.linspace(0.0, solution.duration, 500))["u"]
    assert np.abs(u).max() <= 1.0 + 1e-7
    assert not [use for use in verify(problem, solution).limits if use.excess > 1e-6]


# optima that a solver stands beside ---------------------------------------------------------------


def oil_shale():
    """Most bitumen from oil shale (Luus): on some intervals either bound is a local optimum."""
    problem = OptimalControlProblem("oil shale")
    phase = problem.phase("heat", 10.0)
    kerogen = phase.state("kerogen", initial=1.0)
    bitumen = phase.state("bitumen", initial=0.0)
    temperature = phase.control("temperature", lower=698.15, upper=748.15)
    factors = (8.86, 24.25, 23.67, 18.75, 20.70)
    energies = (10215.4, 18820.5, 17008.9, 14190.8, 15599.8)
    k = [ca.exp(a - b / temperature) for a, b in zip(factors, energies, strict=True)]
    phase.derivative(kerogen, -k[0] * kerogen - (k[2] + k[3] + k[4]) * kerogen * bitumen)
    phase.derivative(bitumen, k[0] * kerogen - k[1] * bitumen + k[2] * kerogen * bitumen)
    phase.end_cost(-bitumen)
    return problem


@pytest.mark.thorough
def test_controls_in_the_higher_of_two_valleys_are_seen_and_left():
    alone = solve(oil_shale(), 100, settings=SolverSettings("ipopt"))
    assert alone.status is Status.TOO_COARSE
    gain, controls = better_controls(alone)
    assert 1e-4 < gain < 5e-4
    assert controls["heat"]["temperature"].shape == (100, 3, 1)
    better = solve(oil_shale(), 100)
    assert better.status.solved
    assert -better.cost == pytest.approx(0.35372, rel=1e-4)
    assert alone.cost - better.cost == pytest.approx(gain, rel=0.3)
    assert better_controls(better)[0] < 0.1 * gain


def cart_pole(force: float, shape: str = "auto") -> OptimalControlProblem:
    """Kelly's swing-up in 2 s: from straight lines 58.81, a local optimum; 57.945 is known."""
    problem = OptimalControlProblem("cart-pole")
    phase = problem.phase("swing", 2.0)
    x = phase.state("x", initial=0.0, final=1.0, lower=-2.0, upper=2.0)
    angle = phase.state("angle", initial=0.0, final=np.pi)
    v = phase.state("v", initial=0.0, final=0.0)
    rate = phase.state("rate", initial=0.0, final=0.0)
    u = phase.control("u", lower=-force, upper=force, shape=shape)
    gain, turn = cart_pole_slopes(rate, u, ca.sin(angle), ca.cos(angle))
    phase.derivative(x, v)
    phase.derivative(angle, rate)
    phase.derivative(v, gain)
    phase.derivative(rate, turn)
    phase.running_cost(u**2)
    return problem


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("force", "scheme", "mesh", "cost"),
    [
        pytest.param(20.0, "radau", 40, 57.945, marks=pytest.mark.thorough),
        pytest.param(20.0, "shooting", 80, 57.946, marks=pytest.mark.thorough),
        (8.6, "radau", 30, 61.47),  # the first answer, 76.77, has none on the coarse mesh
    ],
)
def test_an_answer_is_compared_with_those_of_other_starts(force, scheme, mesh, cost):
    solution = solve(
        cart_pole(force, "auto" if scheme == "radau" else "linear"), mesh, scheme=scheme
    )
    assert solution.attempts[-1].status.solved
    assert solution.cost < cost + 0.01


def test_controls_without_bounds_are_simulated_within_what_a_solution_takes():
    problem = OptimalControlProblem("free control")
    phase = problem.phase("all", 1.0)
    x = phase.state("x", initial=0.0)
    u = phase.control("u")
    phase.derivative(x, u)
    phase.running_cost(u**2)
    ordinary = default_guess(problem)
    assert len(Rollouts(problem, ordinary).nearest_first(steps=True)) == 1
    ranges = {"all": {"u": (np.array([-1.0]), np.array([3.0]))}}
    found = Rollouts(problem, ordinary, ranges).nearest_first(steps=True)
    values = [guess["all"].values["u"] for guess in found]
    assert len(found) == 10
    constant = sorted(float(value[0]) for value in values if not callable(value))
    np.testing.assert_allclose(constant, [-1.0, -0.6, -0.2, 1.0, 2.2, 3.0])


@pytest.mark.thorough
def test_other_starts_have_other_values_of_free_parameters():
    """When to leave for a target that goes to and fro: the effort has a valley at every turn."""
    t = np.linspace(0.0, 20.0, 200001)
    d = 5 + 2 * np.sin(t + 2) + np.cos(2.2 * (t + 2))
    w = 2 * np.cos(t + 2) - 2.2 * np.sin(2.2 * (t + 2))
    solution = solve(BY_NAME["departure"].build())
    assert solution.status.solved
    assert solution.cost == pytest.approx((1.5 * d**2 - 3 * d * w + 2 * w**2).min(), rel=1e-6)


@pytest.mark.thorough
def test_a_guess_at_a_kink_is_moved_off_it():
    """The norm of two controls that are guessed at zero has no slope there."""
    problem = OptimalControlProblem("fuel")
    phase = problem.phase("move", (1.0, 10.0))
    x = phase.state("x", 2, initial=[0.0, 0.0], final=[3.0, 4.0])
    u = phase.control("u", 2)
    phase.derivative(x, u)
    phase.constraint("speed", ca.norm_2(u), 0.5, 2.0)
    phase.end_cost(phase.duration)
    assert solve(problem).cost == pytest.approx(2.5, rel=1e-6)


@pytest.mark.thorough
def test_an_answer_far_smaller_than_its_scales_is_solved_again():
    """New crystals are 1e-8 of what rates let expect, and in such scales any cost is settled."""
    crystalliser = BY_NAME["crystalliser"]
    solution = solve(crystalliser.build())
    assert solution.status.solved
    assert crystalliser.error(solution.cost) < 1e-5
    assert any(a.way == "with the scales of the first answer" for a in solution.attempts)


@pytest.mark.thorough
def test_no_more_starts_are_tried_where_the_first_agree(monkeypatch):
    solved = []
    inner = _other_starts._CoarseSolver.solved

    def counted(coarse, guess):
        solved.append(guess)
        return inner(coarse, guess)

    monkeypatch.setattr(_other_starts._CoarseSolver, "solved", counted)
    first = solve(double_integrator())
    assert first.status.solved
    count = len(solved)
    # The answer itself is compared, too.
    assert count <= 1 + _other_starts.ENOUGH_AGREE + _other_starts.LEAST_SIMULATIONS
    solve(double_integrator(), 20, first)
    assert len(solved) == count  # a solution was compared when it was found


def test_curves_that_agree_are_enough_where_there_are_few_simulations(monkeypatch):
    """Without controls there may be one simulation only; 24 curves followed it."""
    inner = _other_starts._starts
    monkeypatch.setattr(_other_starts, "_starts", lambda *given: islice(inner(*given), 1))
    problem = OptimalControlProblem("decay")
    rate = problem.free_parameter("rate", lower=0.0, upper=5.0)
    phase = problem.phase("all", 2.0)
    x = phase.state("x", initial=1.0)
    phase.derivative(x, -rate * x)
    y = phase.measurement("y", [0.5, 1.0, 2.0], np.exp([-0.35, -0.7, -1.3]))
    phase.point_cost((x - y) ** 2)
    solution = solve(problem)
    assert solution.status.solved
    least = _other_starts.ENOUGH_AGREE
    assert least <= solution.compared <= least + _other_starts.LEAST_SIMULATIONS


@pytest.mark.thorough
def test_a_heading_between_two_places_of_rest_is_found():
    """Energy is kept, so that the speed at the end follows from the place: 11 % above were left."""
    tunnel = BY_NAME["tunnel_through_the_earth"]
    solution = solve(tunnel.build())
    assert solution.status.solved
    assert tunnel.error(solution.cost) < 1e-4


@pytest.mark.thorough
def test_a_fit_in_many_phases_is_solved_in_bounded_work():
    """Twenty phases of 23 linked states: 460 equations of 19,000 variables depend on few each."""
    marine = BY_NAME["marine_population_in_phases"]
    assert marine.guess is not None
    solution = solve(marine.build(), guess=marine.guess(), time_limit=300.0)
    spent = {row.strategy: row.seconds for row in solution.ledger}
    assert sum(spent.values()) < 9.0 * spent["as given"]  # on a machine of any speed
    assert solution.status.solved
    assert marine.error(solution.cost) < 1e-5


def test_of_simulations_that_are_as_near_the_cheapest_comes_first():
    """Nothing is asked of the end, so all are as near; heat kills what costs, and then too much."""
    problem = OptimalControlProblem("plateau")
    phase = problem.phase("heat", 10.0)
    hot = phase.state("hot", initial=0.0)
    killed = phase.state("killed", initial=0.0)
    u = phase.control("u", lower=0.0, upper=1.0)
    phase.derivative(hot, u)
    phase.derivative(killed, ca.exp(3 * (hot - 9)))
    phase.end_cost((killed - 2) ** 2)
    simulations = Rollouts(problem, default_guess(problem))

    def cost(guess):
        return float((guess["heat"].values["killed"](np.ones(1))[0, 0] - 2) ** 2)

    costs = [cost(guess) for guess in simulations.nearest_first(steps=True, cost=cost)]
    assert len(costs) == 10
    assert costs == sorted(costs)
    assert costs[0] < 4.0 < costs[-1]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("agreed", "compared"), [pytest.param(1, 9, marks=pytest.mark.thorough), (2, 41)]
)
def test_the_least_of_several_optima_beside_which_others_may_be_is_no_solution(
    monkeypatch, agreed, compared
):
    def lone(solution, *_):
        return replace(solution, rivals=(0.0, 0.2), agreed=agreed, compared=compared), []

    monkeypatch.setattr(_solve, "cheaper_elsewhere", lone)
    found = solve(double_integrator())
    assert found.status is Status.LOCAL_OPTIMUM
    assert found.cost == pytest.approx(2.0, rel=1e-6)
    tells(found.advice, found.status.sentence, "1 more", "0.2")
    refined = solve(double_integrator(), accuracy=1e-6)
    assert refined.status is Status.LOCAL_OPTIMUM
    assert refined.cost == pytest.approx(2.0, rel=1e-6)
    tells(refined.advice, refined.status.sentence)


def test_scales_of_states_behind_fast_ones_are_those_of_a_simulation():
    """Rates times the duration would make the second 1e4 and the third 1e6, instead of one."""
    problem = OptimalControlProblem("fast chain")
    phase = problem.phase("only", 100.0)
    a, b, c = (phase.state(name, initial=float(name == "a")) for name in "abc")
    u = phase.control("u", lower=0.9, upper=1.1)
    phase.derivative(a, -100 * u * a)
    phase.derivative(b, 100 * u * a - 100 * b + 100 * c)
    phase.derivative(c, 100 * b - 100 * c)
    phase.end_cost(c**2)
    own = scaled(problem).phases[0].states
    assert [float(state.scale[0]) for state in own] == [1.0, 1.0, 1.0]


@pytest.mark.thorough
def test_where_optima_are_near_the_best_of_several_is_kept_and_it_is_said():
    """Newton's body of least resistance: its slopes have two valleys, and a solve ends in any."""
    newton = BY_NAME["newton"].build()
    how = None, SolverSettings(), "radau", None, None
    task = _solve.SolveTask(newton, 20, *how)
    (start,) = _solve._displaced(task, [])
    first = start.context.solve(start.mesh, start.guess)
    solution, _ = _solve._finished(task, "", first, start)
    assert solution.cost == pytest.approx(1.49926395, rel=1e-3)  # 1.50668 from the guess
    assert len(solution.rivals) > 1
    assert solution.rivals[0] == 0.0
    tells(solution.advice, "local optima", f"{len(solution.rivals) - 1} more")


@pytest.mark.thorough
def test_a_solver_that_is_ended_leaves_its_last_iterate(monkeypatch):
    monkeypatch.setattr(_run, "_plain", lambda *_: time.sleep(60.0))
    monkeypatch.setattr(_run, "LARGE_PROGRAM", 0)  # every solve in a process of its own
    whole = solve(double_integrator(), 10, settings=SolverSettings("ipopt"), time_limit=1.0)
    assert whole.status is Status.TIME_LIMIT
    assert whole.attempts[0].iterations > 3
    assert whole.cost == pytest.approx(2.0, rel=1e-4)
    assert whole.attempts[0].infeasibility < 1e-6


def test_where_the_bounds_of_a_duration_say_little_a_simulation_tells_it():
    """A million kilometres at 1 mm/s²: two million seconds, the usual guess is 32 s."""
    problem = OptimalControlProblem("far")
    phase = problem.phase("only", (1.0, 1e9))
    x, v = (phase.state(name, initial=0.0, final=end) for name, end in (("x", 1e9), ("v", 0.0)))
    u = phase.control("u", lower=-1e-3, upper=1e-3)
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.end_cost(phase.duration)
    nearest = Rollouts(problem, default_guess(problem)).of_any_duration()[0]["only"]
    assert nearest.duration == pytest.approx(2e6, rel=0.6)


def test_a_process_that_loops_in_silence_is_ended_by_its_own_time() -> None:
    def loops(send):
        for _ in range(3):
            send("here")
        while True:
            pass

    heard: list[str] = []
    with pytest.raises(OutOfTime):
        in_child(loops, np.inf, lambda what: not heard.append(what), silence=0.1)
    assert heard == ["here"] * 3


def test_a_process_that_waits_for_others_is_not_silent() -> None:
    def waits(_):
        time.sleep(0.5)
        return "done"

    assert in_child(waits, np.inf, silence=0.05) == "done"


@pytest.mark.thorough
def test_of_what_did_not_converge_what_keeps_the_limits_is_returned():
    """Tables with corners: no solver ends, the first is 26 % off and far from the dynamics."""
    climb = BY_NAME["climb"]
    assert climb.guess is not None
    solution = solve(climb.build(), guess=climb.guess())
    assert not solution.solved
    assert climb.error(solution.cost) < 1e-3


def fuller(tied: bool) -> OptimalControlProblem:
    """Fuller's chattering problem with drag, whose force is a control of its own if tied."""
    problem = OptimalControlProblem("Fuller with drag")
    phase = problem.phase("damp", 4.0)
    x = phase.state("x", initial=1.0, final=0.0)
    v = phase.state("v", initial=0.0, final=0.0)
    u = phase.control("u", lower=-1.0, upper=1.0)
    force = u - 0.1 * v**3
    if tied:
        drag, total = phase.control("drag"), phase.control("force")
        phase.constraint("drag", drag - 0.1 * v**3, 0.0, 0.0)
        phase.constraint("force", total - (u - drag), 0.0, 0.0)
        force = total
    phase.derivative(x, v)
    phase.derivative(v, force)
    phase.running_cost(x**2)
    return problem


@pytest.mark.thorough
@pytest.mark.slow
def test_controls_tied_by_equations_stay_free_where_others_become_constant():
    free, tied = solve(fuller(tied=False)), solve(fuller(tied=True))
    assert free.status.solved
    assert tied.status.solved
    assert tied.cost == pytest.approx(free.cost, rel=2e-4)
    assert tied.phases[0].laid_out.phase.shaped("polynomial")


@pytest.mark.slow
def test_a_control_with_limits_becomes_constant_where_one_without_follows_from_it():
    problem = OptimalControlProblem("singular regulator")
    phase = problem.phase("calm", 5.0)
    x, v = phase.state("x", initial=0.0), phase.state("v", initial=1.0)
    u, total = phase.control("u", lower=-1.0, upper=1.0), phase.control("total")
    phase.constraint("total", total - (u - 0.1 * ca.tanh(v)), 0.0, 0.0)
    phase.derivative(x, v)
    phase.derivative(v, total + 0.1 * ca.tanh(v))
    phase.running_cost(x**2 + v**2)
    solution = solve(problem)
    assert solution.status.solved
    assert BY_NAME["luus_singular_3"].error(solution.cost) < 1e-4
    assert not any("Missing" in row.sentence for row in solution.rows)
