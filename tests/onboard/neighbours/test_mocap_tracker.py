"""A body's motion from its poses alone."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.bus.schema import MocapPose
from onboard.neighbours.mocap_tracker import BodyTracker

TICK_NS = 20_000_000


def pose_at(stamp_ns: int, east_m: float) -> MocapPose:
    return MocapPose(
        body="stranger",
        boot_id=1,
        sequence=stamp_ns // TICK_NS,
        stamp_ns=stamp_ns,
        is_tracked=True,
        position_enu_m=(east_m, 0.0, 1.0),
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
    )


@pytest.mark.parametrize("speed_m_s", [0.0, 1.5, 3.0])
def test_the_velocity_of_a_body_that_appears_is_known_after_two_samples(speed_m_s: float) -> None:
    """The noise of two samples, 3 mm each, makes 0.2 m/s; the filter then averages it out."""
    rng = np.random.default_rng(1)
    tracker = BodyTracker()
    errors_m_s = []
    for tick in range(1, 40):
        east_m = 0.02 * tick * speed_m_s + float(rng.normal(0.0, 0.003))
        assert tracker.hear(pose_at(tick * TICK_NS, east_m), tick * TICK_NS)
        errors_m_s.append(abs(tracker.velocity_enu_m_s[0] - speed_m_s))
    assert max(errors_m_s[1:]) < 0.5
    assert max(errors_m_s[20:]) < 0.25


def test_a_body_whose_velocity_is_known_begins_with_it() -> None:
    tracker = BodyTracker(velocity_enu_m_s=(3.0, 0.0, 0.0), has_velocity=True)
    for tick in range(1, 10):
        tracker.hear(pose_at(tick * TICK_NS, 0.06 * tick), tick * TICK_NS)
        assert tracker.velocity_enu_m_s[0] == pytest.approx(3.0, abs=1e-9)
