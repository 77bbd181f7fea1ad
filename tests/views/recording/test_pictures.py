"""A viewer without a screen draws every kind of recording: something is there, and it moves."""

import numpy as np
import pytest
from every_kind import KINDS
from headless_viewer import HeadlessViewer, missing_driver

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(missing_driver() is not None, reason=str(missing_driver())),
]

DIFFERENT = 24  # of 255, from which on two pixels differ
MOVED = 2e-3  # share of the pixels that change when an arm moves, at least
DRAWN = 4e-3  # share of the pixels in the colours of an arm, at least; an empty scene has 3e-4


@pytest.fixture(scope="module")
def viewer():
    with HeadlessViewer(600, 400) as shared:
        yield shared


def colourful(picture):
    """Share of the pixels that are neither grey nor black: arms, trails, arrows."""
    return float((np.ptp(picture.astype(int), axis=-1) > 60).mean())


def moved(picture, other):
    """Whether enough pixels differ."""
    return float((np.abs(picture.astype(int) - other).max(axis=-1) > DIFFERENT).mean()) > MOVED


@pytest.mark.parametrize("name", KINDS)
def test_picture_shows_the_arm_and_the_arm_moves(name, viewer, tmp_path):
    kind = KINDS[name]
    viewer.open(kind.make().save(tmp_path / f"{name}.rrd"))
    before: list[np.ndarray] = []

    def drawn(picture):
        return colourful(picture) > DRAWN and all(moved(picture, other) for other in before)

    for moment in kind.moments:
        viewer.seek(moment.timeline, **moment.as_argument())
        picture = viewer.picture(kind.view, drawn)
        assert colourful(picture) > DRAWN
        assert all(moved(picture, other) for other in before)
        before.append(picture)
    assert viewer.problems() == []
