"""What an agent knows of the others."""

from __future__ import annotations

import math
from typing import Any

import pytest
from msgspec.structs import replace

from onboard.bus.schema import MocapPose, StateMessage
from onboard.neighbours.table import SILENT_S, NeighbourTable
from onboard.safety.limits import LARGEST_POSITION_STD_M, LARGEST_VELOCITY_STD_M_S
from onboard.tuples import Xyz
from tests.groundstation.console.fake import telemetry
from tests.onboard.agent.rig import fleet
from tests.onboard.state_messages import state_message

S = 1_000_000_000


def _state(**changes: object) -> StateMessage:
    moving = {
        "sequence": 10, "stamp_ns": 5 * S, "position_enu_m": (2.0, 0.0, 1.0),
        "velocity_enu_m_s": (1.0, 0.0, 0.0),
    }  # fmt: skip
    return state_message(**{**moving, **changes})


def _table() -> NeighbourTable:
    return NeighbourTable(fleet(("mav0", "mav1", "mav2")), "mav0")


def test_a_neighbour_never_heard_is_not_present() -> None:
    assert not _table().snapshot(5 * S)


def test_a_state_ages_until_the_next_one_comes() -> None:
    table = _table()
    table.hear(_state(), 5 * S)
    (first,) = table.snapshot(5 * S)
    (later,) = table.snapshot(5 * S + 20_000_000)
    assert later.age_s == pytest.approx(0.02)
    assert later == first._replace(age_s=later.age_s)

    moved = _state(sequence=11, stamp_ns=6 * S, position_enu_m=(3.0, 0.5, 1.2))
    table.hear(moved, 6 * S)
    (newer,) = table.snapshot(6 * S)
    assert newer.position_enu_m == (3.0, 0.5, 1.2)
    assert newer.velocity_enu_m_s == moved.velocity_enu_m_s


def test_a_place_is_that_of_the_newest_valid_state_however_old() -> None:
    table = _table()
    assert table.last_positions_enu_m() == {}

    table.hear(_state(position_enu_m=(3.0, 0.5, 0.1)), 5 * S)
    lost = _state(position_enu_m=(0.0, 0.0, 0.0), is_valid=False, stamp_ns=6 * S, sequence=11)
    table.hear(lost, 6 * S)
    assert table.last_positions_enu_m() == {"mav1": (3.0, 0.5, 0.1)}


def _replaced_at(table: NeighbourTable, own_place: str, now_s: int) -> list[str]:
    table.forget_replaced(own_place, now_s * S)
    return [table.names[one.table_index] for one in table.snapshot(now_s * S)]


@pytest.mark.parametrize("by", ["mav0", "mav2"])
def test_a_vehicle_that_another_one_replaces_is_avoided_only_where_it_says_it_is(by: str) -> None:
    table = _table()
    standing = {"is_airborne": False, "position_enu_m": (2.0, 0.0, 0.0)}
    table.hear(_state(**standing), 5 * S)
    table.hear(telemetry("mav1"), 5 * S)
    assert _replaced_at(table, "mav0", 5) == ["mav1"]

    own_place = "mav1" if by == "mav0" else "mav0"
    if by == "mav2":
        table.hear(telemetry("mav2", stands_in_for="mav1"), 5 * S)
    assert _replaced_at(table, own_place, 5) == ["mav1"], "it says where it stands"

    table.hear(_state(**standing, is_valid=False, stamp_ns=6 * S, sequence=11), 6 * S)
    assert _replaced_at(table, own_place, 6) == []
    assert "mav1" not in table.telemetries(), "it does not stand in the way of a take-off either"

    table.hear(_state(**standing, stamp_ns=7 * S, sequence=12), 7 * S)
    assert _replaced_at(table, own_place, 7) == ["mav1"]
    assert _replaced_at(table, own_place, 7 + 60) == [], "it is silent"


def _hear_claim(table: NeighbourTable, name: str, at_s: int, **values: object) -> None:
    table.hear(telemetry(name, stamp_ns=at_s * S, **values), at_s * S)


def test_a_spare_that_our_own_vehicle_has_replaced_counts_as_replaced() -> None:
    """mav1 stands in for mav2 and dies; then our own mav0 has the slot."""
    table = _table()
    _hear_claim(table, "mav2", 4)
    assert table.replaced("mav0", 4 * S) == frozenset()
    _hear_claim(table, "mav1", 5, stands_in_for="mav2")
    assert table.replaced("mav0", 5 * S) == {"mav2"}
    assert table.replaced("mav2", 9 * S) == {"mav1", "mav2"}


