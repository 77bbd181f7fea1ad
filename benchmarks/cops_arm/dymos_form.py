# COPS 3.0, problem 8: a telescoping arm from rest to rest in the shortest time.
import dymos as dm
import numpy as np
import openmdao.api as om

from benchmarks.cops_arm.ipopt_driver import IpoptDriver

LENGTH = 5.0


def arm(num_nodes, **_):
    inertia = f"((({LENGTH} - rho)**3 + rho**3) / 3)"
    rates = [
        f"rho_acceleration = u_rho / {LENGTH}",
        f"theta_acceleration = u_theta / ({inertia} * sin(phi)**2)",
        f"phi_acceleration = u_phi / {inertia}",
    ]
    return om.ExecComp(rates, has_diag_partials=True, shape=(num_nodes,))


problem = om.Problem(reports=False)
problem.driver = IpoptDriver(print_level=0)
problem.driver.declare_coloring(show_summary=False)
move = dm.Phase(ode_class=arm, transcription=dm.Radau(num_segments=100, order=3))
problem.model.add_subsystem("trajectory", dm.Trajectory()).add_phase("move", move)
move.set_time_options(fix_initial=True, duration_bounds=(1.0, 20.0))
fixed = {"fix_initial": True, "fix_final": True, "units": None, "shape": (1,)}
move.add_state("rho", rate_source="rho_rate", targets="rho", lower=0.0, upper=LENGTH, **fixed)
move.add_state("theta", rate_source="theta_rate", lower=-np.pi, upper=np.pi, **fixed)
move.add_state("phi", rate_source="phi_rate", targets="phi", lower=0.0, upper=np.pi, **fixed)
for name in ("rho", "theta", "phi"):
    move.add_state(f"{name}_rate", rate_source=f"{name}_acceleration", **fixed)
    free = {"continuity": False, "rate_continuity": False, "units": None}
    move.add_control(f"u_{name}", targets=f"u_{name}", lower=-1.0, upper=1.0, **free)
move.add_objective("time", loc="final")
problem.setup()
move.set_time_val(initial=0.0, duration=10.0)
move.set_state_val("rho", [4.5, 4.5])
move.set_state_val("theta", [0.0, 2 * np.pi / 3])
move.set_state_val("phi", [np.pi / 4, np.pi / 4])
for name in ("rho", "theta", "phi"):
    move.set_state_val(f"{name}_rate", [0.0, 0.0])
    move.set_control_val(f"u_{name}", [0.0, 0.0])
problem.run_driver()
print(problem.get_val("trajectory.move.timeseries.time")[-1])
