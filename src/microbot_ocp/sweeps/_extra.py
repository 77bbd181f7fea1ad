"""The libraries of the extra ``scale``, imported when they are needed."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from microbot_ocp._base.checks import InputError


def needed(module: str) -> Any:
    """A module of the extra ``scale``.

    Raises
    ------
    InputError
        It is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        package = {"distributed": "dask.distributed"}.get(module, module.split(".")[0])
        raise InputError(
            f"sweeps need {package}, which is not installed: pip install 'microbot_ocp[scale]'"
        ) from None
