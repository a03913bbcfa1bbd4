"""Who is heard at full rate: all in reach, and the nearest few always."""

from __future__ import annotations

from onboard.bus.schema import StateMessage
from onboard.neighbours import subscription
from onboard.neighbours.table import NeighbourTable
from tests.onboard.state_messages import state_message
from tests.sitl.square_fleets import square_fleet

S = 1_000_000_000
ZERO = (0.0, 0.0, 0.0)


def _state(
    name: str, x_m: float, sequence: int = 10, stamp_ns: int = S, **changes: object
) -> StateMessage:
    place = (x_m, 0.0, 1.0)
    return state_message(
        vehicle=name, sequence=sequence, stamp_ns=stamp_ns, position_enu_m=place, **changes
    )


def test_whoever_is_in_reach_is_followed_and_leaves_later_than_it_came() -> None:
    distances_m = {f"mav{place}": 1.0 + place for place in range(10)}
    first = subscription.select(distances_m, frozenset(), 6.5, 12)
    assert first == {f"mav{place}" for place in range(6)}
    moved = {name: 1.08 * far_m for name, far_m in distances_m.items()}
    # mav5 is at 6.48 m, inside what it may leave
    assert subscription.select(moved, first, 6.4, 12) == first
    assert "mav5" not in subscription.select(moved, frozenset(), 6.4, 12)


def test_the_nearest_four_are_followed_however_far() -> None:
    distances_m = {f"mav{place}": 50.0 + place for place in range(10)}
    found = subscription.select(distances_m, frozenset(), 6.0, 12)
    assert found == {"mav0", "mav1", "mav2", "mav3"}


def test_the_reach_leaves_room_to_notice_and_to_brake_from_full_speed() -> None:
    fleet = square_fleet(10)
    own = fleet.vehicles["mav0"]
    speed_m_s = fleet.law.avoid_speed_frac * own.max_speed_m_s
    closing_m = 2.0 * speed_m_s * (0.2 + 0.2 + 0.02)  # heard slowly, chosen, on its way
    brake_m = speed_m_s**2 / own.max_acceleration_m_s2
    assert subscription.reach_m(fleet, "mav0") > fleet.fleet.safety_distance_m + closing_m + brake_m


def test_a_table_narrows_to_its_neighbourhood_and_widens_again() -> None:
    fleet = square_fleet(12)
    table = NeighbourTable(fleet, "mav0")
    assert not table.followed  # the slow messages say where each is
    for place, name in enumerate(table.names):
        assert table.hear(_state(name, 3.0 * (1 + place)), S)
    assert table.select_followed(ZERO, S)
    assert table.followed == {"mav1", "mav2", "mav3", "mav4"}
    assert set(table.distances_m(ZERO, S)) == table.followed
    assert not table.select_followed(ZERO, S)
    table.select_followed((30.0, 0.0, 1.0), S)
    assert {"mav9", "mav10", "mav11"} < table.followed


def test_one_lost_slow_message_is_no_silence_but_three_are() -> None:
    fleet = square_fleet(12)
    table = NeighbourTable(fleet, "mav0")
    for place, name in enumerate(table.names):
        table.hear(_state(name, 3.0 * (1 + place)), S)
    assert table.select_followed(ZERO, S)
    assert not table.silent(S + 450_000_000)  # the newest state of those just chosen is a slow one
    assert not table.select_followed(ZERO, S)
    assert set(table.silent(S + 450_000_000)) == table.followed
    assert set(table.silent(S + 800_000_000)) == set(table.names)


def test_one_out_of_reach_that_falls_silent_has_time_to_be_seen() -> None:
    fleet = square_fleet(12)
    table = NeighbourTable(fleet, "mav0")
    for place, name in enumerate(table.names):
        table.hear(_state(name, 3.0 * (1 + place)), S)
    for _ in range(2):
        table.select_followed(ZERO, S)
    near = set(table.followed)
    assert table.unseen(S + 800_000_000) == tuple(name for name in table.names if name in near)
    bodies = table.bodies_to_watch(S + 800_000_000, 0.02)  # from here on all are looked for
    assert bodies is not None
    assert len(bodies) == len(table.names)
    table.select_followed(ZERO, S + 1_000_000_000)
    assert set(table.unseen(S + 1_000_000_000)) == near
    assert set(table.unseen(S + 1_150_000_000)) == set(table.names)
    table.hear(_state("mav11", 33.0, 11, 2 * S), 2 * S)
    for _ in range(2):
        table.select_followed((31.0, 0.0, 1.0), 2 * S)  # near it now
    assert "mav11" in table.unseen(2 * S + 260_000_000)


def test_who_stands_far_away_and_falls_silent_is_not_looked_for() -> None:
    fleet = square_fleet(12)
    table = NeighbourTable(fleet, "mav0")
    table.bodies_to_watch(0, 0.02)  # an agent that has just started knows nobody
    for place, name in enumerate(table.names[:10]):
        table.hear(_state(name, 3.0 * (1 + place), is_airborne=place < 4), S)
    for _ in range(2):
        table.select_followed(ZERO, S)
    near = [fleet.vehicles[name].body for name in table.names[:4]]
    assert table.bodies_to_watch(4 * S, 0.02) == tuple(near)