def test_a_spare_that_another_spare_has_replaced_counts_as_replaced() -> None:
    """mav1 stands in for our own mav2 and dies; then mav0 has the slot."""
    table = NeighbourTable(fleet(("mav0", "mav1", "mav2")), "mav2")
    _hear_claim(table, "mav0", 4, disabled_by="ada")
    _hear_claim(table, "mav1", 5, stands_in_for="mav2")
    _hear_claim(table, "mav0", 9, stands_in_for="mav2")
    assert table.replaced("mav2", 9 * S) == {"mav1"}


@pytest.mark.parametrize("is_disabled", [False, True])
@pytest.mark.parametrize("is_airborne", [False, True])
def test_a_vehicle_has_its_slot_again_only_when_its_spare_is_gone(
    is_disabled: bool, is_airborne: bool
) -> None:
    """The agent of mav2 restarts while its spare lives, and forgets that it was disabled."""
    table = _table()
    _hear_claim(table, "mav2", 4)
    if is_disabled:
        _hear_claim(table, "mav2", 5, disabled_by="ada")
    for second in (6, 9, 10):
        _hear_claim(table, "mav1", second, stands_in_for="mav2", is_airborne=is_airborne)
        _hear_claim(table, "mav2", second)
    assert table.replaced("mav0", 10 * S) == {"mav2"}
    gone = "mav2" if is_airborne else "mav1"
    assert table.replaced("mav0", 15 * S) == {gone}


def test_a_vehicle_that_fell_silent_in_the_air_stays_known_although_it_is_replaced() -> None:
    table = _table()
    table.hear(_state(is_airborne=True), 5 * S)
    assert _replaced_at(table, "mav1", 60) == ["mav1"]


def test_no_accuracy_is_believed_that_no_vehicle_would_publish() -> None:
    table = _table()
    table.hear(_state(position_std_m=2.0, velocity_std_m_s=50.0), 5 * S)
    (neighbour,) = table.snapshot(5 * S)
    assert (neighbour.position_std_m, neighbour.velocity_std_m_s) == (
        LARGEST_POSITION_STD_M,
        LARGEST_VELOCITY_STD_M_S,
    )


def test_the_ring_successor_is_the_next_of_the_fleet_file() -> None:
    for own, successor in (("mav0", "mav1"), ("mav1", "mav2"), ("mav2", "mav0")):
        table = NeighbourTable(fleet(("mav0", "mav1", "mav2")), own)
        for place, name in enumerate(table.names):
            table.hear(_state(vehicle=name, sequence=place), 5 * S)
        obstacles = [one.table_index for one in table.snapshot(5 * S) if one.is_paper_obstacle]
        assert [table.names[index] for index in obstacles] == [successor]


def test_a_silent_neighbour_stays_present_but_does_not_cooperate() -> None:
    table = _table()
    table.hear(_state(), 5 * S)
    assert table.snapshot(5 * S + 100_000_000)[0].is_cooperative
    late = table.snapshot(5 * S + 310_000_000)
    assert [one.is_cooperative for one in late] == [False]
    assert table.silent(5 * S + 310_000_000) == ("mav1",)
    assert table.distances_m((0.0, 0.0, 1.0), 9 * S)["mav1"] == pytest.approx(2.0 + SILENT_S)


def test_a_neighbour_without_a_position_is_avoided_where_it_was() -> None:
    table = _table()
    table.hear(_state(), 5 * S)
    table.hear(
        _state(sequence=11, stamp_ns=6 * S, is_valid=False, position_enu_m=(0.0, 0.0, 0.0)), 6 * S
    )
    (neighbour,) = table.snapshot(6 * S)
    assert neighbour.position_enu_m == (2.0, 0.0, 1.0)
    assert not neighbour.is_cooperative


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"sequence": 2**60},
        {"stamp_ns": 4 * S, "sequence": 11},
        {"sequence": 11, "position_enu_m": (math.nan, 0.0, 0.0)},
        {"sequence": 11, "commanded_acceleration_enu_m_s2": (0.0, math.inf, 0.0)},
        {"sequence": 11, "crowd_count": math.nan},
    ],
)
def test_replayed_and_non_finite_messages_change_nothing_and_are_counted(
    changes: dict[str, object],
) -> None:
    table = _table()
    table.hear(_state(), 5 * S)
    assert not table.hear(_state(**{"position_enu_m": (9.0, 9.0, 9.0), **changes}), 5 * S)
    assert [one.position_enu_m for one in table.snapshot(5 * S)] == [(2.0, 0.0, 1.0)]
    assert table.counts.malformed + table.counts.late == 1


