"""Where the nonzeros of a program stand."""

from __future__ import annotations

import numpy as np

from microbot_ocp._base.showing import GivenAxes
from microbot_ocp.ocp import ParametricSolver
from microbot_ocp.views._style import STYLE
from microbot_ocp.views.plots._page import AxesGrid, axes_page, styled


@styled()
def sparsity(solver: ParametricSolver, axes: GivenAxes | None = None) -> AxesGrid:
    """Draw the nonzeros of the Jacobian of the rows and of the Hessian of the Lagrangian.

    Parameters
    ----------
    solver : ParametricSolver
    axes : array of Axes [2], optional
        Default a new figure.

    Returns
    -------
    AxesGrid [2]
        Lines stand between phases.
    """
    program = solver.program
    size = (STYLE.page[0], 0.5 * STYLE.page[0])
    page = axes_page(axes, 1, 2, size=size, title=solver.transcription.problem.name)
    panels = page.axes.ravel().view(AxesGrid)
    edges = [
        np.cumsum([getattr(layout, count) for layout in program.layouts])[:-1]
        for count in ("variable_count", "row_count")
    ]
    matrices = {"Jacobian": ("jacobian", edges[1], "row"), "Hessian": ("hessian", edges[0], "")}
    for panel, (name, (key, borders, label)) in zip(panels, matrices.items(), strict=True):
        pattern = program.functions[key].sparsity_out(1)
        rows, columns = pattern.get_triplet()
        panel.plot(columns, rows, ".", markersize=max(0.5, 200.0 / max(pattern.shape)))
        for border in edges[0]:
            panel.axvline(border - 0.5, color="0.6", linewidth=0.5)
        for border in borders:
            panel.axhline(border - 0.5, color="0.6", linewidth=0.5)
        height, width = pattern.shape
        title = f"{name}: {height} x {width}, {pattern.nnz()} nonzeros"
        panel.set(xlim=(-1, width), ylim=(height, -1), title=title)
        panel.set(xlabel="variable", ylabel=label or "variable")
    return panels
