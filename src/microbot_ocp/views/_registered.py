"""Which function shows a result of which class.

The package's ``__init__`` loads this table of names; a function is imported when it is asked for.
"""

from microbot_ocp._base.showing import add_views

PLOTS, TABLES, NOTEBOOK, RECORDING = (
    f"{__package__}.{folder}" for folder in ("plots", "tables", "notebook", "recording")
)

add_views(
    {
        "microbot_ocp.robot.Robot": {"html": f"{NOTEBOOK}._html:robot"},
        "microbot_ocp.motion.Motion": {
            "html": f"{NOTEBOOK}._html:motion",
            "plot": f"{PLOTS}:motion",
            "rerun": f"{RECORDING}:of_motion",
        },
        "microbot_ocp.simulation.Simulation": {"plot": f"{PLOTS}:simulation"},
        "microbot_ocp.simulation.Tracking": {
            "plot": f"{PLOTS}:tracking",
            "rerun": f"{RECORDING}:of_tracking",
        },
        "microbot_ocp.ocp.solution.Solution": {"html": f"{NOTEBOOK}._html:solution"},
        "microbot_ocp.ocp.refinement.Refined": {"html": f"{NOTEBOOK}._html:refined"},
        "microbot_ocp.ocp.verification.OCPCertificate": {
            "html": f"{NOTEBOOK}._html:ocp_certificate"
        },
        "microbot_ocp.comparison.Certificate": {"html": f"{NOTEBOOK}._html:certificate"},
        "microbot_ocp.comparison.Comparison": {
            "html": f"{NOTEBOOK}._html:comparison",
            "table": f"{TABLES}:comparison_table",
            "json": f"{TABLES}:write_json",
            "csv": f"{TABLES}:write_csv",
            "plot": f"{PLOTS}:comparison",
            "paths": f"{PLOTS}:paths",
            "report": f"{PLOTS}:report",
            "rerun": f"{RECORDING}:of_comparison",
        },
    }
)
