"""One line of the figures of motions: values of quantities against time, and how it looks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import AT_LIMIT, limit_history, use_of
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot
from microbot_ocp.simulation import Simulation, Tracking
from microbot_ocp.views._style import LineStyle

NAMES = {
    "q": "position",
    "qd": "velocity",
    "qdd": "acceleration",
    "tau": "torque",
    "error": "error",
}


@dataclass(frozen=True, eq=False)
class Curve:
    """One line in every axes.

    Attributes
    ----------
    label : str
        What the legend prints.
    t : array [N], s
    values : mapping from a quantity to array [N,n]
        "q", "qd", "qdd", "tau", "error" (of the position) or the key of a limit, [N,1] where it is
        one number, such as "tool_speed"; rad (m), N m (N) and so on; NaN is not drawn.
    color : str, optional
        Default by the place among the curves, as is the line style.
    linestyle : str or (offset, dashes), optional
    passages : sequence of float
        Times at which a via point is passed, s: marked.
    prominent : bool
        Whether it is drawn on top and a little wider.
    warning : str
        What is wrong with it, such as "not solved: ..."; printed in red above the legend.
    torque_limits : (lower [n], upper [n]), optional
        Its own, N m (N); where the torque is at one of them its axes are shaded.
    bounds : mapping from a quantity to arrays [N,n]
        Bounds that vary along the motion.
    """

    label: str
    t: FloatArray
    values: Mapping[str, FloatArray] = field(default_factory=dict)
    color: str | None = None
    linestyle: LineStyle | None = None
    passages: Sequence[float] = ()
    prominent: bool = False
    warning: str = ""
    torque_limits: tuple[FloatArray, FloatArray] | None = None
    bounds: Mapping[str, Sequence[FloatArray]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        source: Motion | Simulation,
        label: str | None = None,
        *,
        robot: Robot | None = None,
        quantities: Sequence[str] = (),
    ) -> Curve:
        """Return the curve of a motion, a simulation or a tracking.

        Parameters
        ----------
        source : Motion, Simulation or Tracking
        label : str, optional
            Default its own.
        robot : Robot, optional
            Needed for quantities that only its limits define.
        quantities : sequence of str
            Keys of limits whose quantity is evaluated besides, such as "tool_speed".
        """
        label = label or str(getattr(source, "label", "simulation"))
        values = {name: getattr(source, name) for name in ("q", "qd", "qdd", "tau")}
        bounds: Mapping[str, Sequence[FloatArray]] = {}
        if robot is not None:
            more, bounds = _limited_values(robot, source, [q for q in quantities if q not in NAMES])
            values |= more
        marks: Sequence[float] = ()
        torque_limits, warning = None, "" if source.solved else f"{label}: {source.status}"
        if isinstance(source, Motion):
            marks = tuple(m.time for m in source.marks if 0 < m.time < source.duration)
            warning = warning and f"{label}: not solved: {source.status}"
        elif isinstance(source, Tracking):
            values["error"], torque_limits = source.error, source.torque_limits
        return cls(
            label, source.t, values, passages=marks, warning=warning,
            torque_limits=torque_limits, bounds=bounds,
        )  # fmt: skip

    def saturated(self, joint: int) -> list[tuple[float, float]]:
        """Return spans of time, s, in which the torque of a joint is at one of its own limits."""
        if self.torque_limits is None or "tau" not in self.values:
            return []
        (lower, upper), tau = self.torque_limits, self.values["tau"][:, joint]
        at_limit = use_of(tau, lower[joint], upper[joint]) >= AT_LIMIT
        steps = np.diff(np.concatenate([[False], at_limit[:-1], [False]]).astype(int))
        spans = zip(self.t[steps == 1], self.t[steps == -1], strict=True)
        return [(float(start), float(end)) for start, end in spans]


def _limited_values(
    robot: Robot, source: Motion | Simulation, keys: Sequence[str]
) -> tuple[dict[str, FloatArray], dict[str, list[FloatArray]]]:
    """Return values at the samples of quantities that have a limit, and the bounds that vary."""
    if not keys:
        return {}, {}
    motion = source if isinstance(source, Motion) else source.as_motion("")
    history = limit_history(robot, motion)
    at = np.searchsorted(history.t, motion.t)  # the samples are among the times of the history
    limited = {key: history.limited[key] for key in keys if key in history.limited}
    bounds = {
        key: [bound[at] for bound in values[1:] if bound.shape == values.value.shape]
        for key, values in limited.items()
    }
    return {key: values.value[at] for key, values in limited.items()}, bounds
