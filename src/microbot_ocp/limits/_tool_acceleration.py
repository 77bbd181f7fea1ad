"""Acceleration of the tool."""

from microbot_ocp.limits._limit import Bound, Limit, above_zero


def tool_acceleration(upper: Bound) -> Limit:
    """Limit the size of the acceleration of the tool's origin in the base frame.

    Parameters
    ----------
    upper : float or callable
        m/s^2, or an expression of the motion's state.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot").with_limits(also=[mo.limits.tool_acceleration(20.0)])
    """
    upper = above_zero("tool acceleration", upper, "m/s^2")
    return Limit("tool acceleration", _acceleration, upper=upper, unit="m/s^2")


def _acceleration(state):
    linear = state.tool_acceleration[:3]
    return (linear.T @ linear) ** 0.5
