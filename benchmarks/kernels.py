"""What optimising the compiled kernels of a free motion costs and gives.

``python -m benchmarks.kernels microbot ur5e``. For each kernel and option of the compiler:
processor time of compiling and of one evaluation, and in parentheses the evaluations after which
the option has paid for itself, against the one before it.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
import timeit

import casadi as ca
import numpy as np

import microbot_ocp as mo
from benchmarks.arms import via_points
from microbot_ocp._base.codegen import build_library, c_source
from microbot_ocp.planning.free import transcription

OPTIONS = ("-O0", "-O1", "-O2")
CALLS = 200


def evaluation(function: ca.Function) -> float:
    """Processor time of one call at random arguments, the least of some rounds, s."""
    random = np.random.default_rng(0)
    buffer, call = function.buffer()
    inputs = [random.uniform(0.1, 1.0, function.nnz_in(i)) for i in range(function.n_in())]
    outputs = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    for i, array in enumerate(inputs):
        buffer.set_arg(i, memoryview(array))  # pyright: ignore
    for i, array in enumerate(outputs):
        buffer.set_res(i, memoryview(array))  # pyright: ignore
    return min(timeit.repeat(call, timer=time.process_time, number=CALLS, repeat=7)) / CALLS


def compare(name: str) -> None:
    """Print a line for each kernel of a motion through three random points."""
    robot, cc = mo.load_robot(name), mo.compiler()
    assert cc is not None, "there is no C compiler"
    via = via_points(robot, 0, 3)
    kernels = transcription(robot, via.tobytes(), len(via), False).kernels[0]
    end = kernels.points[-1]
    stage = (kernels.stage, kernels.stage_jacobian, kernels.stage_hessian)
    for function in (*stage, end.point, end.jacobian, end.hessian):
        source, row, before = c_source([function]), f"{name:9}{function.name():16}", None
        for option in OPTIONS:
            begin = sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
            library = build_library(source, "kernel", cc, option)
            cost = sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2]) - begin
            each = evaluation(ca.external(function.name(), str(library)))
            row += f"{option} {cost:6.2f} s {1e6 * each:7.2f} us   "
            if before is not None:
                saved = before[1] - each
                row += f"({(cost - before[0]) / saved:.0f})   " if saved > 0 else "(never)   "
            before = cost, each
        print(row, flush=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.environ["MICROBOT_OCP_CACHE"] = folder
        for arm in sys.argv[1:]:
            compare(arm)
