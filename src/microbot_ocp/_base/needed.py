"""Packages that not every installation has: without one, a sentence says what to install."""

from importlib import import_module
from typing import Any

from microbot_ocp._base.checks import InputError

DISTRIBUTIONS = {"rerun": "rerun-sdk"}  # where it is not named as the package


def needed(module: str, what: str, extra: str = "") -> Any:
    """Import a module for what needs it, such as "figures need", of an extra if there is one.

    Raises
    ------
    InputError
        It is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        package = module.partition(".")[0].replace("_", "-")
        install = f"'microbot_ocp[{extra}]'" if extra else DISTRIBUTIONS.get(package, package)
        raise InputError(f"{what} {package}: pip install {install}") from None
