"""Iterates of a solve, recorded or streamed, read back."""

import socket
import time
from urllib.request import urlopen

import numpy as np
import pytest
from reading import read, scalars

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.ocp import OptimalControlProblem, SolverSettings, solve
from microbot_ocp.views._scene import data_range
from microbot_ocp.views.live import connected, parse_address, server
from microbot_ocp.views.live._viewer import end_viewer, start_viewer
from microbot_ocp.views.recording import phase_curves, record_iterations, rounded
from microbot_ocp.views.recording._iterations import PANEL_SIZE

VIA_Q = np.radians([[0, 0, 0], [-90, 90, 90]])
EPS = np.finfo(float).eps
TIMELINE = "iteration"
OTHER_ADDRESS = "127.0.0.2"  # of this machine: what listens everywhere listens there, too


def double_integrator():
    problem = OptimalControlProblem("double integrator")
    phase = problem.phase("move", (0.1, 10.0))
    x = phase.state("x", initial=0.0, final=1.0, unit="m")
    v = phase.state("v", initial=0.0, final=0.0, unit="m/s")
    u = phase.control("u", lower=-1.0, upper=1.0)
    phase.derivative(x, v)
    phase.derivative(v, u)
    phase.end_cost(phase.duration)
    return problem


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A solve of the Microbot, every event that it told, and the recording of it."""
    path = tmp_path_factory.mktemp("iterations") / "solve.rrd"
    events = []
    with record_iterations(path) as record:

        def progress(event):
            events.append(event)
            record(event)

        motion = mo.time_optimal(
            mo.load_robot("microbot"), VIA_Q, mesh=12, starts=1, progress=progress
        )
    iterations = [event for event in events if not isinstance(event, str)]
    return path, motion, iterations, [event for event in events if isinstance(event, str)]


@pytest.mark.slow
def test_cost_and_infeasibility_are_those_of_every_iteration(recorded):
    path, _, iterations, _ = recorded
    for name, values in (
        ("cost", [event.cost for event in iterations]),
        ("infeasibility", np.log10([max(e.infeasibility, EPS) for e in iterations])),
    ):
        number, found = scalars(path, f"/convergence/{name}", TIMELINE)
        np.testing.assert_array_equal(number, np.arange(len(iterations)))
        np.testing.assert_allclose(found, values, rtol=1e-12)


@pytest.mark.thorough
@pytest.mark.slow
def test_the_trail_of_every_iterate_is_the_path_of_its_tool(recorded):
    path, motion, iterations, _ = recorded
    robot = mo.load_robot("microbot")
    number, rows = read(path, "/world/iterate/trail", "LineStrips3D:strips", TIMELINE)
    assert list(number) == list(range(len(iterations)))
    tool = mo.forward_kinematics(robot)
    for event, strips in zip(iterations, rows, strict=True):
        expected = [np.array(tool(q))[:3, 3] for q in event.motion()[1].q]
        np.testing.assert_allclose(strips[0], expected, atol=1e-5)
    ends = [np.array(tool(q))[:3, 3] for q in motion.q[[0, -1]]]
    np.testing.assert_allclose([rows[-1][0][0], rows[-1][0][-1]], ends, atol=1e-5)


@pytest.mark.slow
def test_torque_curves_end_at_the_limits_of_the_optimum(recorded):
    """The panel's own axes turn a drawn line back into newton metres and seconds."""
    path, motion, iterations, _ = recorded
    at = "/plots/tau/elbow"
    _, rows = read(path, f"{at}/curve", "LineStrips2D:strips", TIMELINE)
    _, labels = read(path, f"{at}/axes", "Points2D:labels", TIMELINE)
    line = np.array(rows[-1][0])
    top, bottom, start, end = (float(label.split()[0]) for label in labels[-1])
    tau = bottom - line[:, 1] / PANEL_SIZE[1] * (top - bottom)
    t = start + line[:, 0] / PANEL_SIZE[0] * (end - start)
    np.testing.assert_allclose(tau, iterations[-1].torque()[:, 2], atol=1e-3)
    assert np.abs(tau).max() == pytest.approx(200.0, abs=0.01)
    assert t[-1] == pytest.approx(motion.duration, abs=1e-5)


