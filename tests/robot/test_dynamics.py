"""Dynamics against the course report, closed forms and the laws of mechanics."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from hypothesis.extra.numpy import arrays

import microbot_ocp as mo
from helpers import any_robot, batch, difference, random_states, refused, two_link_arm

ROBOTS = ("microbot", "rp", "rprr", "rrrprrr")
robots = st.sampled_from(ROBOTS)


def values(robot: mo.Robot) -> st.SearchStrategy[np.ndarray]:
    return arrays(float, robot.joint_count, elements=st.floats(-3.0, 3.0))


# ---- the course report, parts 4a and 6, recomputed
# q_i(t) = 45 deg (1 + 6 exp(-t/0.3) - 8 exp(-t/0.4)) for all three joints, g = 9.8 m/s^2.
# t -> torques (N m) with gravity along base -Z; along base -Y, as the report's own code has it
# (its base acceleration is [0, g, 0]); without gravity.
REPORT_TORQUES = {
    0.0: (
        (235.61944901923476, 2058.585137187041, 1059.9021878651968),
        (294.4194490192347, 1861.192208074477, 1004.4650162201714),
        (235.61944901923476, 1975.4293797195025, 1059.9021878651968),
    ),
    0.2: (
        (469.67231076213415, 591.2980393763976, 192.79165224681222),
        (571.7167076588066, 387.14598031667833, 123.45683337560033),
        (469.67231076213415, 467.1355336883915, 165.28007196138435),
    ),
    0.4: (
        (309.9547493417326, 10.723791907752101, -80.2232182874609),
        (481.78284427647276, -189.30244072469296, -158.13087874012896),
        (309.9547493417326, -168.2685155541987, -146.32249559156023),
    ),
    1.0: (
        (-186.15243234564886, -55.397267151766165, -43.35613610725396),
        (-44.196650494228265, -258.78372421189255, -119.09930142086182),
        (-186.15243234564883, -212.13210726918606, -93.57987803348333),
    ),
    1.5: (
        (-28.531574104917517, 21.072071360525975, -26.43644832068819),
        (57.92750516848891, -181.80117628071054, -91.80849110262103),
        (-28.53157410491752, -89.17864072588414, -44.464738164748994),
    ),
    2.0: (
        (-5.227998812758696, 61.50629782183369, -10.189459776884727),
        (62.0107280155575, -138.08445843247506, -69.12791627357439),
        (-5.227998812758695, -30.308544647580064, -15.882341326481674),
    ),
}
GRAVITIES = {"along -Z": (0.0, 0.0, -9.8), "along -Y": (0.0, -9.8, 0.0), "none": (0.0, 0.0, 0.0)}


def report_state(t: float) -> list[np.ndarray]:
    fast, slow = 6 * np.exp(-t / 0.3), 8 * np.exp(-t / 0.4)
    shape = (1 + fast - slow, -fast / 0.3 + slow / 0.4, fast / 0.09 - slow / 0.16)
    return [np.full(3, np.pi / 4 * value) for value in shape]


@pytest.mark.parametrize("t", REPORT_TORQUES)
@pytest.mark.parametrize(("column", "gravity"), list(enumerate(GRAVITIES.values())), ids=GRAVITIES)
def test_torques_of_the_report_trajectory(
    microbot: mo.Robot, t: float, column: int, gravity: tuple[float, ...]
) -> None:
    robot = microbot.with_gravity(gravity)
    tau = np.array(mo.inverse_dynamics(robot)(*report_state(t)))[:, 0]
    assert tau == pytest.approx(REPORT_TORQUES[t][column], rel=1e-11)


def test_packaged_microbot_has_the_gravity_of_the_report_upright(microbot: mo.Robot) -> None:
    assert microbot.gravity.tolist() == [0.0, 0.0, -9.8]
    states = np.array([report_state(t) for t in np.linspace(0.0, 2.0, 41)]).swapaxes(0, 1)
    peaks = np.abs(batch(mo.inverse_dynamics(microbot), *states)).max(axis=0)
    assert peaks == pytest.approx([520, 2059, 1060], abs=0.6)


# ---- Craig, Introduction to Robotics, section 6.7: two-link arm in closed form


def test_two_link_torques_are_craigs_closed_form() -> None:
    l1, l2, m1, m2, g = 0.7, 1.3, 2.0, 3.0, 9.81
    robot = two_link_arm(l1, l2, (m1, m2), g)
    q, qd, qdd = random_states(robot, 200)
    (t1, t2), (w1, w2), (a1, a2) = q.T, qd.T, qdd.T
    c1, s2, c2, c12 = np.cos(t1), np.sin(t2), np.cos(t2), np.cos(t1 + t2)
    first = (
        m2 * l2**2 * (a1 + a2)
        + m2 * l1 * l2 * c2 * (2 * a1 + a2)
        + (m1 + m2) * l1**2 * a1
        - m2 * l1 * l2 * s2 * w2**2
        - 2 * m2 * l1 * l2 * s2 * w1 * w2
        + m2 * l2 * g * c12
        + (m1 + m2) * l1 * g * c1
    )
    second = (
        m2 * l1 * l2 * c2 * a1
        + m2 * l1 * l2 * s2 * w1**2
        + m2 * l2 * g * c12
        + m2 * l2**2 * (a1 + a2)
    )
    ours = batch(mo.inverse_dynamics(robot), q, qd, qdd)
    assert difference(ours, np.column_stack([first, second])) < 1e-12


def test_vertical_slide_carries_its_weight_and_its_mass() -> None:
    robot = mo.Robot.from_dh(
        [0.0], [0.0], [0.5], joint_type="prismatic", links=[mo.Link(2.0, [0, 0, 0], armature=0.5)]
    )
    tau = float(mo.inverse_dynamics(robot)(1.0, 3.0, 4.0))
    assert tau == pytest.approx(2.0 * (9.81 + 4.0) + 0.5 * 4.0)


# ---- friction, in closed form


@pytest.mark.parametrize("name", ROBOTS)
def test_friction_adds_its_closed_form_and_nothing_else(name: str) -> None:
    robot = any_robot(name)
    rng = np.random.default_rng(3)
    viscous, coulomb = rng.uniform(0.0, 5.0, (2, robot.joint_count))
    rubbing = robot.with_links(
        [
            replace(link, viscous_friction=b, coulomb_friction=c)
            for link, b, c in zip(robot.links, viscous, coulomb, strict=True)
        ]
    )
    q, qd, qdd = random_states(robot, 100)
    qd[50:] *= 0.01  # half of the states within the smoothed step of the Coulomb friction
    friction = viscous * qd + coulomb * np.tanh(qd / 0.01)
    tau = batch(mo.inverse_dynamics(robot), q, qd, qdd)
    assert difference(batch(mo.inverse_dynamics(rubbing), q, qd, qdd), tau + friction) < 1e-12
    bias = batch(mo.bias_torque(robot), q, qd)
    assert difference(batch(mo.bias_torque(rubbing), q, qd), bias + friction) < 1e-12
    for unchanged in (mo.gravity_torque, mo.mass_matrix):
        assert np.array_equal(batch(unchanged(rubbing), q), batch(unchanged(robot), q))
    matrices = batch(mo.coriolis_matrix(robot), q, qd)
    assert np.array_equal(batch(mo.coriolis_matrix(rubbing), q, qd), matrices)


# ---- the laws


@given(data=st.data(), name=robots)
def test_equation_of_motion_adds_up(data: st.DataObject, name: str) -> None:
    robot = any_robot(name)
    q, qd, qdd = (data.draw(values(robot)) for _ in range(3))
    mass, coriolis = np.array(mo.mass_matrix(robot)(q)), np.array(mo.coriolis_matrix(robot)(q, qd))
    gravity, bias = (
        np.array(x)[:, 0] for x in (mo.gravity_torque(robot)(q), mo.bias_torque(robot)(q, qd))
    )
    tau = np.array(mo.inverse_dynamics(robot)(q, qd, qdd))[:, 0]
    size = 1.0 + np.abs(tau).max() + np.abs(bias).max()
    assert bias == pytest.approx(coriolis @ qd + gravity, abs=1e-11 * size)
    assert tau == pytest.approx(mass @ qdd + bias, abs=1e-11 * size)


@given(data=st.data(), name=st.sampled_from([name for name in ROBOTS if name != "microbot"]))
def test_mass_matrix_is_symmetric_positive_definite(data: st.DataObject, name: str) -> None:
    robot = any_robot(name)
    matrix = np.array(mo.mass_matrix(robot)(data.draw(values(robot))))
    assert np.array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix)[0] > 1e-3


@given(q=arrays(float, 3, elements=st.floats(-3.0, 3.0)))
def test_mass_matrix_of_point_masses_is_positive_semi_definite(
    microbot: mo.Robot, q: np.ndarray
) -> None:
    matrix = np.array(mo.mass_matrix(microbot)(q))
    assert np.linalg.eigvalsh(matrix)[0] > -1e-12 * np.abs(matrix).max()


@given(data=st.data(), name=robots)
def test_mass_matrix_rate_less_twice_coriolis_is_skew(data: st.DataObject, name: str) -> None:
    robot = any_robot(name)
    q, qd, x = (data.draw(values(robot)) for _ in range(3))
    s, w = ca.SX.sym("q", robot.joint_count), ca.SX.sym("qd", robot.joint_count)
    rate = ca.reshape(ca.jtimes(ca.vec(mo.mass_matrix(robot)(s)), s, w), len(q), len(q))
    matrix = np.array(ca.Function("rate", [s, w], [rate])(q, qd))
    skew = matrix - 2 * np.array(mo.coriolis_matrix(robot)(q, qd))
    assert x @ skew @ x == pytest.approx(0.0, abs=1e-11 * (1.0 + np.abs(skew).max()))
    assert skew == pytest.approx(-skew.T, abs=1e-12 * (1.0 + np.abs(skew).max()))


@given(data=st.data(), name=robots)
def test_energy_changes_by_the_power_of_the_torques(data: st.DataObject, name: str) -> None:
    robot = any_robot(name)
    q, qd, qdd = (data.draw(values(robot)) for _ in range(3))
    s, w = ca.SX.sym("q", robot.joint_count), ca.SX.sym("qd", robot.joint_count)
    total = sum(mo.energy(robot)(s, w))
    slopes = ca.Function("slopes", [s, w], [ca.gradient(total, s), ca.gradient(total, w)])
    by_q, by_qd = (np.array(x)[:, 0] for x in slopes(q, qd))
    power = np.array(mo.inverse_dynamics(robot)(q, qd, qdd))[:, 0] @ qd
    rate = by_q @ qd + by_qd @ qdd
    assert rate == pytest.approx(power, abs=1e-11 * (1.0 + np.abs(by_q).max() + abs(power)))


@given(data=st.data(), name=robots)
def test_power_balance_with_friction(data: st.DataObject, name: str) -> None:
    """What the torques put in is either stored or rubbed off: dE/dt = tau' qd - loss, loss >= 0."""
    smooth = any_robot(name)
    viscous, coulomb = 0.7, 1.3
    links = [
        replace(link, viscous_friction=viscous, coulomb_friction=coulomb) for link in smooth.links
    ]
    rubbing = smooth.with_links(links)
    q, qd, tau = (data.draw(values(smooth)) for _ in range(3))
    condition = float(mo.robot.mass_matrix_condition(smooth)(q))
    assume(condition < 1e6)
    qdd = np.array(mo.forward_dynamics(rubbing)(q, qd, tau))[:, 0]
    s, w = ca.SX.sym("q", smooth.joint_count), ca.SX.sym("qd", smooth.joint_count)
    total = sum(mo.energy(rubbing)(s, w))
    slopes = ca.Function("slopes", [s, w], [ca.gradient(total, s), ca.gradient(total, w)])
    by_q, by_qd = (np.array(x)[:, 0] for x in slopes(q, qd))
    loss = float(np.sum(viscous * qd**2 + coulomb * qd * np.tanh(qd / 0.01)))
    size = 1.0 + np.abs(by_q).max() + np.abs(by_qd).max() * (1.0 + np.abs(qdd).max())
    assert loss >= 0.0
    assert by_q @ qd + by_qd @ qdd == pytest.approx(tau @ qd - loss, abs=1e-12 * condition * size)


