"""Packages that only pictures need: without one, a sentence says so when a picture is asked for."""

from importlib import import_module

from microbot_ocp._base.checks import InputError


def need(what: str, package: str, distribution: str) -> None:
    """Refuse what needs a package that is not installed."""
    try:
        import_module(package)
    except ModuleNotFoundError as problem:
        if problem.name != package:
            raise
        raise InputError(f"{what} need {package}: pip install {distribution}") from None
