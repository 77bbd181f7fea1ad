"""Root mean square of the torques over a cycle: what heats a motor."""

from microbot_ocp.limits._limit import Bound, Limit


def rms_torque(upper: Bound, dwell: float = 0.0) -> Limit:
    """Limit the root mean square of every joint's torque over a motion and a rest after it.

    An integral over the whole motion: :func:`microbot_ocp.time_optimal` through joint poses keeps
    it and certificates judge it; every other planner refuses it.

    Parameters
    ----------
    upper : float or array_like [n]
        N m (N).
    dwell : float
        Rest at the end in each cycle, s; the arm is held against gravity.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> robot = robot.with_limits(also=[mo.limits.rms_torque([150.0, 250.0, 120.0], dwell=1.0)])
    """
    return Limit("rms torque", _torque, upper=upper, unit="N m", rms=True, dwell=dwell)


def _torque(state):
    return state.tau
