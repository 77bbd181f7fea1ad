"""One task by every method: the order that theory demands, certificates, files, what cannot be."""

import json
import re
from html import unescape

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp.tasks import METHODS, Step

pytestmark = pytest.mark.slow

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])  # report, part 5
VIA_T = [0.0, 2.0, 4.0]
VIA_QD = np.radians([[0, 0, 0], [10, 40, 20], [0, 0, 0]])


@pytest.fixture(scope="module")
def steps():
    return []


@pytest.fixture(scope="module")
def comparison(microbot, steps):
    return mo.compare(
        microbot, VIA_Q, via_t=VIA_T, via_qd=VIA_QD, mesh=20, starts=1, progress=steps.append
    )


@pytest.fixture(scope="module")
def saved(comparison, tmp_path_factory):
    folder = tmp_path_factory.mktemp("saved")
    comparison.save(folder, ["json", "motions"])
    return folder


def test_a_notebook_shows_its_table(comparison):
    shown = unescape(re.sub("<[^>]*>", "|", comparison._repr_html_()))
    for entry in comparison.entries:
        assert f"|{entry.title}||{entry.motion.duration:.3f}|" in shown


# durations ----------------------------------------------------------------------------------------


def test_every_method_is_there_and_solved(comparison):
    assert [entry.name for entry in comparison.entries] == list(METHODS)
    assert comparison.solved
    assert {entry.status for entry in comparison.entries} == {"solved"}
    assert comparison["lspb"].title == "LSPB, best times and velocities"
    with pytest.raises(KeyError):
        comparison["spline"]


@pytest.mark.parametrize(
    ("fast", "slow"),
    [
        ("time_optimal", "cubic_path"),
        ("time_optimal", "straight_path"),
        ("time_optimal", "lspb"),
        ("cubic_path", "cubic"),
        ("cubic", "cubic_textbook"),
        ("cubic_textbook", "cubic_scaled"),
        ("lspb", "lspb_textbook"),
        ("lspb_textbook", "lspb_scaled"),
    ],
)
def test_more_freedom_is_never_slower(comparison, fast, slow):
    motions = comparison.motions
    assert motions[fast].duration < motions[slow].duration


def test_durations_are_those_of_the_methods(microbot, comparison):
    motions = comparison.motions
    assert motions["cubic_report"].duration == 4.0
    scaled = mo.shortest_duration(microbot, mo.cubic(VIA_Q, VIA_T, VIA_QD))
    assert motions["cubic_scaled"].duration == pytest.approx(scaled.duration, rel=1e-12)
    scaled = mo.shortest_duration(microbot, mo.lspb(VIA_Q, VIA_T, 0.5, VIA_QD))
    assert motions["lspb_scaled"].duration == pytest.approx(scaled.duration, rel=1e-12)
    assert motions["time_optimal"].duration == pytest.approx(1.9236, rel=1e-3)
    for name in ("straight_path", "cubic_path"):
        reached = motions[name].provenance["reachability_duration"]
        assert motions[name].duration == pytest.approx(reached, rel=1e-3)


def test_a_shape_that_is_scaled_meets_its_limit_and_does_not_pass_it(microbot, comparison):
    for name in (name for name, method in METHODS.items() if method.baseline):
        motion = comparison.motions[name]
        use = max(
            np.abs(motion.qd / microbot.limits.qd_max).max(),
            np.abs(motion.tau / microbot.limits.tau_max).max(),
        )
        assert 0.995 < use <= 1.0 + 1e-9


# certificates -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(METHODS))
def test_every_motion_is_certified(comparison, name):
    certificate = comparison.certificates[name]
    assert certificate.resimulation_status.solved
    assert certificate.final_position_error < 1e-3
    if name == "cubic_report":  # 4 s as given, whatever the limits
        return
    assert certificate.ok, certificate.verdict
    assert certificate.worst_violation < 5e-3
    for check in certificate.via_checks:
        assert check.value < 1e-3 or name.startswith("lspb")


def test_effort_and_work_are_integrals_of_the_motion(comparison):
    for entry in comparison.entries:
        t, tau, qd = entry.motion.t, entry.motion.tau, entry.motion.qd
        step = np.diff(t)[:, None]
        middle_tau, middle_qd = (tau[1:] + tau[:-1]) / 2, (qd[1:] + qd[:-1]) / 2
        assert entry.torque_squared == pytest.approx(np.sum(step * middle_tau**2), rel=2e-2)
        assert entry.work == pytest.approx(np.sum(step * np.abs(middle_tau * middle_qd)), rel=2e-2)
        assert entry.work > 100.0


