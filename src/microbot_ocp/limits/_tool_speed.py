"""Speed of the tool."""

from microbot_ocp.limits._limit import Bound, Limit, above_zero


def tool_speed(upper: Bound) -> Limit:
    """Limit the speed of the tool's origin in the base frame.

    Parameters
    ----------
    upper : float or callable
        m/s, or an expression of the motion's state: a lower speed in a zone, for example.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot").with_limits(also=[mo.limits.tool_speed(upper=1.0)])
    """
    return Limit("tool speed", _speed, upper=above_zero("tool speed", upper, "m/s"), unit="m/s")


def _speed(state):
    linear = state.tool_velocity[:3]
    return (linear.T @ linear) ** 0.5
