"""Poses of sources that restart, are doubled or replayed: only newer poses count, whatever their
source.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from onboard.autopilot import Snapshot
from onboard.bus.schema import MocapPose
from onboard.localization.own_state import OwnState
from tests.onboard.agent.rig import fleet

_MS = 1_000_000


def _pose(at_ms: int, boot_id: int, sequence: int) -> MocapPose:
    return MocapPose(
        body="mav0",
        boot_id=boot_id,
        sequence=sequence,
        stamp_ns=at_ms * _MS,
        is_tracked=True,
        position_enu_m=(1e-4 * at_ms, 0.0, 1.0),
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
    )


def _taken(own: OwnState, pose: MocapPose, at_ms: int | None = None) -> bool:
    return own.add_pose(pose, pose.stamp_ns + 10 * _MS if at_ms is None else at_ms * _MS)


def test_a_source_that_restarts_is_believed_at_once_and_its_earlier_poses_no_more() -> None:
    own = OwnState(fleet().vehicles["mav0"])
    assert all(_taken(own, _pose(1000 + 20 * n, 1, n)) for n in range(10))
    assert all(_taken(own, _pose(1200 + 20 * n, 2, n)) for n in range(10))
    replayed = [_pose(1000 + 20 * n, 1, n) for n in range(10)]
    assert not any(_taken(own, pose, 1500) for pose in replayed)
    assert own.counts.late == 10
    assert _taken(own, _pose(1400, 2, 10))


def test_the_same_pose_by_two_relays_counts_once() -> None:
    own = OwnState(fleet().vehicles["mav0"])
    for n in range(10):
        pose = _pose(1000 + 20 * n, 1, n)
        assert _taken(own, pose)
        assert not _taken(own, msgspec.structs.replace(pose, boot_id=2))


@pytest.mark.parametrize("jump_rad", [0.0, 1.2])
def test_a_jump_of_px4s_heading_does_not_turn_the_vehicle(jump_rad: float) -> None:
    """PX4 corrects its heading; the mocap's stays, and is believed."""
    own = OwnState(fleet().vehicles["mav0"])
    for n in range(100):
        at_ms = 1000 + 20 * n
        yaw_rad = 0.3 + jump_rad * (n > 50)
        snapshot = Snapshot(
            attitude_ns=at_ms * _MS,
            quaternion_enu_flu_wxyz=(math.cos(0.5 * yaw_rad), 0.0, 0.0, math.sin(0.5 * yaw_rad)),
        )
        assert _taken(own, _pose(at_ms, 1, n))
        own.update((at_ms + 10) * _MS, 0.02, snapshot, 0.0, 0.5, is_on_ground=False)
        assert own.heading_offset_rad == pytest.approx(-yaw_rad, abs=0.05)


def test_a_vehicle_that_is_turned_over_by_hand_is_believed_all_the_way() -> None:
    """Turned over by pitch and back by roll: near the vertical, its heading turns round."""
    own = OwnState(fleet().vehicles["mav0"])
    angles_rad = np.linspace(0.0, math.pi, 100).tolist()
    half_turns = [(math.cos(0.5 * angle), 0.0, math.sin(0.5 * angle), 0.0) for angle in angles_rad]
    # upside down, then about its nose
    half_turns += [(0.0, math.sin(0.5 * angle), math.cos(0.5 * angle), 0.0) for angle in angles_rad]
    for n, attitude_wxyz in enumerate(half_turns):
        at_ms = 1000 + 20 * n
        pose = msgspec.structs.replace(_pose(at_ms, 1, n), quaternion_enu_flu_wxyz=attitude_wxyz)
        assert _taken(own, pose), n
        snapshot = Snapshot(attitude_ns=at_ms * _MS, quaternion_enu_flu_wxyz=attitude_wxyz)
        own.update((at_ms + 10) * _MS, 0.02, snapshot, 0.0, 0.5, is_on_ground=True)


def test_an_attitude_of_a_px4_that_is_off_says_nothing_about_a_body() -> None:
    own = OwnState(fleet().vehicles["mav0"])
    level = Snapshot(attitude_ns=1000 * _MS)
    for n in range(100):
        assert _taken(own, _pose(1000 + 20 * n, 1, n))
        own.update((1010 + 20 * n) * _MS, 0.02, level, 0.0, 0.5, is_on_ground=True)
    turned = (math.cos(0.4), 0.0, 0.0, math.sin(0.4))  # while its markers were covered
    later = [
        msgspec.structs.replace(_pose(4000 + 20 * n, 1, 200 + n), quaternion_enu_flu_wxyz=turned)
        for n in range(3)
    ]
    assert [_taken(own, pose) for pose in later] == [False, True, True]
