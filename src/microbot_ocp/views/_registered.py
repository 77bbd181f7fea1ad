"""Table of the functions that show the results of each class.

The package's ``__init__`` loads this table of names; a function is imported at its first use.
"""

from microbot_ocp._base.showing import add_views

VIEWS = {  # public name of the class: kind of view = face or module of this folder: function
    "Table": "terminal=tables._renderers:terminal html=tables._renderers:html",
    "robot.Robot": "table=tables._results:robot",
    "motion.Motion": "table=tables._results:motion plot=plots:motion rerun=recording:of_motion "
    "animation=animation:animate_motion",
    "acceleration.AccelerationMap": "plot=plots:acceleration_map",
    "motion.DurationLine": "plot=plots:duration_line",
    "motion.Sensitivities": "plot=plots:prices",
    "execution.Reserve": "plot=plots:reserve",
    "simulation.Simulation": "plot=plots:motion",
    "simulation.Tracking": "plot=plots:tracking rerun=recording:of_tracking",
    "ocp.solution.Solution": "table=tables._results:solution plot=plots:solution",
    "ocp.solvers.ParametricSolver": "plot=plots:sparsity",
    "ocp.verification.OCPCertificate": "table=tables._results:ocp_certificate",
    "certificate.Certificate": "table=tables._results:certificate "
    "html_report=_html_report:certificate_report",
    "tasks.Front": "plot=plots:front",
    "tasks.Cell": "plot=plots:cell rerun=recording:of_cell animation=animation:animate_cell "
    "html_report=_html_report:cell_report",
    "tasks.Comparison": "table=tables:comparison_table json=tables:write_json "
    "csv=tables:write_csv plot=plots:comparison paths=plots:paths report=plots:report "
    "rerun=recording:of_comparison animation=animation:animate_comparison "
    "html_report=_html_report:comparison_report",
    "layout.Design": "plot=plots:design",
    "sweeps.Sweep": "table=tables._results:sweep plot=plots:sweep rerun=recording:of_sweep",
}

for name, views in VIEWS.items():
    pairs = (view.split("=") for view in views.split())
    add_views({f"microbot_ocp.{name}": {kind: f"{__package__}.{at}" for kind, at in pairs}})
add_views({"microbot_ocp.motion.Motion": {"execution": "microbot_ocp.execution:exported"}})