@pytest.mark.slow
def test_what_the_solve_said_stands_beside_its_iterations(recorded):
    path, _, iterations, said = recorded
    number, rows = read(path, "/marks", "TextLog:text", TIMELINE)
    assert [row[0] for row in rows] == said
    assert number[-1] == len(iterations) - 1


def test_every_tenth_and_the_last_of_each_solve_is_drawn(tmp_path):
    events = []
    with record_iterations(tmp_path / "few.rrd", every=10) as record:

        def progress(event):
            events.append(event.number)
            record(event)

        settings = SolverSettings(solver="ipopt")
        solve(double_integrator(), 20, settings=settings, progress=progress)
    number, _ = read(
        tmp_path / "few.rrd", "/plots/variables/u/curve", "LineStrips2D:strips", TIMELINE
    )
    assert list(number) == sorted({*range(0, len(events), 10), len(events) - 1})


def test_a_problem_without_a_robot_shows_its_states_and_controls():
    solution = solve(double_integrator(), 20)
    curves = phase_curves(solution.phases)
    assert list(curves) == ["variables/x/m", "variables/v/m/s", "variables/u/"]
    position, control = curves["variables/x/m"], curves["variables/u/"]
    fast = np.where(position.t < 1, position.t**2 / 2, 1 - (2 - position.t) ** 2 / 2)
    np.testing.assert_allclose(position.values, fast, atol=1e-5)
    assert (control.lower, control.upper) == (-1.0, 1.0)


def test_an_error_in_the_solve_leaves_no_file(tmp_path):
    with pytest.raises(RuntimeError, match="mine"), record_iterations(tmp_path / "a.rrd"):
        raise RuntimeError("mine")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(0.0, 1.67, (0.0, 2.0)), (-400.0, 400.0, (-400.0, 400.0)), (-0.013, 0.0, (-0.015, 0.0))],
)
def test_axes_end_at_round_numbers(low, high, expected):
    assert rounded(low, high) == expected


def test_an_axis_of_a_constant_has_some_height():
    low, high = rounded(*data_range(np.full(2, 3.0)))
    assert low <= 3.0 < high


# live ---------------------------------------------------------------------------------------------


@pytest.fixture
def listener(tmp_path):
    """A Rerun server on 127.0.0.1 that writes what it gets into a file."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    path = tmp_path / "received.rrd"
    process = start_viewer("--save", str(path), ports=(port,))
    yield f"127.0.0.1:{port}", path
    end_viewer(process)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # it was received, not written
def test_a_viewer_gets_every_iterate_while_the_solve_runs(listener):
    address, path = listener
    costs = []
    with connected(address) as record:

        def progress(event):
            costs.append(event.cost)
            record(event)

        solve(double_integrator(), 20, progress=progress)
    deadline = time.monotonic() + 20
    found = np.zeros(0)
    while found.size < len(costs) and time.monotonic() < deadline:
        time.sleep(0.2)
        try:
            found = scalars(path, "/convergence/cost", TIMELINE)[1]
        except (OSError, RuntimeError, ValueError):  # the file is being written
            continue
    np.testing.assert_allclose(found, costs, rtol=1e-12)


@pytest.mark.slow
def test_a_browser_is_served_on_loopback_only():
    said = []
    with server(said.append) as address:
        (page,) = said
        port = int(address.split(":")[1])
        assert page.startswith("http://127.0.0.1:")
        with urlopen(page) as answer:
            assert f"127.0.0.1:{port}" in answer.headers["Content-Security-Policy"]
            assert b"re_viewer" in (html := answer.read())
            assert b"preconnect" not in html
        for number in (port, int(page.split(":")[2].split("/")[0])):
            with socket.create_connection(("127.0.0.1", number), timeout=2):
                pass
            with (
                pytest.raises(ConnectionRefusedError),
                socket.create_connection((OTHER_ADDRESS, number), 2),
            ):
                pass
    with pytest.raises(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port), 2):
        pass


@pytest.mark.parametrize(
    "address", ["10.0.0.1:9876", "localhost", "somewhere:1", "", "127.0.0.1:x"]
)
def test_addresses_elsewhere_are_refused(address):
    with refused("HOST:PORT", "127.0.0.1, localhost, ::1", repr(address)):
        parse_address(address)


def test_nobody_who_listens_is_said_before_the_solve():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with refused("viewer", f"127.0.0.1:{port}"), connected(f"127.0.0.1:{port}"):
        pass
