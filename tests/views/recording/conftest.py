"""Rerun raises here where it would only warn; one recording that several tests read."""

import pytest

from microbot_ocp.views.recording import of_comparison


@pytest.fixture(scope="session", autouse=True)
def _strict():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RERUN_STRICT", "1")
        yield


@pytest.fixture(scope="session")
def recording(comparison, tmp_path_factory):
    """Path of the recording of ``comparison``."""
    return of_comparison(comparison).save(tmp_path_factory.mktemp("rrd") / "run.rrd")
