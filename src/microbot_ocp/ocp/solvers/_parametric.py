"""Repeated solves of one problem with other parameters, limits and end conditions.

The program, its derivatives and its solvers are built once. A solve from the solution of a
neighbouring problem also uses its multipliers, and takes few iterations.
"""

from __future__ import annotations

import copy
import re
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.portable import Portable
from microbot_ocp._base.quiet import quiet
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp._base.writing import write_whole
from microbot_ocp.ocp.diagnosis import finite_start
from microbot_ocp.ocp.problem import with_phases
from microbot_ocp.ocp.solution import Progress, Solution, StartingPoint
from microbot_ocp.ocp.solvers import (
    SOLVERS,
    Solvers,
    SolverSettings,
    arguments_of,
    create,
    not_started,
    run_chain,
    transcribed,
    with_cost_scale,
)
from microbot_ocp.ocp.solvers._chain import warm_barrier
from microbot_ocp.ocp.starts import starting_point, with_changes
from microbot_ocp.ocp.transcription import (
    DURATION,
    AnyProblem,
    Guesses,
    Meshes,
    Program,
    Transcription,
    assemble,
    bounds_of,
)

Changes = Mapping[str, Mapping[str, Any]]


class ParametricSolver(Portable):
    """A problem transcribed on a mesh, with limits and parameters that change from solve to solve.

    Solvers are kept between solves, per thread: several threads may solve at once. The object can
    be copied, and pickled for other processes; solvers are rebuilt there. The cost scale is fixed
    by the default guess or by :meth:`scale_cost`, so that results do not depend on earlier solves,
    not even in the last digits.

    Parameters
    ----------
    transcription : Transcription or OptimalControlProblem
    mesh : int or array of fractions [N+1], or one per phase
    settings : SolverSettings, optional

    Examples
    --------
    >>> from microbot_ocp.ocp import OptimalControlProblem
    >>> problem = OptimalControlProblem("double integrator")
    >>> phase = problem.phase("move", duration=(0.1, 10.0))
    >>> x = phase.state("x", initial=0.0, final=1.0, unit="m")
    >>> v = phase.state("v", initial=0.0, final=0.0, unit="m/s")
    >>> u = phase.control("u", lower=-1.0, upper=1.0, unit="N")
    >>> mass = phase.parameter("mass", 1.0)
    >>> phase.derivative(x, v)
    >>> phase.derivative(v, u / mass)
    >>> phase.end_cost(phase.duration)
    >>> solver = ParametricSolver(problem, mesh=20)
    >>> first = solver.solve()
    >>> heavier = solver.solve(parameters={"move": {"mass": 1.21}}, guess=first)
    >>> round(first.cost, 4), round(heavier.cost, 4)
    (2.0, 2.2)
    """

    def __init__(
        self, transcription: AnyProblem, mesh: Meshes = 50, settings: SolverSettings | None = None
    ) -> None:
        self.settings = settings or SolverSettings()
        self.transcription = transcription = transcribed(transcription, self.settings)
        self.mesh = mesh
        self.program = assemble(transcription.layouts(mesh), parametric=True)
        self._solvers: dict[float | None, Solvers] = {}  # keys: barrier parameters of warm starts
        self._cost_scale: float | None = None

    def solve(
        self,
        *,
        parameters: Changes | None = None,
        bounds: Changes | None = None,
        initial: Changes | None = None,
        final: Changes | None = None,
        durations: Mapping[str, float | tuple[float, float]] | None = None,
        guess: Guesses | Solution | None = None,
        progress: Progress | None = None,
    ) -> Solution:
        """Solve with some of the data changed; all other data are as declared.

        Parameters
        ----------
        parameters : mapping from phase to mapping from name to value
        bounds : mapping from phase to mapping from name to (lower, upper)
            Bounds of states, controls, algebraic variables, path and end constraints; None for
            one of the two keeps the declared one.
        initial, final : mapping from phase to mapping from name to value, (lower, upper) or None
            Conditions of variables declared with a condition there; None leaves them free.
        durations : mapping from phase to duration or (lower, upper), s
        guess : guesses or Solution, optional
            Solution of this solver or of another one (see :func:`microbot_ocp.ocp.solve`).
        progress : callable, optional

        Raises
        ------
        InputError
            A name is unknown to the phase, a shape is wrong, or bounds are crossed.
        """
        begin = time.perf_counter()
        given = {
            "parameters": parameters or {},
            "bounds": bounds or {},
            "initial": initial or {},
            "final": final or {},
            "durations": durations or {},
        }
        program = self.program if not any(given.values()) else self._changed(given)
        try:
            with quiet():
                start = self._start(program, guess)
                if self._cost_scale is None:  # common to all solves: solvers are built with it
                    self.scale_cost(None)
        except RuntimeError as problem:
            return not_started(program, self.settings, self._given(program, guess), problem)
        program = replace(program, cost_scale=self._cost_scale)
        barrier = warm_barrier(self.settings, program, start)
        settings, solvers = self.settings, self._solvers.setdefault(barrier, {})
        if barrier is not None:
            warm = {"mu_init": barrier, **settings.options.get("ipopt warm", {})}
            settings = replace(settings, options={**settings.options, "ipopt warm": warm})
        spent = time.perf_counter() - begin
        return run_chain(
            program, settings, start, progress=progress, build_time=spent, solvers=solvers
        )

    def scale_cost(self, guess: Guesses | Solution | None) -> None:
        """Fix the cost scale, evaluated at a guess."""
        start = self._start(self.program, guess)
        self._cost_scale = with_cost_scale(self.program, start.x, self.settings).cost_scale

    def plot(self, axes: GivenAxes | None = None) -> DrawnAxes:
        """Plot the nonzeros of the program: :func:`microbot_ocp.plots.sparsity`."""
        return view_for(self, "plot")(self, axes)

    def export_c(self, path: str | Path, *, solver: str = "sqp") -> Path:
        """Write the program with a solver as one C file.

        Parameters
        ----------
        path : str or Path
        solver : "sqp", "ipopt" or "fatrop"
            CasADi's SQP method with its QP solver needs only the C library. With the others, the
            file calls a library that must be installed (``coin-or/IpStdCInterface.h``,
            ``fatrop/ocp/OCPCInterface.h``). The chain of solvers, scales and checks of
            :meth:`solve` are not included: check the violations of the result.

        Returns
        -------
        Path
            C file with three functions in CasADi's calling convention ``int solve(const double**
            arg, double** res, casadi_int* iw, double* w, int mem)``, with ``solve_work`` for the
            sizes:

            - ``data() -> x0, p, lbx, ubx, lbg, ubg``: declared data, and the default guess;
            - ``solve(x0, p, lbx, ubx, lbg, ubg, lam_x0, lam_g0) -> x, f, g, lam_x, lam_g, lam_p``
              of the scaled program, where ``f`` is the cost divided by ``cost_scale``;
            - ``values(x)`` -> every duration, state (at the mesh points) and control, unscaled and
              named by phase and name; components at one time are adjacent.

        Raises
        ------
        InputError
            The solver is unknown, or the program calls compiled functions.
        """
        checks.one_of("solver", solver, SOLVERS)
        if self.transcription.compiled:
            raise InputError("the program calls compiled functions, which cannot be exported")
        if self._cost_scale is None:
            self.scale_cost(None)
        assert self._cost_scale is not None
        program = replace(self.program, cost_scale=self._cost_scale)
        run = create(program, solver, self.settings)
        data = arguments_of(program, self._start(program, None))
        inputs = {n: ca.MX.sym(n, run.sparsity_in(n)) for n in (*data, "lam_x0", "lam_g0")}
        results = run.call(inputs)
        code = ca.CodeGenerator("program", {"with_header": False})
        code.add(ca.Function("data", [], [ca.DM(v) for v in data.values()], [], list(data)))
        code.add(
            ca.Function("solve", [*inputs.values()], [*results.values()], [*inputs], [*results])
        )
        code.add(_values(program))
        return write_whole(path, code.dump())

    def _given(self, program: Program, guess: Guesses | Solution | None) -> StartingPoint:
        phases = (layout.phase for layout in program.layouts)
        problem = with_phases(self.transcription.problem, phases)
        return starting_point(program, problem, guess)

    def _start(self, program: Program, guess: Guesses | Solution | None) -> StartingPoint:
        start = self._given(program, guess)
        return replace(start, x=finite_start(program, start.x))

    def _changed(self, given: Mapping[str, Mapping[str, Any]]) -> Program:
        names = [layout.phase.name for layout in self.program.layouts]
        for kind, changes in given.items():
            for name in changes:
                if name not in names:
                    raise InputError(f"{kind} has no phase {name!r}; there are {names}")
        layouts = []
        for layout in self.program.layouts:
            name = layout.phase.name
            of_phase = {kind: changes[name] for kind, changes in given.items() if name in changes}
            layouts.append(replace(layout, phase=with_changes(layout.phase, of_phase)))
        return replace(
            self.program,
            layouts=tuple(layouts),
            **vars(bounds_of(layouts)),
            parameters=np.concatenate([layout.data for layout in layouts]),
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self.transcription, self.mesh, self.settings, self._cost_scale)

    def __copy__(self) -> ParametricSolver:
        return _restored(*self.__reduce__()[1])

    def __deepcopy__(self, memo: object) -> ParametricSolver:
        return copy.copy(self)


