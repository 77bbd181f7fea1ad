"""Draw the nonzeros of the matrix that is factored for a free motion: docs/images/flat_band.png."""

from pathlib import Path

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import microbot_ocp as mo
from microbot_ocp.planning.free import flat_form

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
INTERVALS = 12


def main(path: Path) -> None:
    """Write the picture."""
    form = flat_form(mo.load_robot("microbot"), VIA_Q.tobytes(), len(VIA_Q))
    assert form is not None
    structure = form.program(INTERVALS).structure
    hessian = np.array(ca.DM(structure.hessian, 1.0)) != 0.0
    jacobian = np.array(ca.DM(structure.jacobian, 1.0))
    free = form.program(INTERVALS)
    free = free.variable_lower < free.variable_upper
    matrix = (hessian | hessian.T | (jacobian.T @ jacobian > 0.0))[np.ix_(free, free)]
    figure, axes = plt.subplots(figsize=(4.0, 4.0), layout="constrained")
    axes.spy(matrix, markersize=2.2, color="#0072B2")
    axes.set_xlabel("unknowns, durations last")
    axes.set_xticks([])
    axes.set_yticks([])
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main(Path(__file__).parent / "images" / "flat_band.png")
