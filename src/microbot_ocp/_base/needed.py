"""Packages that not every installation has: without one, a message says how to install it."""

from importlib import import_module
from typing import Any

from microbot_ocp._base.checks import InputError

DISTRIBUTIONS = {"rerun": "rerun-sdk"}  # packages whose distribution has another name


def needed(module: str, purpose: str, extra: str = "") -> Any:
    """Import a module; the message about a missing one begins with its purpose.

    Parameters
    ----------
    module : str
    purpose : str
        Purpose of the module, such as "figures need".
    extra : str
        Extra of this package that installs the module.

    Raises
    ------
    InputError
        The module is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        package = module.partition(".")[0].replace("_", "-")
        install = f"'microbot_ocp[{extra}]'" if extra else DISTRIBUTIONS.get(package, package)
        raise InputError(f"{purpose} {package}: pip install {install}") from None