def _values(program: Program) -> ca.Function:
    """Return the function from scaled variables to durations, states and controls by name."""
    x, outputs = program.nlp["x"], {}
    for layout in program.layouts:
        places: dict[str, list[tuple[float, int, int, float]]] = {}
        for block in layout.variables[:-1]:
            for entry, column in zip(block.entries, block.places.T, strict=True):
                if entry.kind in ("arrival", "state") and entry.fraction > 0.0:
                    continue
                entries = places.setdefault(entry.name, [])
                times = block.intervals + entry.fraction
                entries += [
                    (t, entry.component, k, entry.scale) for t, k in zip(times, column, strict=True)
                ]
        for name, entries in places.items():
            _, _, chosen, scales = zip(*sorted(entries), strict=True)
            chosen = chosen[:1] if name == DURATION else chosen
            label = re.sub(r"\W", "_", f"{layout.phase.name}_{name}")
            outputs[label] = x[list(map(int, chosen))] * ca.DM(scales[: len(chosen)])
    return ca.Function("values", [x], list(outputs.values()), ["x"], list(outputs))


def _restored(
    transcription: Transcription, mesh: Meshes, settings: SolverSettings, cost_scale: float | None
) -> ParametricSolver:
    solver = ParametricSolver(transcription, mesh, settings)
    solver._cost_scale = cost_scale
    return solver