def test_a_restarted_neighbour_is_heard_again_although_its_count_begins_anew() -> None:
    table = _table()
    table.hear(_state(), 5 * S)
    assert table.hear(
        _state(boot_id=2, sequence=1, stamp_ns=6 * S, position_enu_m=(3.0, 0.0, 0.0)), 6 * S
    )


@pytest.mark.parametrize(
    "lie", [{"sequence": 2**60}, {"boot_id": 2**60}, {"stamp_ns": 2**61}, {"is_valid": False}]
)
def test_a_neighbour_is_heard_again_right_after_one_false_message_in_its_name(
    lie: dict[str, Any],
) -> None:
    table = _table()
    table.hear(_state(), 5 * S)
    table.hear(_state(**{"stamp_ns": 5 * S + 1, "sequence": 11, **lie}), 5 * S + 1)
    assert table.hear(
        _state(stamp_ns=5 * S + 2, sequence=11, position_enu_m=(2.1, 0.0, 1.0)), 5 * S + 2
    )


def test_a_message_from_before_a_restart_changes_nothing() -> None:
    table = _table()
    table.hear(_state(boot_id=1, stamp_ns=4 * S), 4 * S)
    table.hear(_state(boot_id=2, sequence=1, stamp_ns=5 * S), 5 * S)
    assert not table.hear(_state(boot_id=1, sequence=99, stamp_ns=4 * S), 6 * S)  # replayed
    assert table.age_s("mav1", 6 * S) == pytest.approx(1.0)


def test_a_stamp_of_the_future_counts_from_its_arrival() -> None:
    for stamp_ns in (10**17, 7 * S):
        table = _table()
        table.hear(_state(stamp_ns=stamp_ns), 5 * S)
        assert table.age_s("mav1", 5 * S + 100_000_000) == pytest.approx(0.10), stamp_ns


def test_a_message_that_was_held_up_is_as_old_as_it_is() -> None:
    table = _table()
    table.hear(_state(stamp_ns=3 * S), 5 * S)
    assert table.age_s("mav1", 5 * S) == pytest.approx(2.0)


def test_a_vehicle_that_the_fleet_file_lacks_is_ignored() -> None:
    assert not _table().hear(_state(vehicle="unknown"), 5 * S)


