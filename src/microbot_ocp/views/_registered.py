"""Which function shows a result of which class.

The package's ``__init__`` loads this table of names; a function is imported when it is asked for.
"""

from microbot_ocp._base.showing import add_views

PLOTS, TABLES, RECORDING, ANIMATION = (
    f"{__package__}.{folder}" for folder in ("plots", "tables", "recording", "animation")
)

add_views(
    {
        "microbot_ocp.Table": {
            "terminal": f"{TABLES}._renderers:terminal",
            "html": f"{TABLES}._renderers:html",
        },
        "microbot_ocp.robot.Robot": {"table": f"{TABLES}._results:robot"},
        "microbot_ocp.motion.Motion": {
            "table": f"{TABLES}._results:motion",
            "plot": f"{PLOTS}:motion",
            "rerun": f"{RECORDING}:of_motion",
            "animation": f"{ANIMATION}:animate_motion",
        },
        "microbot_ocp.simulation.Simulation": {"plot": f"{PLOTS}:simulation"},
        "microbot_ocp.simulation.Tracking": {
            "plot": f"{PLOTS}:tracking",
            "rerun": f"{RECORDING}:of_tracking",
        },
        "microbot_ocp.ocp.solution.Solution": {
            "table": f"{TABLES}._results:solution",
            "plot": f"{PLOTS}:solution",
        },
        "microbot_ocp.ocp.refinement.Refined": {"table": f"{TABLES}._results:refined"},
        "microbot_ocp.ocp.verification.OCPCertificate": {
            "table": f"{TABLES}._results:ocp_certificate"
        },
        "microbot_ocp.comparison.Certificate": {"table": f"{TABLES}._results:certificate"},
        "microbot_ocp.comparison.Front": {"plot": f"{PLOTS}:front"},
        "microbot_ocp.comparison.Cell": {
            "rerun": f"{RECORDING}:of_cell",
            "animation": f"{ANIMATION}:animate_cell",
        },
        "microbot_ocp.comparison.Comparison": {
            "table": f"{TABLES}:comparison_table",
            "json": f"{TABLES}:write_json",
            "csv": f"{TABLES}:write_csv",
            "plot": f"{PLOTS}:comparison",
            "paths": f"{PLOTS}:paths",
            "report": f"{PLOTS}:report",
            "rerun": f"{RECORDING}:of_comparison",
            "animation": f"{ANIMATION}:animate_comparison",
        },
        "microbot_ocp.sweeps.Sweep": {
            "table": f"{TABLES}._sweep:sweep",
            "plot": f"{PLOTS}:sweep",
            "rerun": f"{RECORDING}:of_sweep",
        },
    }
)
