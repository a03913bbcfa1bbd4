"""Three states of a neighbour that we rely on less, each with an effect of its own on avoidance."""

from __future__ import annotations

import pytest

from onboard.bus.schema import MocapPose, StateMessage
from onboard.neighbours.mocap_tracker import BodyTracker
from onboard.neighbours.table import NeighbourTable
from onboard.tuples import Xyz
from tests.onboard.agent.rig import fleet
from tests.onboard.state_messages import state_message

S = 1_000_000_000
TICK_NS = S // 50
OWN_ENU_M = (0.0, 0.0, 1.0)
SAID_ENU_M = (4.0, 0.0, 1.0)
SEEN_ENU_M = (2.0, 0.0, 1.0)  # by the mocap: nearer to us
STILL_M_S = (0.0, 0.0, 0.0)


def _table() -> NeighbourTable:
    return NeighbourTable(fleet(("mav0", "mav1", "mav2")), "mav0")


def _says(sequence: int, now_ns: int) -> StateMessage:
    return state_message(
        sequence=sequence,
        stamp_ns=now_ns,
        position_enu_m=SAID_ENU_M,
        velocity_enu_m_s=STILL_M_S,
        commanded_acceleration_enu_m_s2=(1.0, 0.0, 0.0),
    )


def _pose(sequence: int, now_ns: int, position_enu_m: Xyz) -> MocapPose:
    x, y, z = position_enu_m
    return MocapPose(
        body="mav1",
        boot_id=1,
        sequence=sequence,
        stamp_ns=now_ns,
        is_tracked=True,
        position_enu_m=(x + 1e-4 * sequence, y, z),  # a tracked body always has noise
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
    )


def _hear_for_half_a_second(table: NeighbourTable, seen_enu_m: Xyz) -> tuple[int, set[str]]:
    """Let mav1 say one position and the mocap see another; return the time, and whom we watch."""
    watched_bodies: set[str] = set()
    now_ns = 10 * S
    for sequence in range(1, 26):
        now_ns += TICK_NS
        table.hear(_says(sequence, now_ns), now_ns)
        table.hear(state_message(vehicle="mav2", sequence=sequence, stamp_ns=now_ns), now_ns)
        if "mav1" in watched_bodies:
            table.hear_pose(_pose(sequence, now_ns, seen_enu_m), now_ns)

        table.reposition_contradicted(OWN_ENU_M, now_ns)
        bodies = table.bodies_to_watch(now_ns, 0.02)
        if bodies is not None:
            watched_bodies = set(bodies)

    return now_ns, watched_bodies


def test_a_neighbour_in_none_of_the_states_cooperates_where_it_says_and_is_not_watched() -> None:
    table = _table()
    now_ns, watched_bodies = _hear_for_half_a_second(table, SEEN_ENU_M)
    neighbour = table.snapshot(now_ns)[0]

    assert watched_bodies == set()
    assert neighbour.position_enu_m == SAID_ENU_M
    assert neighbour.is_cooperative
    assert table.rows(now_ns)[0].is_cooperative


def test_a_neighbour_that_is_not_cooperating_counts_where_it_says_but_we_go_aside_alone() -> None:
    table = _table()
    table.judged.set_not_cooperating(table.indices["mav1"], True)
    now_ns, watched_bodies = _hear_for_half_a_second(table, SEEN_ENU_M)
    neighbour = table.snapshot(now_ns)[0]

    assert not neighbour.is_cooperative
    assert neighbour.position_enu_m == SAID_ENU_M
    assert neighbour.commanded_acceleration_enu_m_s2 == (1.0, 0.0, 0.0), "its word still counts"
    assert watched_bodies == set()
    assert table.rows(now_ns)[0].is_cooperative, "what it announces itself is known all the same"


def test_a_neighbour_cooperates_again_with_its_next_message_once_it_may() -> None:
    table = _table()
    table.judged.set_not_cooperating(table.indices["mav1"], True)
    now_ns, _ = _hear_for_half_a_second(table, SEEN_ENU_M)

    table.judged.set_not_cooperating(table.indices["mav1"], False)
    assert not table.snapshot(now_ns)[0].is_cooperative
    table.hear(_says(99, now_ns + TICK_NS), now_ns + TICK_NS)
    assert table.snapshot(now_ns + TICK_NS)[0].is_cooperative


def test_a_watched_neighbour_cooperates_where_it_says_while_its_body_is_watched() -> None:
    table = _table()
    table.judged.set_watched(table.indices["mav1"], True)
    now_ns, watched_bodies = _hear_for_half_a_second(table, SEEN_ENU_M)
    neighbour = table.snapshot(now_ns)[0]

    assert watched_bodies == {"mav1"}
    assert neighbour.position_enu_m == SAID_ENU_M
    assert neighbour.is_cooperative


