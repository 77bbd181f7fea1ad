"""Translations of the names that other tools use: for optimal control (rockit, CasADi's Opti,
dymos, GPOPS), and for arms (Robotics Toolbox, Pinocchio, Drake, MoveIt, ruckig).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NoReturn

from microbot_ocp._base.checks import did_you_mean

_SEVERAL = {  # our call: foreign names for it
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
_OF_ARMS = {
    "mo.forward_kinematics(robot)(q)": "fkine fkine_all fk forwardKinematics frame_placement",
    "mo.jacobian(robot)(q)": "jacob0 jacobe jacobian computeJointJacobians",
    "mo.solve_ik(robot, position, orientation) or mo.solve_ik_all": (
        "ikine ikine_LM ik_LM ikine_a ik inverse_kinematics"
    ),
    "mo.inverse_dynamics(robot)(q, qd, qdd)": "rne rnea inverse_dynamics CalcInverseDynamics",
    "mo.forward_dynamics(robot)(q, qd, tau)": "accel aba fdyn forward_dynamics",
    "mo.mass_matrix(robot)(q)": "inertia crba mass_matrix CalcMassMatrix",
    "mo.coriolis_matrix(robot)(q, qd)": "coriolis computeCoriolisMatrix",
    "mo.gravity_torque(robot)(q)": "gravload gravity_torque computeGeneralizedGravity",
    "robot.limits.q_min, robot.limits.q_max": (
        "q_min q_max qlim lowerPositionLimit upperPositionLimit GetPositionLowerLimits"
    ),
    "robot.limits.qd_max": "qd_max v_max velocityLimit velocity_limits qdlim",
    "robot.limits.qdd_max": "qdd_max a_max acceleration_limits",
    "robot.limits.qddd_max": "qddd_max jerk_max jerk_limits",
    "robot.limits.tau_max": "tau_max torque_max effortLimit effort_limits torque_limits",
    "robot.joint_count": "n nq nv dof dofs n_joints njoints num_positions num_joints",
    "mo.views.studio(robot)": "teach",
    "mo.save_robot(robot, path)": "save to_urdf write",
    "mo.load_robot(name_or_path)": "URDF from_urdf load_urdf buildModelFromUrdf",
    "motion.duration": "tf T total_time",
    "motion.q, .qd, .qdd, .tau": "positions velocities accelerations efforts torques",
    "mo.time_optimal(robot, via_q), mo.quintic(via_q, via_t)": "jtraj mtraj ctraj plan",
    "comparison.plot().savefig(path)": "savefig",
}
_NAMES = {  # arguments and attributes: foreign names for them
    "q_min": "qmin lower_limits position_min lower_position",
    "q_max": "qmax upper_limits position_max upper_position",
    "qd_max": "v_max vmax velocity max_velocity velocity_max velocity_limit velocity_limits "
    "v_limit speed speed_max dq_max qdot_max vel_max max_vel joint_velocity",
    "qdd_max": "a_max amax acceleration max_acceleration acceleration_max acceleration_limits "
    "ddq_max qddot_max acc_max max_acc",
    "qddd_max": "j_max jmax jerk max_jerk jerk_max jerk_limits dddq_max",
    "tau_max": "torque max_torque torque_max torque_limits effort max_effort effort_max u_max "
    "effort_limits",
    "taud_max": "torque_rate max_torque_rate torque_rate_max dtau_max",
    "via_q": "waypoints via points viapoints via_points poses stops",
    "via_t": "times timestamps time_stamps via_times",
    "position": "pos xyz translation",
    "orientation": "rotation rot R",
    "center_of_mass": "com center centre",
    "payload": "load tool_mass",
    "dwell": "wait pause",
    "rate": "frequency freq hz",
    "limits": "constraints bounds",
    "alpha": "twist", "theta_offset": "theta offset", "joint_type": "sigma joint_types",
    "controller": "control law", "joint_count": "n nq nv dof dofs",
}  # fmt: skip


def _by_word(lines: Mapping[str, str]) -> dict[str, str]:
    return {word: ours for ours, words in lines.items() for word in words.split()}


WORDS, WORDS_OF_ARMS, NAMES = map(_by_word, (_SEVERAL, _OF_ARMS, _NAMES))


def our_name(word: str, there: Iterable[str]) -> str:
    """Return the question for our name of a foreign word, if that name exists here.

    >>> our_name("v_max", ["q_max", "qd_max"])
    "; did you mean 'qd_max'?"
    """
    return f"; did you mean {NAMES[word]!r}?" if NAMES.get(word) in set(there) else ""


def remedy(word: str, words: Mapping[str, str] = WORDS) -> str:
    """Return the call that replaces a foreign word; nothing for an unknown word.

    >>> remedy("T")
    '; here: duration=1.0, or a free one within (0.1, 100.0), of problem.phase'
    """
    return f"; here: {words[word]}" if word in words else ""


class Hinting:
    """An object whose AttributeError names the attribute that the user may have meant."""

    _foreign = WORDS

    def __getattr__(self, name: str) -> NoReturn:
        here = [n for n in (*dir(type(self)), *self.__dict__) if not n.startswith("_")]
        hint = ""
        if not name.startswith("_"):
            hint = remedy(name, self._foreign) or our_name(name, here) or did_you_mean(name, here)
        raise AttributeError(f"{type(self).__name__} has no {name!r}{hint}")


class HintingOfArms(Hinting):
    """An object of robotics, whose errors know the names of other tools for arms."""

    _foreign = WORDS_OF_ARMS
