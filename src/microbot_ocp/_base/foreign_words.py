"""Words of other tools for optimal control (rockit, CasADi's Opti, dymos, GPOPS), and ours."""

from __future__ import annotations

from typing import NoReturn

from microbot_ocp._base.checks import did_you_mean

_SEVERAL = {  # a line of ours, and words for it
    'problem = ocp.OptimalControlProblem("name")': "Ocp OCP Opti Problem Stage stage",
    "problem.phase(name, duration)": "add_phase new_stage stages",
    "phase.state(name, initial=, final=) of a phase": "state states_ add_state differential_state",
    "phase.control(name, lower=, upper=) of a phase": "control controls_ add_control input",
    "phase.derivative(state, expression)": "der set_der set_next ode dynamics rhs add_ode",
    "phase.running_cost(...), phase.end_cost(...) or problem.cost(...)": (
        "minimize minimise add_objective objective_function set_objective cost_function lagrange "
        "mayer"
    ),
    'phase.constraint("name", x <= 1), bounds by lower= and upper=, ends by initial= and final=': (
        "subject_to add_constraint path_constraint path boundary_constraint bound bounds"
    ),
    "phase.initial(x) and phase.final(x)": "at_t0 at_tf at_t final_value initial_value",
    "phase.parameter(name, value) for data, problem.free_parameter(name) for what is to be found": (
        "parameter parameters_ variable param p add_parameter"
    ),
    "parameters= of ParametricSolver.solve": "set_value set_parameter update",
    'guess={"phase": ocp.Guess(duration, {"x": ...})} of solve': (
        "set_initial set_guess x0 initial_guess init warm_start guesses"
    ),
    "ocp.solve(problem)": "solve optimize run_driver optimise run",
    "mesh=20 of solve, a number of intervals or fractions": (
        "N n intervals nodes mesh_size K num_intervals num_segments number_of_intervals grid"
    ),
    'scheme="shooting", "radau", "gauss", "trapezoidal", "hermite_simpson" of solve': (
        "method transcription MultipleShooting DirectCollocation DirectMethod SingleShooting "
        "collocation degree order"
    ),
    'settings=ocp.SolverSettings("ipopt", tolerance=..., options={"ipopt": {...}}) of solve': (
        "solver tol tolerance options opts max_iter max_iterations solver_options ipopt"
    ),
    "time_limit= of solve": "timeout max_time max_wall_time",
    'solution["phase"]["x"] at mesh points, solution["phase"].sample(t) between': (
        "value x u x_opt u_opt get_val states controls sample sampler xs us get_state X U"
    ),
    'solution["phase"].t': "t time ts grid_",
    "solution.status, solution.solved, solution.advice": "stats success is_success return_status",
    "solution.cost, or solution.objective": "f J objective_value fun cost_value obj optimal_cost",
    "row_multipliers, variable_multipliers and solution.sensitivities()": "lam_g lam_x dual",
    "phase.time": "t_ independent_variable",
    "duration=1.0, or a free one within (0.1, 100.0), of problem.phase": "T t0 tf t_f horizon",
    "lower= and upper=": "lb ub lower_bound upper_bound lbx ubx min max minimum maximum",
    "no integer controls: relax it to a range, or give every mode a phase of its own": (
        "integer discrete binary domain is_integer mixed_integer boolean"
    ),
}
WORDS = {word: ours for ours, words in _SEVERAL.items() for word in words.split()}


def remedy(word: str) -> str:
    """Return what to write for a foreign word; nothing for an unknown one.

    >>> remedy("T")
    '; here: duration=1.0, or a free one within (0.1, 100.0), of problem.phase'
    """
    return f"; here: {WORDS[word]}" if word in WORDS else ""


class Hinting:
    """An object that says what it calls an attribute that it has not."""

    def __getattr__(self, name: str) -> NoReturn:
        here = [n for n in (*dir(type(self)), *self.__dict__) if not n.startswith("_")]
        hint = "" if name.startswith("_") else remedy(name) or did_you_mean(name, here)
        raise AttributeError(f"{type(self).__name__} has no {name!r}{hint}")
