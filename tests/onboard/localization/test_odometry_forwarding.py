"""What PX4 is told of the mocap: only what is believed, at 33 Hz, with a new count after every
break.
"""

from __future__ import annotations

import itertools
import math

from msgspec.structs import replace

from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import MocapPose
from onboard.localization.odometry_forwarding import OdometryForwarder

_MS = 1_000_000


def _pose(at_ms: float, x_m: float = 0.0) -> MocapPose:
    return MocapPose(
        body="a",
        boot_id=1,
        sequence=1,
        stamp_ns=int(at_ms * _MS),
        is_tracked=True,
        position_enu_m=(x_m, 0.0, 1.0),
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
    )


_GROUND = Snapshot()


def _sent(
    feed: OdometryForwarder, times_ms: list[float], x_of=lambda _: 0.0, snapshot: Snapshot = _GROUND
) -> list[int]:
    """Reset counts of what was sent."""
    found = []
    for at_ms in times_ms:
        # the tick at which the shell hands it over
        now_ns = int((math.ceil(at_ms / 20.0) * 20.0 + 10.0) * _MS)
        heard = replace(
            snapshot, local_position_ns=now_ns - 5 * _MS if snapshot.local_position_ns else 0
        )
        found += [each.reset_count for each in feed.take(_pose(at_ms, x_of(at_ms)), heard, now_ns)]
    return found


def _in_the_air(x_m: float, *, knows_position: bool = True) -> Snapshot:
    """PX4 flies and thinks that it is at x_m."""
    return Snapshot(
        is_armed=True,
        landed=Landed.IN_AIR,
        position_local_ned_m=(0.0, x_m, -1.0),
        local_position_ns=int(knows_position),
    )


def test_a_mocap_at_any_rate_reaches_px4_thirty_times_a_second() -> None:
    for rate_hz in (30, 50, 60, 100, 240):
        sent = _sent(OdometryForwarder(), [1000.0 * n / rate_hz for n in range(4 * rate_hz)])
        assert 29 <= len(sent) / 4.0 <= 34
        assert set(sent) == {0}


def test_poses_that_come_back_after_a_break_begin_anew_once() -> None:
    feed = OdometryForwarder()
    assert set(_sent(feed, [20.0 * n for n in range(50)])) == {0}
    assert set(_sent(feed, [2000 + 20.0 * n for n in range(50)])) == {1}
    assert set(_sent(feed, [5000 + 20.0 * n for n in range(50)])) == {2}


def test_short_breaks_and_quick_flight_do_not_begin_anew() -> None:
    times = [20.0 * n for n in range(200) if n % 50 not in range(10)]
    assert set(_sent(OdometryForwarder(), times, lambda at_ms: 3.0 * at_ms * 1e-3)) == {0}


def test_a_body_that_is_believed_at_another_place_begins_anew_there() -> None:
    assert _sent(
        OdometryForwarder(), [0, 40, 80, 120], lambda at_ms: 1.5 if at_ms > 60 else 0.0
    ) == [0, 0, 1, 1]


def test_in_the_air_px4_begins_anew_only_near_where_it_thinks_that_it_is() -> None:
    before = [40.0 * n for n in range(5)]
    for seconds, drift_m, is_near in (
        (1.0, 0.4, True),
        (1.0, 0.9, False),
        (5.0, 0.65, True),
        (60.0, 0.8, False),
    ):
        feed = OdometryForwarder()
        after = [1000.0 * seconds + 40.0 * n for n in range(5)]
        _sent(feed, before, snapshot=_in_the_air(0.0))
        assert _sent(feed, after, lambda _: 0.0, _in_the_air(drift_m)) == (
            [1] * 5 if is_near else []
        )


def test_an_agent_that_starts_in_the_air_sends_no_first_pose_of_another_body() -> None:
    times = [1000.0 + 40.0 * n for n in range(3)]
    for drift_m, sent in ((0.9, [0, 0, 0]), (1.8, [])):
        assert _sent(OdometryForwarder(), times, snapshot=_in_the_air(drift_m)) == sent, drift_m
    lost = _in_the_air(1.8, knows_position=False)
    assert _sent(OdometryForwarder(), times, snapshot=lost) == [0, 0, 0]


def test_in_the_air_a_px4_without_a_position_gets_no_pose_after_a_gap() -> None:
    feed = OdometryForwarder()
    _sent(feed, [0.0, 20.0])
    assert _sent(feed, [900.0, 920.0], snapshot=_in_the_air(0.0, knows_position=False)) == []


def test_back_on_the_ground_it_begins_anew_wherever_the_body_is() -> None:
    feed = OdometryForwarder()
    _sent(feed, [0.0, 20.0])
    assert _sent(feed, [900.0], lambda _: 3.0, _in_the_air(0.0)) == []
    assert _sent(feed, [1900.0], lambda _: 3.0) == [1]


def test_a_mocap_whose_clock_went_back_begins_anew() -> None:
    feed = OdometryForwarder()
    feed.take(_pose(9000), _GROUND, 9020 * _MS)
    (sent,) = feed.take(_pose(100), _GROUND, 9050 * _MS)
    assert sent.reset_count == 1


def test_the_count_fits_the_eight_bits_of_the_message() -> None:
    feed = OdometryForwarder()
    counts = _sent(feed, [1000.0 * n for n in range(600)])
    assert max(counts) == 255
    assert all(0 <= count <= 255 for count in counts)
    assert all(first != second for first, second in itertools.pairwise(counts))


def test_nothing_that_was_not_given_is_sent() -> None:
    feed = OdometryForwarder()
    (sent,) = feed.take(_pose(0, 0.25), _GROUND, 0)
    assert sent.position_enu_m == (0.25, 0.0, 1.0)
    assert sent.quaternion_enu_flu_wxyz == (1.0, 0.0, 0.0, 0.0)
    assert 0.0 < sent.std_m < 0.1
    assert math.isfinite(sent.std_m)