@given(data=st.data(), name=robots)
def test_gravity_torque_is_the_slope_of_the_potential(data: st.DataObject, name: str) -> None:
    robot = any_robot(name)
    q = data.draw(values(robot))
    s = ca.SX.sym("q", robot.joint_count)
    potential = mo.energy(robot)(s, 0)[1]
    slope = np.array(ca.Function("slope", [s], [ca.gradient(potential, s)])(q))[:, 0]
    expected = np.array(mo.gravity_torque(robot)(q))[:, 0]
    assert slope == pytest.approx(expected, abs=1e-11 * (1.0 + np.abs(expected).max()))


@given(data=st.data(), name=robots)
def test_forward_dynamics_undoes_inverse_dynamics(data: st.DataObject, name: str) -> None:
    robot = any_robot(name)
    q, qd, qdd = (data.draw(values(robot)) for _ in range(3))
    condition = float(mo.robot.mass_matrix_condition(robot)(q))
    assume(condition < 1e6)
    tau = mo.inverse_dynamics(robot)(q, qd, qdd)
    back = np.array(mo.forward_dynamics(robot)(q, qd, tau))[:, 0]
    size = 1.0 + np.abs(np.array(tau)).max() + np.abs(qdd).max()
    assert back == pytest.approx(qdd, abs=1e-13 * condition * size)


