"""Comparison of the methods of :data:`METHODS` on one task under the same limits."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.foreign_words import HintingOfArms
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp._base.status import Status
from microbot_ocp._base.writing import NotWritten, made_folder, temporary_path
from microbot_ocp.certificate import Certificate, certificate_of
from microbot_ocp.execution import Profile, check_trials, commanded, load_profile, smallest_reserve
from microbot_ocp.motion import Motion
from microbot_ocp.ocp.solution import Iteration, quiet
from microbot_ocp.planning import PathTimingSettings, TimeOptimalSettings
from microbot_ocp.planning.task import check_limits, check_via
from microbot_ocp.robot import JointLimits, Limits, Robot
from microbot_ocp.tasks._folder import swap_in
from microbot_ocp.tasks._methods import METHODS, ComparedTask

if TYPE_CHECKING:
    from microbot_ocp._base.table import Table

REFERENCE = "cubic"  # name of the reference if no baseline is solved
SOLVING = 0.8  # share of a method's time for the solver; the certificate has the rest
# Units of work of a method or an output, for the progress bar; the default is 1 (about 1 s).
WORK = {"straight_path": 8, "cubic_path": 8, "time_optimal": 20}
WORK |= {"figures": 12, "report": 6, "recording": 4}
OUTPUTS = ("json", "csv", "figures", "report", "recording", "motions")


@dataclass(frozen=True)
class Step:
    """Progress of a comparison: units of work done, their total, and the current stage.

    One unit is about the solve of a textbook method.
    """

    done: int
    total: int
    stage: str  # "solve", "certify", "write" or "done"
    text: str
    iteration: Iteration | None = None  # last iteration of a running solver


Progress = Callable[[Step], None]


@dataclass(frozen=True, eq=False)
class Entry:
    """Result of one method: motion, certificate and costs.

    Attributes
    ----------
    name : str
        Key of the method, also the file name of its motion.
    title : str
        Name in legends and tables.
    motion : Motion or None
        None if the method found no motion; ``status`` and ``note`` hold the reason.
    certificate : Certificate or None
    status : Status
    note : str
    solve_time : float
        Wall time, s.
    torque_squared : float
        Integral of tau' tau, (N m)^2 s; NaN without masses, like ``work``.
    work : float
        Mechanical work: integral of the sum over the joints of abs(tau qd), J.
    details : mapping
        Further plain values: "certify_time"; "executed_duration" (with a ``profile``) and
        "trackable_duration" (with ``trackable``), s.
    """

    name: str
    title: str
    motion: Motion | None = None
    certificate: Certificate | None = None
    status: Status = Status.NOT_POSSIBLE
    note: str = ""
    solve_time: float = np.nan
    torque_squared: float = np.nan
    work: float = np.nan
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def solved(self) -> bool:
        """True if the method has a motion with the status solved."""
        return self.motion is not None and self.motion.solved


@dataclass(frozen=True, eq=False)
class Comparison(HintingOfArms):
    """Motions of one task by several methods, under the same limits."""

    robot: Robot
    via_q: FloatArray
    limits: JointLimits
    entries: tuple[Entry, ...]
    reference: str  # name of the entry to which durations are compared: the fastest baseline
    details: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        solved = sum(entry.solved for entry in self.entries)
        count = len(self.entries)
        return f"<Comparison of {count} methods on {self.robot.name!r}: {solved} solved>"

    def _repr_html_(self) -> str:
        return view_for(self, "table")(self)._repr_html_()

    def __getitem__(self, name: str) -> Entry:
        return checks.by_name("the comparison", {e.name: e for e in self.entries}, name)

    @property
    def motions(self) -> dict[str, Motion]:
        """Motions by method name; methods without a motion are left out."""
        return {e.name: e.motion for e in self.entries if e.motion is not None}

    @property
    def certificates(self) -> dict[str, Certificate]:
        """Certificates by method name."""
        return {e.name: e.certificate for e in self.entries if e.certificate is not None}

    @property
    def solved(self) -> bool:
        """True if every method solved the task."""
        return all(entry.solved for entry in self.entries)

    @property
    def certified(self) -> bool:
        """True if the certificate of every motion is ok."""
        return all(certificate.ok for certificate in self.certificates.values())

    def table(self) -> Table:
        """Return a table with one row per method, for printing, Jupyter, Markdown or CSV."""
        return view_for(self, "table")(self)

    def plot(self, axes: GivenAxes | None = None, **options: Any) -> DrawnAxes:
        """Plot positions, velocities and torques by :func:`microbot_ocp.plots.comparison`."""
        return view_for(self, "plot")(self, axes, **options)

    def plot_paths(self, axes: GivenAxes | None = None) -> DrawnAxes:
        """Plot the tool paths in space by :func:`microbot_ocp.plots.paths`."""
        return view_for(self, "paths")(self, axes)

    def report(self, path: str | Path) -> Path:
        """Write a report in one file: pages (``.pdf``), or ``.html`` with a film inside."""
        kind = "html_report" if Path(path).suffix == ".html" else "report"
        return view_for(self, kind)(self, path)

    def to_rerun(self, path: str | Path) -> Path:
        """Write a Rerun recording with its blueprint inside."""
        return view_for(self, "rerun")(self).save(path)

    def export(
        self,
        path: str | Path,
        rate: float | None = None,
        methods: Sequence[str] | None = None,
        theme: str = "light",
    ) -> Path:
        """Write a film of some motions: one arm solid, the other arms transparent.

        Parameters
        ----------
        path, rate, theme
            Parameters of ``write_animation``, whose errors are raised.
        methods : sequence of str, optional
            Keys of motions; default the fastest method and the reference.

        Returns
        -------
        Path
            The file.
        """
        film = view_for(self, "animation")
        return film(self, path, rate, methods=methods, theme=theme)

    def save(
        self,
        folder: str | Path,
        outputs: Sequence[str] = OUTPUTS,
        *,
        progress: Progress | None = None,
    ) -> list[Path]:
        """Write some of :data:`OUTPUTS` into a folder, by default all.

        The files are written in a hidden subfolder and moved when all are complete; files of an
        earlier run are replaced. ``comparison.json`` is moved last and holds digests of the other
        files, so that :func:`load_comparison` refuses a mixture of two runs.

        Parameters
        ----------
        folder : str or Path
        outputs : sequence of str
        progress : callable, optional
            Called with a :class:`Step` before each output.

        Returns
        -------
        list of Path
            ``comparison.json``, ``.csv``, ``.rrd``, ``.png``, ``.pdf``, ``paths.png``, ``.pdf``,
            ``report.pdf``, ``.html``, ``motions/NAME.npz``.

        Raises
        ------
        InputError
            An unknown output.
        NotWritten
            The folder or disk does not allow writing; the error is an ``InputError`` and an
            ``OSError``. The files of the earlier run are kept unless the move itself failed.
        """
        for output in outputs:
            checks.one_of("outputs", output, OUTPUTS)
        target = Path(folder)
        try:
            made_folder(target)
            with temporary_path(target / "run") as stage:
                (stage / "motions").mkdir(parents=True)
                total, done = sum(WORK.get(output, 1) for output in outputs), 0
                for output in outputs:
                    if progress is not None:
                        progress(Step(done, total, "write", f"{output} in {target}"))
                    self._write(output, stage)
                    done += WORK.get(output, 1)
                for output in {"json", "motions"} - set(outputs):  # their digests identify the run
                    self._write(output, stage)
                return swap_in(stage, target, "json" in outputs, "motions" in outputs)
        except NotWritten as problem:  # names the file in its place, not the temporary one
            place = re.sub(r"\.run\.[^/\\]*\.part[/\\]", "", problem.path)
            raise NotWritten(place, problem.reason) from None
        except OSError as problem:
            raise NotWritten(target, problem.strerror or str(problem)) from None

    def _write(self, output: str, folder: Path) -> None:
        if output == "motions":
            for name, motion in self.motions.items():
                motion.save(folder / "motions" / f"{name}.npz")
        elif output == "figures":
            for name, axes in (("comparison", self.plot()), ("paths", self.plot_paths())):
                for kind in ("png", "pdf"):
                    axes.savefig(folder / f"{name}.{kind}")
        elif output == "report":
            self.report(folder / "report.pdf")
            self.report(folder / "report.html")
        elif output == "recording":
            self.to_rerun(folder / "comparison.rrd")
        else:
            view_for(self, output)(self, folder / f"comparison.{output}")


def compare(
    robot: Robot,
    via_q: ArrayLike,
    methods: Sequence[str] | None = None,
    limits: Limits | JointLimits | None = None,
    *,
    via_t: ArrayLike | None = None,
    via_qd: ArrayLike | None = None,
    blend: float | None = None,
    time_limit: float = np.inf,
    progress: Progress | None = None,
    profile: str | Profile | None = None,
    trackable: Mapping[str, Any] | None = None,
    **settings: Any,
) -> Comparison:
    """Solve one task by several methods under the same limits, and certify every motion.

    Parameters
    ----------
    robot : Robot
        Robot with masses.
    via_q : array_like [m,n]
        Via points, rad (m); the motion is at rest at both ends.
    methods : sequence of str, optional
        Keys of :data:`METHODS`; default all, without "cubic_report", "cubic_scaled" and
        "lspb_scaled" if there is no ``via_t``, which they need.
    limits : Limits, optional
        Limits of the task; default the robot's limits.
    via_t : array_like [m], optional
        Times at the via points, s, for the methods with given times. "cubic" and "lspb" optimise
        times and via velocities (:func:`best_cubic`, :func:`best_lspb`), "cubic_textbook" and
        "lspb_textbook" the times only.
    via_qd : array_like [m,n], optional
        Velocities at the via points for ``via_t``, rad/s, used by the textbook methods and scaled
        with the duration of the motion; default Craig's heuristic: the mean of the slopes on both
        sides, zero if their sign changes.
    blend : float, optional
        Blend time of LSPB as a share of each segment, up to 0.5. Default 0.25 at given times, and
        an optimised share per segment otherwise.
    time_limit : float
        Wall time of all methods and certificates, s; by default a free motion and the timing of a
        path take 120 s each at most. Methods share the remaining time equally. A method out of time
        returns its best motion with the status "time limit". A fifth of each share is kept for the
        certificate, which is refused if it needs longer.
    progress : callable, optional
        Called with a :class:`Step`.
    profile : str or Profile, optional
        Profile of a controller: the table has the duration of each motion as rows that this
        controller accepts, by :func:`commanded`.
    trackable : mapping, optional
        Arguments of :func:`smallest_reserve`, such as ``controller``, ``plants``, ``bound``: the
        table has the duration of each motion with the least reserve that lets all plants follow.
    **settings
        Fields of :class:`TimeOptimalSettings` and :class:`PathTimingSettings`.

    Returns
    -------
    Comparison
        A method without a motion has an entry with the reason in ``status`` and ``note``.

    Raises
    ------
    InputError
        Bad via points, timing, limits or method names, before any solver starts.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> via_q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
    >>> result = mo.compare(mo.load_robot("microbot"), via_q, ["cubic", "lspb"])
    >>> [str(entry.status) for entry in result.entries]
    ['solved', 'solved']
    """
    family = check_limits(robot, limits)
    via = check_via(family, via_q)
    names = _method_names(methods, via_t is not None)
    if blend is not None:
        blend = checks.number("blend", blend, "of a segment", above=0.0, at_most=0.5)
    if profile is not None:
        profile = load_profile(profile)
        profile.limits_of(family.robot)  # checks the number of joints before any solver starts
    if trackable is not None:
        with checks.naming("trackable: "):
            check_trials(family.robot, **trackable)
    free, path = _settings(settings)
    times, velocities = timing(via, via_t, via_qd)
    work = [WORK.get(name, 1) + 1 for name in names]  # solve, and one unit for the certificate
    entries: list[Entry] = []
    until = time.perf_counter() + min(checks.time_limit(time_limit), deadline.left())

    def report_step(index: int, event: Iteration | str, stage: str = "solve") -> None:
        if progress is not None:
            done = sum(work[:index]) + (work[index] - 1) * (stage == "certify")
            iteration = event if isinstance(event, Iteration) else None
            text = f"{METHODS[names[index]].title}: {event}"
            progress(Step(done, sum(work), stage, text, iteration))

    for index, name in enumerate(names):
        report = partial(report_step, index)
        reporter = quiet if progress is None else report
        task = ComparedTask(family, via, times, velocities, blend, free, path, reporter)
        report("solving")
        # A time limit is above 0, also for a method that has no time left.
        seconds = max((until - time.perf_counter()) / (len(names) - index), ROUNDING)
        begin, motion, note = time.perf_counter(), None, ""
        try:
            with deadline.within(SOLVING * seconds):
                motion = METHODS[name].solve(task)
        except InputError as problem:  # other methods may still solve the task
            note = str(problem)
        wall = time.perf_counter() - begin
        entries.append(Entry(name, METHODS[name].title, note=note, solve_time=wall))
        if motion is not None:
            report(f"{motion.duration:.4f} s, certifying", stage="certify")
            executed = _executed(family.robot, motion, profile, trackable)
            entries[-1] = _certified(entries[-1], task, motion, seconds - wall, executed)
    if progress is not None:
        progress(Step(sum(work), sum(work), "done", f"{len(names)} methods done"))
    return Comparison(robot, via, family.robot.limits, tuple(entries), _reference(entries))


def _reference(entries: Sequence[Entry]) -> str:
    """Return the name of the fastest baseline that is solved and certified."""
    durations = {
        entry.name: entry.motion.duration
        for entry in entries
        if METHODS[entry.name].baseline and entry.solved and entry.motion
        if entry.certificate and entry.certificate.ok
    }
    return min(durations, key=durations.__getitem__, default=REFERENCE)


def _method_names(methods: Sequence[str] | None, timed: bool) -> list[str]:
    if methods is None:
        return [name for name, method in METHODS.items() if timed or not method.timed]
    if isinstance(methods, str):
        raise InputError(f"methods must be a list of names, not {methods!r}")
    names = [checks.one_of("method", name, METHODS) for name in methods]
    if not names or len(set(names)) != len(names):
        raise InputError(f"methods must be different names, not {list(methods)}")
    for name in names:
        if METHODS[name].timed and not timed:
            raise InputError(f"method {name!r} needs via_t, the times at the via points, s")
    return names


def _settings(given: Mapping[str, Any]) -> tuple[TimeOptimalSettings, PathTimingSettings]:
    """Return the settings of the free motion and of path timing from one mapping."""
    for_free = {f.name for f in fields(TimeOptimalSettings)} - {"time_limit"}
    for_path = {f.name for f in fields(PathTimingSettings)} - {"time_limit"}
    for key in given:
        checks.one_of("setting of compare", key, sorted(for_free | for_path))
    free = TimeOptimalSettings(**{k: v for k, v in given.items() if k in for_free})
    return free, PathTimingSettings(**{k: v for k, v in given.items() if k in for_path})


def timing(
    via: FloatArray, via_t: ArrayLike | None, via_qd: ArrayLike | None, prefix: str = "via_"
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return checked times and velocities at via points; ``prefix`` names them in messages."""
    if via_t is None:
        if via_qd is not None:
            raise InputError(
                f"{prefix}qd needs {prefix}t, the times at which the via velocities are meant"
            )
        return None, None
    times = checks.times(f"{prefix}t", via_t, len(via), from_zero=True)
    checks.number(f"the last of {prefix}t", times[-1], "s", at_most=checks.LONGEST)
    if via_qd is None:
        return times, None
    return times, checks.array(f"{prefix}qd", via_qd, via.shape, "rad/s")


