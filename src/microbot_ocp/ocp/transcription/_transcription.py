"""Direct transcription of a problem on meshes, in stages.

The kernels of an interval are built once and used for every mesh.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence, Sized
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.portable import Portable
from microbot_ocp.ocp.problem import (
    OptimalControlProblem,
    Phase,
    Variable,
    with_phases,
    with_shapes,
    with_values,
)
from microbot_ocp.ocp.transcription._assembly import Program, assemble
from microbot_ocp.ocp.transcription._composition import Composition, Derivatives, automatic
from microbot_ocp.ocp.transcription._kernels import with_derivatives
from microbot_ocp.ocp.transcription._layout import PhaseLayout, lay_out, stage_kind
from microbot_ocp.ocp.transcription.schemes import SCHEMES, Collocation, Scheme

MOST_INTERVALS = 100_000

MeshLike = int | ArrayLike
Meshes = Sequence[MeshLike] | MeshLike  # one per phase, or one for all phases
MakeKernels = Callable[[], Sequence[ca.Function]]
GuessValue = ArrayLike | Callable[[FloatArray], ArrayLike]


@dataclass(frozen=True, eq=False)
class Guess:
    """Initial guess of one phase: its duration, s, and values by name.

    Values are constants [size], arrays [N+1, size] over the mesh points, or functions of the
    fractions [N+1] of the phase that return such arrays; a scalar may be an array [N+1]. Missing
    values start from :func:`~microbot_ocp.ocp.solution.default_guess`.
    """

    duration: float | None = None
    values: Mapping[str, GuessValue] = field(default_factory=dict)

    def with_values(self, values: Mapping[str, GuessValue]) -> Guess:
        """Return a copy with other or additional values."""
        return Guess(self.duration, {**self.values, **values})


Guesses = Mapping[str, Guess]  # keys: phase names


def guess_table(value: GuessValue, size: int, fractions: FloatArray) -> FloatArray:
    """Return a guess [M, size] at fractions [M] of its phase, or a table of another shape as it is.

    Constants hold at all fractions; a row of values of a scalar becomes a column.
    """
    table = np.asarray(value(fractions) if callable(value) else value, dtype=float)
    if table.ndim <= 1 and table.size in (1, size):
        return np.broadcast_to(table.reshape(1, -1), (fractions.size, size))
    return table[:, None] if table.ndim == 1 and size == 1 else table


def sampled(value: GuessValue | None, variable: Variable, fractions: FloatArray) -> FloatArray:
    """Return a guess of a variable at fractions [M] of its phase [M, size], for any mesh.

    None means the values nearest to zero within the bounds. A wrong shape results in zero: it is
    rejected where the guess is used.
    """
    nearest = np.clip(0.0, variable.lower, variable.upper)
    table = guess_table(nearest if value is None else value, variable.size, fractions)
    if table.ndim == 3:  # values at the points of a scheme
        table = table.reshape(-1, table.shape[-1])
    if table.ndim != 2 or len(table) == 0 or table.shape[1] != variable.size:
        return np.zeros((fractions.size, variable.size))
    return np.array(table) if len(table) == fractions.size else interpolate(table, fractions)


def interpolate(table: FloatArray, s: FloatArray, places: FloatArray | None = None) -> FloatArray:
    """Return a table [K, size] at fractions s [M], linear between its places, by default even."""
    places = np.linspace(0.0, 1.0, len(table)) if places is None else places
    return np.column_stack([np.interp(s, places, column) for column in table.T])


def mesh_of(mesh: MeshLike) -> FloatArray:
    """Return increasing fractions [N+1] from 0 to 1, from fractions or a number of intervals."""
    if isinstance(mesh, (int, np.integer)):
        if mesh < 2:
            raise InputError(f"mesh must have at least 2 intervals, not {mesh}")
        checks.size("the number of intervals", float(min(mesh, 10**300)), MOST_INTERVALS)
        return np.linspace(0.0, 1.0, int(mesh) + 1)
    if isinstance(mesh, float):
        raise InputError(f"mesh must be a whole number of intervals or fractions, not {mesh}")
    given = checks.array("mesh", mesh, (None,))
    if given.size < 3 or given[0] != 0.0 or given[-1] != 1.0 or np.any(np.diff(given) <= 0):
        raise InputError("mesh must be increasing fractions from 0 to 1, or a number of intervals")
    return given


def _is_fractions(meshes: Any) -> bool:
    """Return True if a list is one mesh of fractions, not one number of intervals per phase."""
    flat = all(isinstance(entry, (float, int, np.number)) for entry in meshes)
    return flat and len(meshes) > 2 and any(isinstance(k, (float, np.floating)) for k in meshes)


def with_points(mesh: FloatArray, fractions: Sequence[float]) -> FloatArray:
    """Return the mesh with given fractions among its points.

    The nearest mesh point moves there if its distance is less than half of the shorter interval
    beside it; otherwise a point is added.
    """
    points = mesh.tolist()
    wanted = [f for f in fractions if f not in points]
    held = set(fractions)
    for fraction in wanted:
        place = int(np.searchsorted(points, fraction))
        near = min((place - 1, place), key=lambda k: abs(points[k] - fraction))
        movable = 0 < near < len(points) - 1 and points[near] not in held
        gap = abs(points[near] - fraction)
        if movable and 2 * gap < min(np.diff(points[near - 1 : near + 2])):
            points[near] = fraction
        else:
            points.insert(place, fraction)
    return np.array(points) if wanted else mesh


class Transcription(Portable):
    """A problem with its kernels built once, to be laid out on any number of meshes.

    Parameters
    ----------
    problem : OptimalControlProblem
    scheme : str or Scheme
        "shooting", "radau", "gauss", "trapezoidal", "hermite_simpson", or a Scheme with settings.
    duration_scale : float
        Typical duration of the phases that declare none, s.
    prepare : callable, optional
        Function of a text that identifies the kernels of a phase and of a function that builds
        them; it returns equal, faster kernels (compiled code).
    derivatives : callable, optional
        Function that returns first and second derivatives of a function that expressions call, or
        None; see ``_composition.py``.
    """

    def __init__(
        self,
        problem: OptimalControlProblem,
        *,
        scheme: str | Scheme = "radau",
        duration_scale: float = 1.0,
        prepare: Callable[[str, MakeKernels], Sequence[ca.Function]] | None = None,
        derivatives: Derivatives = automatic,
    ) -> None:
        problem.check()
        self.duration_scale = checks.number("duration_scale", duration_scale, "s", above=0.0)
        if isinstance(scheme, str):
            scheme = SCHEMES[checks.one_of("scheme", scheme, SCHEMES)]
        self.scheme = scheme
        inside = isinstance(scheme, Collocation)
        self.problem = problem = with_shapes(problem, "polynomial" if inside else "constant")
        self._prepare = prepare
        self._derivatives = derivatives
        self._known: dict[str, Sequence[ca.Function]] = {}
        self._last: tuple[tuple[bytes, ...], Program] | None = None
        self._kinds = [
            stage_kind(phase, scheme, phase.duration_scale or self.duration_scale, self._derive)
            for phase in problem.phases
        ]
        self.kernels = [kind.kernels for kind in self._kinds]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_last": None}  # rebuilt when needed

    @property
    def compiled(self) -> bool:
        """True if ``prepare`` replaced the kernels, so that they need not match the problem."""
        return self._prepare is not None

    def with_parameters(
        self, values: Mapping[str, Mapping[str, float | FloatArray]]
    ) -> Transcription:
        """Return a transcription with its kernels and other parameters, by phase and name."""
        return self.with_phases(with_values(p, values.get(p.name, {})) for p in self.problem.phases)

    def with_phases(self, phases: Iterable[Phase]) -> Transcription:
        """Return a transcription with its kernels, and phases that differ in their numbers only."""
        changed = copy.copy(self)
        changed.problem, changed._last = with_phases(self.problem, phases), None
        return changed

    def _derive(
        self, functions: Sequence[ca.Function], compositions: Sequence[Composition | None]
    ) -> Sequence[ca.Function]:
        # Phases with equal physics share all expensive kernels.
        key = "".join(function.serialize() for function in functions)
        if key not in self._known:
            make = partial(with_derivatives, functions, compositions, self._derivatives)
            self._known[key] = make() if self._prepare is None else self._prepare(key, make)
        return self._known[key]

    def program(self, meshes: Meshes) -> Program:
        """Return the program on a mesh for each phase.

        The last program is kept, since many solves begin on the same meshes.
        """
        given = tuple(points.tobytes() for points in self._points(meshes))
        last = self._last  # read once: another thread may replace it
        if last is None or last[0] != given:
            self._last = last = given, assemble(self.layouts(meshes))
        return last[1]

    def _points(self, meshes: Meshes) -> list[FloatArray]:
        """Return the mesh points of every phase as fractions, with the point fractions added."""
        phases = self.problem.phases
        several = isinstance(meshes, Sized) and getattr(meshes, "ndim", 1) > 0
        several = several and not _is_fractions(meshes)
        chosen: list[Any] = list(meshes) if several else [meshes] * len(phases)  # type: ignore[arg-type]
        if len(chosen) != len(phases):
            raise InputError(f"mesh has {len(chosen)} entries for {len(phases)} phases")
        return [
            with_points(mesh_of(phase_mesh), phase.point_fractions)
            for phase_mesh, phase in zip(chosen, phases, strict=True)
        ]

    def layouts(self, meshes: Meshes) -> tuple[PhaseLayout, ...]:
        """Return the layouts of all phases on their meshes."""
        phases, given = self.problem.phases, self._points(meshes)
        links = {link.before: link.names for link in self.problem.links}
        layouts: list[PhaseLayout] = []
        begin = np.zeros(2, dtype=int)  # first variable and row of the next phase
        for index, (phase, mesh) in enumerate(zip(phases, given, strict=True)):
            after = slice(index + 1, index + 2)
            following = [entry for other in self._kinds[after] for entry in other.node]
            linked = *links.get(phase.name, ()), *_carried(phase, phases[after])
            layout = lay_out(phase, mesh, self._kinds[index], following, linked, begin)
            layouts.append(layout)
            begin = begin + np.array([layout.variable_count, layout.row_count])
        return tuple(layouts)


AnyProblem = OptimalControlProblem | Transcription


def _carried(before: Phase, after: Sequence[Phase]) -> list[str]:
    """Return names of the free parameters that a phase shares with later phases."""
    others = [other.symbol for phase in after for other in phase.free_parameters]
    free = before.free_parameters
    return [p.name for p in free if any(ca.is_equal(p.symbol, other) for other in others)]