# ---- where the mass matrix is singular


def test_microbot_standing_straight_up_is_reported_as_singular(microbot: mo.Robot) -> None:
    upright = np.radians([20.0, 90.0, 0.0])
    matrix = np.array(mo.mass_matrix(microbot)(upright))
    assert matrix[0] == pytest.approx(np.zeros(3), abs=1e-12)
    assert float(mo.robot.mass_matrix_condition(microbot)(upright)) > 1e15
    assert float(mo.robot.mass_matrix_condition(microbot)([0.3, 0.4, 0.5])) < 1e3


def test_rotor_inertia_cures_the_singular_mass_matrix(microbot: mo.Robot) -> None:
    upright = np.radians([20.0, 90.0, 0.0])
    geared = microbot.with_links([replace(link, armature=1.0) for link in microbot.links])
    assert float(mo.robot.mass_matrix_condition(geared)(upright)) < 1e3
    zero = np.zeros(3)
    added = np.array(mo.mass_matrix(geared)(upright)) - np.array(mo.mass_matrix(microbot)(upright))
    assert added == pytest.approx(np.eye(3), abs=1e-12)
    qdd = np.array(mo.forward_dynamics(geared)(upright, zero, [2.0, 0.0, 0.0]))[:, 0]
    assert qdd[0] == pytest.approx(2.0)


