"""The second timeline, against the length of the path."""

from dataclasses import replace

import numpy as np
import pytest
from reading import poses, read, scalars

from microbot_ocp.motion import Motion
from microbot_ocp.tasks import Comparison
from microbot_ocp.views.recording import of_comparison
from microbot_ocp.views.recording._animated_arm import drawn_rate, drawn_times, progress

PROGRESS = "progress_permille"


def test_progress_is_the_share_of_the_joint_path(comparison, recording):
    for entry in comparison.entries[:3]:
        motion = entry.motion
        dense = np.linspace(0.0, motion.duration, 20001)
        speed = np.linalg.norm(motion.sample(dense).qd, axis=1)
        length = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(dense)))
        t, _ = read(recording, f"/world/{entry.name}/link_1", "Transform3D:translation")
        told, _ = read(
            recording, f"/world/{entry.name}/link_1", "Transform3D:translation", PROGRESS
        )
        share = np.interp(t, dense, length / length[-1])
        np.testing.assert_allclose(told, 1000 * share, atol=0.51)
        assert told[0] == 0
        assert told[-1] == 1000


def test_methods_on_one_path_are_in_step_by_progress(comparison, tmp_path):
    """The same shape at another speed is at the same place at the same progress."""
    entry = comparison.entries[1]
    slow = entry.motion
    factor = 1.7
    fast = Motion(slow.t / factor, slow.q, slow.qd * factor, slow.qdd * factor**2, slow.tau)
    pair = replace(entry, name="slow"), replace(entry, name="fast", motion=fast)
    both = Comparison(comparison.robot, comparison.via_q, comparison.limits, pair, "slow")
    path = of_comparison(both, rate=1000.0).save(tmp_path / "pair.rrd")
    places = {}
    for name in ("slow", "fast"):
        permille, _ = read(path, f"/world/{name}/tool", "Transform3D:translation", PROGRESS)
        _, tool = poses(path, f"/world/{name}/tool")
        at = np.searchsorted(permille, np.arange(0, 1001, 50))
        places[name] = tool[at]
    travelled = np.linalg.norm(np.diff(places["slow"], axis=0), axis=1).sum()
    np.testing.assert_allclose(places["slow"], places["fast"], atol=2e-3 * travelled)
    assert travelled > 5.0


def test_curves_have_both_timelines(recording):
    _, by_time = scalars(recording, "/plots/tau/elbow/cubic")
    permille, by_progress = scalars(recording, "/plots/tau/elbow/cubic", PROGRESS)
    np.testing.assert_array_equal(by_time, by_progress)
    assert (np.diff(permille) >= 0).all()


def test_progress_over_time_and_time_over_progress(comparison, recording):
    duration = comparison.entries[1].motion.duration
    t, percent = scalars(recording, "/plots/progress/cubic")
    assert percent[[0, -1]] == pytest.approx([0.0, 100.0])
    _, elapsed = scalars(recording, "/plots/elapsed/cubic", PROGRESS)
    np.testing.assert_allclose(elapsed, t, atol=1e-9)
    assert elapsed[-1] == pytest.approx(duration)
    assert not read(recording, "/plots/elapsed/cubic", "Scalars:scalars")[0].size


def test_arm_at_rest_goes_by_the_time():
    t = np.linspace(0.0, 2.0, 21)
    still = np.ones((21, 2))
    motion = Motion(t, still, 0 * still, 0 * still, 0 * still)
    np.testing.assert_allclose(progress(motion, t), t / 2.0)


def test_drawn_times_keep_ends_and_jumps_and_fill_gaps():
    t = np.concatenate([np.linspace(0, 1, 1001)[:-1], [1 - 1e-6, 1.0, 1.5, 1.5003]])
    drawn = drawn_times(np.unique(t), 200.0)
    assert drawn[[0, -1]].tolist() == [0.0, 1.5003]
    assert {1.0, 1.5}.issubset(np.round(drawn, 9))
    assert np.isclose(drawn, 1 - 1e-6, atol=1e-9).any()
    gaps = np.diff(drawn)
    assert gaps.max() <= 2.0 / 200.0 + 1e-9
    assert drawn.size < 330


@pytest.mark.parametrize(
    ("seconds", "asked", "drawn"), [(3.0, None, 200.0), (600.0, None, 10.0), (600.0, 500.0, 500.0)]
)
def test_long_motions_are_drawn_less_densely_unless_asked_for(seconds, asked, drawn):
    still = np.zeros((2, 1))
    motions = [Motion(np.array([0.0, seconds]), *[still] * 4)] * 2
    rate, note = drawn_rate(asked, motions)
    assert rate == drawn
    assert bool(note) == (rate < 200.0)