@pytest.mark.parametrize(("seen_enu_m", "counts_at_m"), [(SEEN_ENU_M, 2.0), ((7.0, 0.0, 1.0), 4.0)])
def test_a_contradicted_neighbour_counts_at_the_nearer_position_and_promises_nothing(
    seen_enu_m: Xyz, counts_at_m: float
) -> None:
    table = _table()
    table.judged.set_watched(table.indices["mav1"], True)
    table.judged.set_contradicted(table.indices["mav1"], True)
    now_ns, _ = _hear_for_half_a_second(table, seen_enu_m)
    neighbour = table.snapshot(now_ns)[0]

    assert neighbour.position_enu_m.x == pytest.approx(counts_at_m, abs=0.02)
    assert not neighbour.is_cooperative


def test_a_contradicted_neighbour_is_avoided_at_its_farther_position_as_well() -> None:
    table = _table()
    index = table.indices["mav1"]
    table.judged.set_watched(index, True)
    table.judged.set_contradicted(index, True)
    now_ns, _ = _hear_for_half_a_second(table, SEEN_ENU_M)

    nearer, mav2, farther = table.snapshot(now_ns)
    assert nearer.position_enu_m.x == pytest.approx(SEEN_ENU_M[0], abs=0.02)
    assert farther.position_enu_m == SAID_ENU_M
    assert farther.table_index == nearer.table_index == index
    assert mav2.table_index != index
    assert not farther.is_cooperative
    assert farther.age_s == pytest.approx(0.02, abs=0.021)

    table.judged.set_contradicted(index, False)
    assert len(table.snapshot(now_ns)) == 2


def test_the_nearer_position_is_the_one_that_is_nearer_now() -> None:
    """The pose is 0.2 s old, and 0.2 m farther than the message, but it comes with 3 m/s."""
    table = _table()
    index = table.indices["mav1"]
    tracker = BodyTracker(
        stamp_ns=10 * S, position_enu_m=(4.2, 0.0, 1.0), velocity_enu_m_s=(-3.0, 0.0, 0.0)
    )
    now_ns = 10 * S + 10 * TICK_NS
    table.hear(_says(1, now_ns), now_ns)
    table.judged.set_contradicted(index, True)
    table.judged.write_positions(table.arrays, {index: tracker}, OWN_ENU_M, now_ns, overdue_s=0.08)
    assert table.snapshot(now_ns)[0].position_enu_m.x == pytest.approx(4.2)


def test_a_contradicted_neighbour_that_falls_silent_counts_where_the_mocap_sees_it() -> None:
    table = _table()
    table.judged.set_watched(table.indices["mav1"], True)
    table.judged.set_contradicted(table.indices["mav1"], True)
    farther_m = 7.0
    now_ns, _ = _hear_for_half_a_second(table, (farther_m, 0.0, 1.0))

    for sequence in range(26, 36):
        now_ns += TICK_NS
        table.hear_pose(_pose(sequence, now_ns, (farther_m, 0.0, 1.0)), now_ns)
        table.reposition_contradicted(OWN_ENU_M, now_ns)
    assert table.snapshot(now_ns)[0].position_enu_m.x == pytest.approx(farther_m, abs=0.02)


def test_a_contradicted_neighbour_counts_as_airborne_also_when_it_says_that_it_stands() -> None:
    table = _table()
    standing = state_message(
        stamp_ns=10 * S, position_enu_m=SAID_ENU_M, is_airborne=False, is_cooperative=False
    )
    table.hear(standing, 10 * S)
    assert table.silent(13 * S) == ()

    table.judged.set_contradicted(table.indices["mav1"], True)
    table.reposition_contradicted(OWN_ENU_M, 10 * S)
    assert table.silent(13 * S) == ("mav1",), "only who is in the air is missed"


def test_a_neighbour_that_is_contradicted_no_more_counts_where_it_says_again() -> None:
    table = _table()
    index = table.indices["mav1"]
    table.judged.set_watched(index, True)
    table.judged.set_contradicted(index, True)
    now_ns, _ = _hear_for_half_a_second(table, SEEN_ENU_M)

    table.judged.set_contradicted(index, False)
    table.hear(_says(99, now_ns + TICK_NS), now_ns + TICK_NS)
    table.reposition_contradicted(OWN_ENU_M, now_ns + TICK_NS)
    neighbour = table.snapshot(now_ns + TICK_NS)[0]
    assert neighbour.position_enu_m == SAID_ENU_M
    assert neighbour.is_cooperative
