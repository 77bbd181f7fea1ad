"""Shared fixtures; compiled functions of the tests stay in pytest's own cache folder."""

from __future__ import annotations

import gc
import os
import sys

import pytest
from hypothesis import HealthCheck, settings

import microbot_ocp as mo

collect_ignore = ["reliability/windows"]  # its import would hide modules in this process

settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    max_examples=25,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
settings.load_profile("repeatable")


def pytest_configure(config: pytest.Config) -> None:
    if "MICROBOT_OCP_CACHE" not in os.environ and hasattr(config, "cache"):
        os.environ["MICROBOT_OCP_CACHE"] = str(config.cache.mkdir("compiled"))
    # Python would compile this package again in every process that a test starts.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False


def pytest_collection_finish() -> None:
    """What was collected stays: looking through it again and again took a tenth of the time."""
    gc.freeze()
    gc.set_threshold(100_000, 50, 50)


@pytest.fixture(scope="session")
def microbot() -> mo.Robot:
    return mo.load_robot("microbot")
