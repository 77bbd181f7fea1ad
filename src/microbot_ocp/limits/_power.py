"""Mechanical power of the joints."""

from microbot_ocp.limits._limit import Bound, Limit


def power(upper: Bound = None, lower: Bound = None) -> Limit:
    """Limit the mechanical power ``tau qd`` of every joint.

    Parameters
    ----------
    upper, lower : float, array_like [n] or callable, optional
        W; a lower bound limits what a joint feeds back when it brakes.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot").with_limits(also=[mo.limits.power([300.0, 400.0, 150.0])])
    """
    return Limit("power", _power, lower=lower, upper=upper, unit="W")


def total_power(upper: Bound = None, lower: Bound = None) -> Limit:
    """Limit the sum of the mechanical powers of all joints.

    Parameters
    ----------
    upper, lower : float or callable, optional
        W; a lower bound limits what the arm feeds back when it brakes.
    """
    return Limit("total power", _total_power, lower=lower, upper=upper, unit="W")


def _power(state):
    return state.tau * state.qd


def _total_power(state):
    return state.tau.T @ state.qd