def test_who_is_seen_only_is_silent_also_while_poses_are_late() -> None:
    table = _table()
    for name in ("mav1", "mav2"):
        table.hear(_state(vehicle=name), 5 * S)
    table.bodies_to_watch(2 * S, 0.02)
    table.bodies_to_watch(6 * S, 0.02)
    for tick in range(5):
        pose = MocapPose(
            body="mav1", boot_id=1, sequence=tick, stamp_ns=6 * S + tick * S // 50, is_tracked=True,
            position_enu_m=(2.0 + 0.001 * tick, 0.0, 1.0), quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0,
            0.0),
        )  # fmt: skip
        assert table.hear_pose(pose, 6 * S + tick * S // 50)
    # the own pose is late: no others are received
    assert table.bodies_to_watch(6 * S + 100_000_000, 0.2) == ()
    assert table.silent(6 * S + 100_000_000) == ("mav1", "mav2")
    assert table.heard_ages_s(6 * S + 100_000_000).tolist() == pytest.approx([1.1, 1.1])


@pytest.mark.parametrize(
    ("start_m", "height_m", "is_silent"),
    [
        (0.0, 0.2, True),
        (0.0, 0.1, False),  # it may have landed
        (1.0, 1.2, True),
        (1.0, 0.9, False),  # it may stand on the table from which it started
        (1.0, 0.6, True),  # it flies lower than that
        (1.0, 0.1, False),
    ],
)
def test_who_falls_silent_flies_where_neither_its_start_nor_the_ground_carries_it(
    start_m: float, height_m: float, is_silent: bool
) -> None:
    config = fleet(("mav0", "mav1"))
    mav1 = replace(config.vehicles["mav1"], start_enu_m=(1.5, 0.0, start_m))
    table = NeighbourTable(replace(config, vehicles={**config.vehicles, "mav1": mav1}), "mav0")
    table.hear(_state(position_enu_m=(2.0, 0.0, height_m)), 5 * S)
    table.bodies_to_watch(2 * S, 0.02)
    table.bodies_to_watch(6 * S, 0.02)
    pose = MocapPose(
        body="mav1", boot_id=1, sequence=1, stamp_ns=6 * S, is_tracked=True,
        position_enu_m=(2.0, 0.0, height_m), quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
    )  # fmt: skip
    assert table.hear_pose(pose, 6 * S)
    assert table.silent(6 * S) == (("mav1",) if is_silent else ())


@pytest.mark.parametrize(
    ("position_enu_m", "velocity_m_s", "is_silent"),
    [
        ((1.5, 0.0, 1.05), 0.0, False),  # on its table
        ((0.0, 0.5, 1.05), 0.0, False),  # on that of another vehicle
        ((4.0, 0.0, 1.05), 0.0, True),  # in the room, as high as the tables
        ((1.5, 0.0, 1.05), 1.0, True),  # across its table
    ],
)
def test_who_falls_silent_as_high_as_the_tables_stands_only_on_one_of_them(
    position_enu_m: Xyz, velocity_m_s: float, is_silent: bool
) -> None:
    config = fleet(("mav0", "mav1"))
    vehicles = {
        name: replace(vehicle, start_enu_m=(*vehicle.start_enu_m[:2], 1.0))
        for name, vehicle in config.vehicles.items()
    }
    table = NeighbourTable(replace(config, vehicles=vehicles), "mav0")
    table.hear(_state(position_enu_m=position_enu_m), 5 * S)
    table.bodies_to_watch(2 * S, 0.02)
    table.bodies_to_watch(6 * S, 0.02)
    x, y, z = position_enu_m
    for tick in range(3):
        now_ns = 6 * S + tick * S // 50
        moved_m = 0.02 * tick * velocity_m_s
        pose = MocapPose(
            body="mav1", boot_id=1, sequence=tick, stamp_ns=now_ns, is_tracked=True,
            position_enu_m=(x + moved_m, y + 1e-4 * tick, z),
            quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
        )  # fmt: skip
        assert table.hear_pose(pose, now_ns)
    assert table.silent(now_ns) == (("mav1",) if is_silent else ())


def test_the_body_of_a_silent_neighbour_is_watched_until_its_messages_come_regularly_again() -> (
    None
):
    table = _table()
    changes = {}
    for tick in range(600):  # 12 s
        now_ns = 5 * S + tick * S // 50
        for name in ("mav1", "mav2"):
            if name == "mav1" or not 100 <= tick < 120:  # mav2 is silent for 0.4 s
                table.hear(_state(vehicle=name, sequence=tick, stamp_ns=now_ns), now_ns)
        bodies = table.bodies_to_watch(now_ns, 0.02)
        if bodies is not None:
            changes[tick] = bodies
    assert changes == {104: ("mav2",), 370: ()}


@pytest.mark.parametrize("is_airborne", [True, False])
def test_the_file_of_an_agent_that_has_left_counts_only_while_its_vehicle_flies(
    is_airborne: bool,
) -> None:
    table = _table()
    table.hear(_state(vehicle="mav1", is_airborne=is_airborne), 5 * S)
    table.hear(telemetry("mav1", config_hash="another", stamp_ns=5 * S), 5 * S)
    assert table.other_hashes("ours", 9 * S) == {"mav1": "another"}
    left = {"mav1": "another"} if is_airborne else {}
    assert table.other_hashes("ours", 11 * S) == left


def test_a_late_or_repeated_telemetry_does_not_replace_the_newest() -> None:
    table = _table()
    newest = telemetry("mav1", state="landing", stamp_ns=20 * S)
    assert table.hear(newest, 20 * S)
    assert not table.hear(telemetry("mav1", state="holding", stamp_ns=14 * S), 20 * S)
    assert not table.hear(newest, 21 * S)
    assert table.telemetries()["mav1"] == newest
    assert table.counts.late == 2


def test_a_telemetry_from_the_future_excludes_no_later_one() -> None:
    table = _table()
    assert table.hear(telemetry("mav1", stamp_ns=900 * S), 20 * S)
    assert table.hear(telemetry("mav1", state="landing", stamp_ns=20 * S + 1), 20 * S + 1)
    assert table.telemetries()["mav1"].state == "landing"


def test_a_telemetry_with_no_age_of_its_position_is_malformed() -> None:
    table = _table()
    assert not table.hear(telemetry("mav1", state_age_s=math.nan), 20 * S)
    assert table.counts.malformed == 1
    assert table.hear(telemetry("mav1", state_age_s=math.inf), 20 * S), "it never had a position"