def test_mass_matrix_that_is_zero_has_infinite_condition() -> None:
    """A point mass on the only axis: 0/0 must not pass as a number that compares as small."""
    robot = mo.Robot.from_dh([0.0], [0.0], [0.0], links=[mo.Link(1.0, [0.0, 0.0, 1.0])])
    assert float(mo.robot.mass_matrix_condition(robot)(0.0)) == np.inf


@pytest.mark.parametrize("name", ROBOTS)
def test_condition_is_the_one_of_numpy(name: str) -> None:
    robot = any_robot(name)
    q, _, _ = random_states(robot, 100)
    ours = batch(mo.robot.mass_matrix_condition(robot), q)[:, 0]
    theirs = [np.linalg.cond(matrix, 1) for matrix in batch(mo.mass_matrix(robot), q)]
    assert ours == pytest.approx(theirs, rel=1e-6)


# ---- arguments


@pytest.mark.parametrize(
    ("make", "inputs", "outputs"),
    [
        (mo.inverse_dynamics, ["q", "qd", "qdd"], ["tau"]),
        (mo.mass_matrix, ["q"], ["M"]),
        (mo.coriolis_matrix, ["q", "qd"], ["C"]),
        (mo.gravity_torque, ["q"], ["tau"]),
        (mo.bias_torque, ["q", "qd"], ["tau"]),
        (mo.forward_dynamics, ["q", "qd", "tau"], ["qdd"]),
        (mo.robot.mass_matrix_condition, ["q"], ["condition"]),
        (mo.energy, ["q", "qd"], ["kinetic", "potential"]),
    ],
)
def test_functions_name_their_arguments_and_need_links(
    microbot: mo.Robot, make: object, inputs: list[str], outputs: list[str]
) -> None:
    function = make(microbot)  # type: ignore[operator]
    assert function.name_in() == inputs
    assert function.name_out() == outputs
    assert make(microbot) is function  # type: ignore[operator]
    bare = replace(microbot, links=(), name="bare")
    with refused("robot 'bare'", "masses"):
        make(bare)  # type: ignore[operator]


# payload ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["microbot", "stanford", "ur5e"])
def test_a_payload_adds_what_its_own_motion_asks_for(name):
    robot, mass, place = mo.load_robot(name), 1.7, np.array([0.1, -0.2, 0.3])
    q, qd, qdd = (ca.SX.sym(key, robot.joint_count) for key in ("q", "qd", "qdd"))
    point = (mo.forward_kinematics(robot)(q) @ ca.vertcat(*place, 1.0))[:3]
    jacobian = ca.jacobian(point, q)
    acceleration = jacobian @ qdd + ca.jtimes(jacobian @ qd, q, qd)
    added = jacobian.T @ (mass * (acceleration - ca.DM(robot.gravity)))
    expected = ca.Function("tau", [q, qd, qdd], [mo.inverse_dynamics(robot)(q, qd, qdd) + added])
    state = np.random.default_rng(1).uniform(-1.5, 1.5, (3, robot.joint_count))
    loaded = mo.inverse_dynamics(robot.with_payload(mass, place))
    assert loaded(*state).full() == pytest.approx(expected(*state).full(), rel=1e-10, abs=1e-10)


def test_no_payload_is_the_same_robot():
    robot = mo.load_robot("microbot")
    assert robot.with_payload(0.0) is robot


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((-1.0,), ("mass", "payload", "0 kg", "-1.0")),
        ((np.inf,), ("mass", "payload", "finite", "inf kg")),
        ((1.0, [0.0, 0.0]), ("center_of_mass", "payload", "shape [3]", "[2]")),
    ],
)
def test_a_bad_payload_is_refused(arguments, said):
    with refused(*said):
        mo.load_robot("microbot").with_payload(*arguments)


def test_a_payload_needs_masses():
    with refused("robot 'robot'", "masses", "payload"):
        mo.Robot.from_dh(alpha=[0.0], a=[1.0], d=[0.0]).with_payload(1.0)