def test_progress_counts_the_work_of_every_method(steps, comparison):
    assert all(isinstance(step, Step) for step in steps)
    assert len({step.total for step in steps}) == 1
    assert len({step.done for step in steps}) == 2 * len(METHODS) + 1
    done = [step.done for step in steps]
    assert done == sorted(done)
    assert steps[-1].stage == "done"
    assert steps[-1].done == steps[-1].total
    assert {step.stage for step in steps} == {"solve", "certify", "done"}
    assert all("\n" not in step.text for step in steps)


# files --------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_save_writes_these_files_and_no_others(tmp_path):
    """Of short motions, whose film has few pictures."""
    methods = ["cubic", "lspb"]
    comparison = mo.compare(mo.load_robot("planar_2r"), [[0, 0], [0.03, 0.05]], methods)
    written = comparison.save(tmp_path)
    expected = {f"motions/{name}.npz" for name in methods}
    expected |= {"comparison.json", "comparison.csv", "comparison.rrd", "report.pdf"}
    expected |= {"report.html"}
    expected |= {f"{name}.{kind}" for name in ("comparison", "paths") for kind in ("png", "pdf")}
    there = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()}
    assert there == expected
    assert {str(p.relative_to(tmp_path)) for p in written} == expected
    assert len(written) == len(expected)
    assert all(p.stat().st_size > 200 for p in written)


def test_the_json_is_strict_and_tells_the_durations(saved, comparison):
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    text = (saved / "comparison.json").read_text()
    stored = json.loads(text, parse_constant=refuse)
    for name, motion in comparison.motions.items():
        assert f'"{name}"' in text
        assert repr(motion.duration)[:8] in text
    assert stored


def test_motions_come_back_from_their_files(saved, comparison):
    for name, motion in comparison.motions.items():
        again = mo.Motion.load(saved / "motions" / f"{name}.npz")
        np.testing.assert_array_equal(again.q, motion.q)
        np.testing.assert_array_equal(again.tau, motion.tau)
        assert again.solved


@pytest.mark.thorough
def test_a_stored_torque_drives_the_arm_to_its_end(microbot, saved):
    """Nothing but the arrays of the file, an integrator of scipy and the arm's own equations."""
    with np.load(saved / "motions" / "time_optimal.npz", allow_pickle=False) as stored:
        t, q, qd, tau = (stored[key] for key in ("t", "q", "qd", "tau"))
    mass, bias = mo.mass_matrix(microbot), mo.bias_torque(microbot)

    def slope(time, state):
        torque = np.array([np.interp(time, t, column) for column in tau.T])
        rest = torque - np.array(bias(state[:3], state[3:])).ravel()
        return np.concatenate([state[3:], np.linalg.solve(np.array(mass(state[:3])), rest)])

    end = solve_ivp(
        slope, (0.0, t[-1]), np.concatenate([q[0], qd[0]]), rtol=1e-8, atol=1e-8, max_step=0.01
    ).y[:, -1]
    assert np.abs(end[:3] - q[-1]).max() < 5e-3
    np.testing.assert_allclose(q[-1], VIA_Q[-1], atol=1e-9)


# what cannot be -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pendulum():
    """It can stand upright but not hold the horizontal."""
    return mo.Robot.from_dh(
        alpha=[0.0],
        a=[0.0],
        d=[0.0],
        links=[mo.Link(1.0, [1.0, 0.0, 0.0])],
        gravity=(9.81, 0.0, 0.0),
        limits=mo.Limits(tau_max=6.0, qd_max=10.0),
        name="pendulum",
    )


def test_a_method_that_cannot_do_the_task_says_so_and_the_others_go_on(pendulum):
    methods = ["cubic", "straight_path", "lspb", "time_optimal"]
    result = mo.compare(pendulum, [[0.0], [np.pi]], methods, mesh=20, starts=3)
    by_name = {entry.name: entry for entry in result.entries}
    assert list(by_name) == methods
    assert by_name["time_optimal"].solved  # by swinging
    assert not result.solved
    for name in ("cubic", "lspb"):
        entry = by_name[name]
        assert entry.status == "not possible"
        assert entry.motion is None
        assert entry.certificate is None
        assert "limit" in entry.note
    straight = by_name["straight_path"]
    assert not straight.solved
    assert straight.status in ("infeasible", "limits exceeded")
    assert "blocked" in {row.kind for row in straight.motion.outcome.advice}
    assert len(result.table().rows) == 4
    assert set(result.motions) == set(result.certificates) == {"straight_path", "time_optimal"}


