"""Draw the error of every transcription against the step: ``docs/images/convergence_order.png``.

The motion and the measure are those of ``tests/ocp/transcription/test_convergence_order.py``.

    python docs/make_order_plot.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from microbot_ocp.ocp.transcription.schemes import (
    Collocation,
    HermiteSimpson,
    Scheme,
    Shooting,
    Trapezoidal,
)

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from ocp.test_convergence_order import DURATION, errors, slope

TARGET = Path(__file__).resolve().parent / "images" / "convergence_order.png"
MESHES = (4, 6, 8, 12, 16, 24, 32, 48, 64)
ROUNDING = 1e-12  # errors below say nothing of the scheme
# colours of Okabe and Ito, told apart with every kind of colour vision; markers besides
LINES: tuple[tuple[str, Scheme, str, str], ...] = (
    ("trapezoidal", Trapezoidal(), "#D55E00", "s"),
    ("Radau, 2 points", Collocation("radau", 2), "#E69F00", "^"),
    ("Runge-Kutta shooting", Shooting(), "#000000", "D"),
    ("Hermite-Simpson", HermiteSimpson(), "#0072B2", "o"),
    ("Gauss, 2 points", Collocation("legendre", 2), "#56B4E9", "v"),
    ("Radau, 3 points", Collocation("radau", 3), "#009E73", "P"),
    ("Gauss, 3 points", Collocation("legendre", 3), "#CC79A7", "X"),
)


def figure() -> Figure:
    """Largest error of the states at the mesh points, logarithmic in both axes."""
    page = Figure(figsize=(10.0, 5.6), layout="constrained")
    FigureCanvasAgg(page)
    axes = page.add_subplot()
    steps = DURATION / np.array(MESHES)
    for label, scheme, color, marker in LINES:
        states, _ = errors(scheme, MESHES)
        seen = states > ROUNDING
        fine = np.flatnonzero(seen)[-5:]  # where the leading term rules
        order = slope(tuple(np.array(MESHES)[fine]), states[fine])
        # the slope of theory through the finest of what was measured
        factor = states[seen][-1] / steps[seen][-1] ** scheme.order
        axes.loglog(steps[seen], factor * steps[seen] ** scheme.order, color=color, linewidth=1.2)
        axes.loglog(
            steps[seen],
            states[seen],
            color=color,
            marker=marker,
            markersize=7,
            markeredgecolor="white",
            markeredgewidth=0.6,
            linestyle="none",
            label=f"{label}: {order:.2f} (theory {scheme.order})",
        )
    axes.set_xlabel("length of an interval [s]")
    axes.set_ylabel("largest error of the states at the mesh points")
    page.suptitle(
        "A nonlinear spiral with a closed form: errors measured (markers), slopes of theory (lines)"
    )
    axes.set_xticks([0.03, 0.05, 0.1, 0.2, 0.5], ["0.03", "0.05", "0.1", "0.2", "0.5"])
    axes.minorticks_off()
    axes.grid(color="0.9", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
        frameon=False,
        title="order on the five finest meshes",
    )
    return page


def main() -> None:
    figure().savefig(TARGET, dpi=150)
    print(TARGET)


if __name__ == "__main__":
    main()
