"""CasADi functions of a robot whose errors name the wrong argument."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, update_wrapper
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import InputError
from microbot_ocp._base.codegen import compile_function

SYMBOLS = (ca.DM, ca.SX, ca.MX)
Maker = TypeVar("Maker", bound=Callable[..., Any])


class RobotFunction(ca.Function):
    """A CasADi function whose error names the argument of a wrong shape and the right shape."""

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        try:
            return super().__call__(*arguments, **named)
        except (RuntimeError, NotImplementedError) as problem:
            self._explain(arguments, named, problem)
            raise

    def _explain(
        self, arguments: tuple[Any, ...], named: dict[str, Any], problem: Exception
    ) -> None:
        names = self.name_in()
        call = f"{self.name()}({', '.join(names)})"
        if not named and len(arguments) != len(names):
            raise InputError(
                f"{call} takes {len(names)} arguments, not {len(arguments)}"
            ) from problem
        for name in named:
            if name not in names:
                raise InputError(f"{call} has no argument {name!r}") from problem
        for name, value in [*zip(names, arguments, strict=False), *named.items()]:
            count = self.size1_in(name)
            shape = list(_shape(value))
            if shape[:1] not in ([], [count], [1]):
                turned = shape[1:] == [count]
                hint = "; transpose it: configurations stand side by side" if turned else ""
                raise InputError(
                    f"{name} of {self.name()} must have shape [{count}] or [{count}, N], "
                    f"not {shape}{hint}"
                ) from problem


def _shape(value: Any) -> tuple[int, ...]:
    if isinstance(value, SYMBOLS):
        return value.shape
    try:
        return np.shape(value)
    except ValueError:  # rows of different lengths
        return (-1,)


def symbols(robot: Any, *names: str) -> dict[str, ca.SX]:
    """Return named vectors of symbols, one entry per joint."""
    return {name: ca.SX.sym(name, robot.joint_count) for name in names}


def robot_function(
    name: str, inputs: dict[str, ca.SX], outputs: dict[str, Any], compiled: bool
) -> RobotFunction:
    """Return a RobotFunction of these expressions, compiled if wanted."""
    results = [ca.densify(value) for value in outputs.values()]
    function = ca.Function(name, [*inputs.values()], results, [*inputs], [*outputs])
    return RobotFunction(compile_function(function) if compiled else function)


def function_maker(make: Maker) -> Maker:
    """Return a cached version of a function that makes functions of a robot without its limits.

    An InputError explains the call if the arguments are those of the made function.
    """
    cached = lru_cache(maxsize=128, typed=True)(make)

    def maker(robot: Any, *arguments: Any, **settings: Any) -> Any:
        if any(isinstance(value, SYMBOLS) or np.ndim(value) > 0 for value in arguments):
            name = make.__name__
            inputs = ", ".join(cached(robot.without_limits).name_in())
            raise InputError(f"{name} makes a function: write {name}(robot)({inputs})")
        return cached(robot.without_limits, *arguments, **settings)

    return update_wrapper(maker, make)  # type: ignore[return-value]