@pytest.mark.thorough
def test_a_corner_that_cannot_be_held_is_an_entry_without_motion(pendulum):
    via_q = [[0.0], [np.pi / 2], [0.3]]
    result = mo.compare(pendulum, via_q, ["straight_path", "time_optimal"], mesh=20, starts=3)
    straight, free = result.entries
    assert straight.status == "not possible"
    tells(straight.note, "at rest", "'joint 1'", "9.81 N m")
    assert free.name == "time_optimal"
    assert free.motion is not None


# input --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            {"methods": ["spline"]},
            ("method", "cubic_report", "'spline'"),
        ),
        ({"methods": []}, ("methods", "different names", "[]")),
        ({"methods": ["cubic", "cubic"]}, ("methods", "different names", "['cubic', 'cubic']")),
        ({"methods": ["cubic_report"]}, ("'cubic_report'", "via_t")),
        ({"methods": ["lspb_scaled"]}, ("'lspb_scaled'", "via_t")),
        ({"meshes": 40}, ("compare", "limit_tolerance", "'meshes'")),
        ({"mesh": 2}, ("mesh", "4 intervals", "not 2")),
        ({"blend": 0.6}, ("blend", "0.5", "0.6")),
        ({"blend": 0.0}, ("blend", "0 of", "0.0")),
        ({"via_t": [0.0, 1.0]}, ("via_t", "shape [3]", "[2]")),
        (
            {"via_t": [0.0, 1.0, 1.0]},
            ("via_t", "0, s", "via_t[2] is 1 s", "via_t[1] of 1 s"),
        ),
        ({"via_t": [0.0, 2.0, 1.0]}, ("via_t", "0, s", "via_t[2] is 1 s", "via_t[1] of 2 s")),
        ({"via_t": [1.0, 2.0, 3.0]}, ("via_t", "0, s", "[1.0, 2.0, 3.0]")),
        ({"via_t": [0.0, 1.0, np.nan]}, ("via_t", "finite", "[2] is nan s")),
        ({"via_qd": VIA_QD[:2], "via_t": VIA_T}, ("via_qd", "shape [3, 3]", "[2, 3]")),
        ({"via_qd": VIA_QD}, ("via_qd", "via_t", "times")),
        ({"limits": mo.Limits(q_max=9.0)}, ("limits", "'waist'", "velocity")),
    ],
)
def test_bad_input_is_refused_before_any_method_runs(microbot, options, said):
    ran = []
    with refused(*said) as caught:
        mo.compare(microbot, VIA_Q, progress=ran.append, **options)
    assert not ran
    assert "\n" not in str(caught.value)


@pytest.mark.thorough
def test_methods_of_given_times_are_left_out_where_none_are_given():
    robot = mo.load_robot("planar_2r")
    result = mo.compare(robot, [[0, 0], [0.3, 0.5]], mesh=20, starts=1, grid=100)
    assert [name for name in METHODS if name not in result.motions] == [
        *("cubic_report", "cubic_scaled", "lspb_scaled")
    ]


@pytest.mark.thorough
def test_the_textbook_has_the_best_split_of_its_times(microbot):
    """Whatever times are given; what was assumed is said."""
    names = ["cubic_textbook", "lspb_textbook"]
    result = mo.compare(microbot, VIA_Q, names)
    cubic, lspb = (result[name] for name in names)
    for skewed in ([0, 1, 4], [0, 3, 4]):
        again = mo.compare(microbot, VIA_Q, ["cubic_textbook", "cubic_scaled"], via_t=skewed)
        found = again["cubic_textbook"].motion.duration
        assert found == pytest.approx(cubic.motion.duration, rel=2e-4)
        assert found < 0.9 * again["cubic_scaled"].motion.duration
    grid = [[0, x, 4] for x in np.linspace(1.4, 2.6, 25)]
    durations = [mo.shortest_duration(microbot, mo.cubic(VIA_Q, t)).duration for t in grid]
    assert cubic.motion.duration < min(durations) * (1 + 1e-4)
    assert "1.37" in cubic.note
    tells(cubic.note, "segments", "via velocities", "Craig")
    assert "full stop" not in cubic.note  # the waist goes on
    assert "0.60" in lspb.note
    tells(lspb.note, "blends")