def _executed(
    robot: Robot, motion: Motion, profile: str | Profile | None, trackable: Mapping[str, Any] | None
) -> dict[str, float]:
    """Return the durations on a controller and with trackable reserve, s; NaN if impossible."""
    durations: dict[str, float] = {}
    if profile is not None:
        try:
            command = commanded(robot, motion, profile)
            cost = command.cost if command.accepted else np.nan
        except InputError:  # no slower motion is accepted either
            cost = np.nan
        durations["executed_duration"] = motion.duration + cost
    if trackable is not None:
        reserve = smallest_reserve(robot, motion, **trackable)
        lasts = reserve.motion.duration if reserve.solved else np.nan
        durations["trackable_duration"] = lasts
    return durations


def _certified(
    entry: Entry, task: ComparedTask, motion: Motion, left: float, executed: Mapping[str, float]
) -> Entry:
    """Return an entry with its motion and a certificate made within ``left`` s."""
    tau = motion.tau if task.robot.has_dynamics else np.full_like(motion.tau, np.nan)
    motion = replace(motion, provenance={**motion.provenance, "robot": task.robot.name})
    with deadline.within(max(left, ROUNDING)):
        certificate = certificate_of(task.family, motion, task.via_q)
    return replace(
        entry,
        motion=motion,
        certificate=certificate,
        status=motion.status,
        note=motion.note,
        torque_squared=float(np.trapezoid(np.sum(tau**2, axis=1), motion.t)),
        work=float(np.trapezoid(np.sum(np.abs(tau * motion.qd), axis=1), motion.t)),
        details={"certify_time": certificate.wall_time, **executed},
    )
