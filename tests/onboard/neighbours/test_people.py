"""Persons in the motion capture become neighbours that avoid nobody."""

from __future__ import annotations

import math

import msgspec
import pytest

from onboard.bus.schema import MocapPose
from onboard.config.fleet import Person, load_fleet
from onboard.neighbours.people import GONE_S, UNSEEN_S, People
from onboard.neighbours.table import NeighbourTable

PAPER = load_fleet("configs/fleets/paper.toml")
FLEET = msgspec.structs.replace(
    PAPER, people={"anna": Person(mocap_body="cap1"), "ben": Person(radius_m=0.7)}
)
S = 1_000_000_000
FRAME_NS = S // 50


def people() -> People:
    return People(FLEET, first_index=2)


def pose(body: str, stamp_ns: int, x_m: float, *, is_tracked: bool = True) -> MocapPose:
    return MocapPose(
        body=body,
        boot_id=1,
        sequence=1,
        stamp_ns=stamp_ns,
        is_tracked=is_tracked,
        position_enu_m=(x_m, 1.0 + 1e-9 * stamp_ns, 1.7),
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
    )


def nobody(now_ns: int):
    return NeighbourTable(PAPER, "mav0").snapshot(now_ns)


def test_who_was_never_seen_is_no_neighbour():
    assert not list(people().added_to(nobody(S), S))
    assert people().unseen(S) == ()


def test_a_person_is_a_neighbour_with_a_circle_as_high_as_the_fence():
    seen = people()
    assert seen.hear_pose(pose("cap1", S, 2.0), S)
    assert seen.hear_pose(pose("ben", S, 3.0), S)

    anna, ben = seen.added_to(nobody(S), S + FRAME_NS)
    assert (anna.radius_m, ben.radius_m) == (0.4, 0.7)
    assert (anna.table_index, ben.table_index) == (2, 3)
    assert not anna.is_cooperative
    assert anna.age_s == pytest.approx(0.02)
    assert anna.position_enu_m.x == 2.0
    assert anna.position_enu_m.z == FLEET.fleet.geofence_m.z[1]
    assert anna.velocity_enu_m_s.z == 0.0


def test_poses_of_others_and_lost_markers_change_nothing():
    seen = people()
    assert not seen.hear_pose(pose("mav1", S, 2.0), S)
    assert not seen.hear_pose(pose("cap1", S, 2.0, is_tracked=False), S)
    assert not list(seen.added_to(nobody(S), S))


def test_the_distance_is_that_to_the_circle_of_where_the_person_is_now():
    seen = people()
    for frame in range(100):  # she walks east at 1 m/s
        stamp_ns = S + frame * FRAME_NS
        seen.hear_pose(pose("cap1", stamp_ns, 0.02 * frame), stamp_ns)
    now_ns = S + 99 * FRAME_NS + S // 10
    [(name, distance_m)] = seen.distances_m((5.0, 3.98, 0.5), now_ns).items()
    assert name == "anna"
    # last seen at (1.98, 3.98), and since then 0.1 m farther along both axes
    assert distance_m == pytest.approx(math.hypot(5.0 - 2.08, 0.1) - 0.4, abs=0.03)


def test_a_person_is_unseen_after_a_gap_and_gone_after_a_long_one():
    seen = people()
    seen.hear_pose(pose("ben", S, 2.0), S)
    soon_ns = S + round((UNSEEN_S - 0.01) * S)
    late_ns = S + round((UNSEEN_S + 0.01) * S)
    gone_ns = S + round((GONE_S + 0.01) * S)
    assert seen.unseen(soon_ns) == ()
    assert seen.unseen(late_ns) == ("ben",)
    assert len(seen.added_to(nobody(late_ns), late_ns)) == 1
    assert seen.unseen(gone_ns) == ()
    assert not list(seen.added_to(nobody(gone_ns), gone_ns))
    assert seen.distances_m((0.0, 0.0, 0.0), gone_ns) == {}