@pytest.mark.thorough
def test_a_full_stop_by_craigs_heuristic_is_said(microbot):
    """Where every joint turns back at a via point."""
    via_q = np.radians([[0, 0, 0], [20, 60, -30], [-60, 30, 80], [-70, 20, 90]])
    result = mo.compare(microbot, via_q, ["cubic_textbook", "cubic"])
    tells(result["cubic_textbook"].note, "full stop", "via 2")
    assert "full stop" not in result["cubic"].note
    tells(result["cubic"].note, "via velocities", "chosen")
    given = mo.compare(
        microbot, VIA_Q, ["cubic_textbook"], via_t=VIA_T, via_qd=np.zeros((3, 3))
    ).entries[0]
    tells(given.note, "via velocities", "given", "full stop", "via 2")


def test_durations_are_compared_with_the_fastest_baseline(comparison, microbot):
    durations = {
        name: comparison[name].motion.duration for name, m in METHODS.items() if m.baseline
    }
    assert comparison.reference == min(durations, key=durations.get) == "cubic"
    assert durations["cubic"] == pytest.approx(2.0737, rel=2e-4)
    other = mo.compare(microbot, np.radians([[0, 0, 0], [20, 60, -30], [-60, 30, 80]]),
                       ["cubic", "lspb"])  # fmt: skip
    assert other.reference == "lspb"
    assert other.table().notes[0].endswith("Ratio: to LSPB, best times and velocities.")


@pytest.mark.parametrize(
    ("limits", "duration"),
    [({"qdd_max": 2.0}, 2 * np.sqrt(3 / 2)), ({"qdd_max": 2.0, "qd_max": 1.0}, 3 / 1 + 1 / 2)],
)
def test_the_blends_of_lspb_are_the_best(limits, duration):
    """From rest to rest over 3 m: as fast as any motion under these limits."""
    slider = mo.Robot.from_dh(
        *([0.0], [0.0], [0.0]),
        joint_type=["prismatic"],
        links=[mo.Link(1.0, [0.0, 0.0, 0.0])],
        gravity=(0.0, 0.0, 0.0),
        limits=mo.Limits(**limits),
    )
    found = mo.compare(slider, [[0.0], [3.0]], ["lspb"])["lspb"].motion.duration
    assert found == pytest.approx(duration, rel=2e-4)
    held = mo.compare(slider, [[0.0], [3.0]], ["lspb"], blend=0.1)["lspb"]
    assert held.motion.duration > 1.05 * found
    tells(held.note, "blends", "0.1")


def test_limits_of_the_task_replace_those_of_the_robot(microbot):
    slow = mo.Limits(qd_max=0.5, tau_max=[400.0, 500.0, 200.0])
    result = mo.compare(microbot, VIA_Q, ["cubic"], slow)
    assert np.abs(result["cubic"].motion.qd).max() == pytest.approx(0.5, rel=1e-6)
    assert result.limits.qd_max.tolist() == [0.5] * 3
    assert result["cubic"].certificate.ok


def test_a_table_has_what_a_controller_and_other_arms_cost(microbot):
    plants = mo.execution.differing_plants(microbot, mass=0.02, count=0)
    loop = {"controller": mo.ComputedTorque(kp=100.0), "plants": plants, "sample_rate": 200.0}
    result = mo.compare(
        microbot, [[0, 0, 0], [0.5, 0.4, 0.3]], ["cubic"], profile="hold@200",
        trackable={**loop, "bound": 0.05, "accuracy": 0.1},
    )  # fmt: skip
    (entry,) = result.entries
    assert entry.motion is not None
    command = mo.execution.commanded(microbot, entry.motion, "hold@200")
    assert entry.details["executed_duration"] == pytest.approx(command.rows.t[-1])
    assert entry.details["trackable_duration"] >= entry.motion.duration
    assert {"T executed [s]", "T trackable [s]"} <= set(result.table().heads)
    with refused("profile", "'nothing'"):
        mo.compare(microbot, [[0, 0, 0], [0.5, 0.4, 0.3]], ["cubic"], profile="nothing")


@pytest.mark.thorough
def test_velocities_of_a_sliding_and_a_turning_joint_have_their_units() -> None:
    arm = mo.Robot.from_dh([0, 0], [0, 1], [0, 0], joint_type=["prismatic", "revolute"])
    arm = arm.with_limits(q_min=-2, q_max=2, qd_max=1.0)
    lspb = mo.compare(arm, [[0, 0], [0.5, 1], [1, 1]], methods=["lspb"]).motions["lspb"]
    assert lspb.remark.endswith(") m/s or rad/s")
