"""The clock of a path, the time that the others wait, and refusals: numbers at their limits."""

from __future__ import annotations

import math
from typing import Any, Literal

import pytest
from msgspec.structs import replace

from onboard.bus.schema import PathOrder, Telemetry
from onboard.config.fences import Fence
from onboard.control import path as paths
from onboard.control.path import path_of
from onboard.flight import path_flight
from onboard.flight.path_flight import OtherClock, PathFlight
from tests.groundstation.console.fake import telemetry
from tests.onboard.agent.rig import fleet

_FLEET = fleet()
_VEHICLE = _FLEET.vehicles["mav0"]
_START_NS = 50_000_000_000
_HERE = (0.0, 0.0, 1.0)
_ZERO = [0.0] * 8


def _piece(duration_s: float, x: list[float], height_m: float = 1.0) -> list[float]:
    return [duration_s, *x, *[0.0] * (8 - len(x)), *_ZERO, height_m, *[0.0] * 7, *_ZERO]


_RESTING = path_of([_piece(100.0, [])])


def _flight(**changes: Any) -> PathFlight:
    """A flight along a path that stays at one place, ten seconds after its start."""
    values = {"path": _RESTING, "show_id": "s", "start_ns": _START_NS, "time_s": 10.0}
    return PathFlight(**{**values, **changes})


def _ns(after_s: float) -> int:
    return _START_NS + round(after_s * 1e9)


# -- the clock -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("after_s", "time_s"), [(-2.0, -2.0), (0.0, 0.0)])
def test_until_the_start_the_clock_is_the_time_to_it(after_s: float, time_s: float) -> None:
    flight = _flight(time_s=-9.0)
    flight.advance(_ns(after_s), 0.1, _HERE, None)
    assert flight.time_s == pytest.approx(time_s)


def test_the_first_tick_takes_the_time_since_the_start_and_the_next_add_to_it() -> None:
    flight = _flight(time_s=-math.inf)
    flight.advance(_ns(0.5), 0.1, _HERE, None)
    assert flight.time_s == pytest.approx(0.5)
    flight.advance(_ns(9.0), 0.1, _HERE, None)
    assert flight.time_s == pytest.approx(0.6)

    soon = _flight(time_s=1.0)
    soon.advance(_ns(0.05), 0.1, _HERE, None)
    assert soon.time_s == pytest.approx(1.1)


@pytest.mark.parametrize(
    ("changes", "others", "target"),
    [
        ({}, [], 1.0),
        ({}, [OtherClock(10.0, is_behind=False)], 1.0),
        ({}, [OtherClock(9.951, is_behind=False)], 1.0),
        ({}, [OtherClock(9.85, is_behind=False)], 0.9),
        ({}, [OtherClock(9.85, is_behind=False), OtherClock(11.0, is_behind=False)], 0.9),
        ({}, [OtherClock(2.0, is_behind=False)], 0.5),
        ({}, [OtherClock(10.0, is_behind=True)], 0.5),
        ({"is_lagging": True}, [OtherClock(10.0, is_behind=False)], 0.5),
        ({}, [OtherClock(10.0, is_behind=True, is_paused=True)], 0.0),
        ({"is_paused": True}, [], 0.0),
    ],
)
def test_the_rate_of_the_clock_follows_the_others(
    changes: dict[str, Any], others: list[OtherClock], target: float
) -> None:
    flight = _flight(**changes)
    flight.advance(_ns(10.0), 0.1, _HERE, others)
    assert flight.target_rate == pytest.approx(target)
    assert flight.compare_ns == _ns(10.095)
    assert flight.rate == pytest.approx(max(target, 0.95))  # by half a unit a second at most
    assert flight.time_s == pytest.approx(10.0 + 0.1 * flight.rate)


def test_between_comparisons_the_rate_stays_and_a_pause_acts_at_once() -> None:
    flight = _flight(target_rate=0.5, rate=0.5)
    flight.advance(_ns(10.0), 0.1, _HERE, None)
    assert (flight.target_rate, flight.rate, flight.compare_ns) == (0.5, 0.5, 0)
    flight.is_paused = True
    flight.advance(_ns(10.1), 0.1, _HERE, None)
    assert (flight.target_rate, flight.rate) == (0.0, pytest.approx(0.45))


def test_a_clock_goes_faster_no_sooner_than_it_went_slower() -> None:
    flight = _flight(rate=0.5)
    flight.advance(_ns(10.0), 0.1, _HERE, [])
    assert flight.rate == pytest.approx(0.55)


# -- lag and time to catch up ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("was_lagging", "lag_m", "is_lagging"),
    [(False, 0.61, True), (False, 0.6, False), (True, 0.31, True), (True, 0.3, False)],
)
def test_it_lags_beyond_one_distance_and_has_caught_up_within_another(
    was_lagging: bool, lag_m: float, is_lagging: bool
) -> None:
    flight = _flight(is_lagging=was_lagging)
    flight.advance(_ns(10.0), 0.1, (lag_m, 0.0, 1.0), None)
    assert flight.lag_m == pytest.approx(lag_m)
    assert flight.is_lagging is is_lagging


@pytest.mark.parametrize(
    ("used_s", "lag_m", "slow_for_s", "later_s"),
    [
        (5.0, 1.0, 0.0, 5.1),
        (12.0, 1.0, 0.0, 12.1),
        (5.0, 0.0, 1.0, 4.99),
        (12.0, 0.0, 1.0, 11.99),
        (5.0, 0.0, 0.0, 4.99),
        (0.0, 0.0, 0.0, 0.0),
    ],
)
def test_time_to_catch_up_is_used_while_it_is_behind_and_comes_back_slowly(
    used_s: float, lag_m: float, slow_for_s: float, later_s: float
) -> None:
    slow_until_ns = _ns(10.0 + slow_for_s) if slow_for_s else 0
    flight = _flight(used_s=used_s, slow_until_ns=slow_until_ns)
    flight.advance(_ns(10.0), 0.1, (lag_m, 0.0, 1.0), None)
    assert flight.used_s == pytest.approx(later_s)


@pytest.mark.parametrize("is_own", [True, False])
def test_a_pause_uses_up_no_time_to_catch_up(is_own: bool) -> None:
    flight = _flight(used_s=9.0, is_paused=is_own)
    others = [OtherClock(10.0, is_behind=False, is_paused=not is_own)]
    for tick in range(20):
        flight.advance(_ns(10.0 + 0.1 * tick), 0.1, (1.0, 0.0, 1.0), others)
    assert flight.is_lagging
    assert flight.used_s == pytest.approx(9.0)
    assert not flight.is_lost


@pytest.mark.parametrize(
    ("is_lagging", "slow_until_ns", "used_s", "is_behind", "is_lost"),
    [
        (True, 0, 9.99, True, False),
        (True, 0, 10.0, False, True),
        (False, 1, 9.99, True, False),
        (False, 1, 10.0, True, False),
        (False, 0, 0.0, False, False),
    ],
)
def test_it_asks_for_time_until_its_time_to_catch_up_is_used_up(
    is_lagging: bool, slow_until_ns: int, used_s: float, is_behind: bool, is_lost: bool
) -> None:
    flight = _flight(is_lagging=is_lagging, slow_until_ns=slow_until_ns, used_s=used_s)
    assert (flight.is_behind, flight.is_lost) == (is_behind, is_lost)


@pytest.mark.parametrize(("until_s", "is_kept"), [(10.0, True), (9.999, False)])
def test_slow_flight_that_a_failsafe_asks_for_ends(until_s: float, is_kept: bool) -> None:
    flight = _flight(slow_until_ns=_ns(until_s))
    flight.advance(_ns(10.0), 0.1, _HERE, None)
    assert flight.slow_until_ns == (_ns(until_s) if is_kept else 0)


def test_a_flight_without_a_path_has_nothing_left_and_a_new_one_begins_anew() -> None:
    assert _flight(path=None).left_s == -math.inf
    assert _flight().left_s == pytest.approx(90.0)
    used = _flight(
        rate=0.5,
        target_rate=0.5,
        compare_ns=7,
        lag_m=2.0,
        is_lagging=True,
        slow_until_ns=7,
        is_paused=True,
        is_skipped=True,
        used_s=9.0,
    )
    used.begin(PathOrder(path_id="p", show_id="t", start_ns=9, on_lag="hold"))
    anew = PathFlight(
        path=_RESTING, show_id="t", start_ns=9, on_lag="hold", time_s=-math.inf, rate=1.0
    )
    assert used == anew


def test_the_goal_lies_ahead_by_the_lag_at_the_rate_of_the_clock() -> None:
    moving = path_of([_piece(4.0, [0.0, 1.0])])
    goal = _flight(path=moving, time_s=1.0, rate=0.5).goal(7, 0.2)
    assert goal.position_enu_m == pytest.approx((1.1, 0.0, 1.0))
    assert (goal.sequence, goal.is_on_path, goal.duration_s) == (7, True, 0.0)
    assert goal.clock_rate_frac == 0.5


# -- the clocks of others --------------------------------------------------------------------------


def _said(**changes: Any) -> Telemetry:
    said = telemetry("mav1", stamp_ns=_START_NS)
    on_path = {"show_id": "s", "path_time_s": 4.0, "path_rate_frac": 0.5, "is_behind": True}
    return replace(said, **{**on_path, **changes})


@pytest.mark.parametrize(
    ("after_s", "changes", "is_heard"),
    [
        (1.499, {}, True),
        (1.5, {}, False),
        (0.5, {"show_id": "another"}, False),
        (0.5, {"path_time_s": math.nan}, False),
        (0.5, {"path_rate_frac": math.nan}, False),
        (0.5, {"path_rate_frac": math.inf}, False),
    ],
)
def test_the_clocks_of_who_flies_the_same_show_count_while_they_are_heard(
    after_s: float, changes: dict[str, Any], is_heard: bool
) -> None:
    clocks = path_flight.other_clocks([_said(**changes)], "s", _ns(after_s))
    if not is_heard:
        assert clocks == []
        return
    (clock,) = clocks
    assert clock.time_s == pytest.approx(4.0 + 0.5 * after_s)
    assert clock.is_behind
    assert not clock.is_paused


# -- refusals --------------------------------------------------------------------------------------


def _part(index: int, parts: int, path: paths.Path = _RESTING) -> PathOrder:
    data = paths.to_bytes(path)
    size = -(-len(data) // parts)
    piece = data[index * size : (index + 1) * size]
    return PathOrder(path_id=paths.path_id(data), part=index, parts=parts, data=piece)


@pytest.mark.parametrize(
    ("index", "parts", "is_taken"),
    [(0, 1, True), (1, 2, True), (-1, 1, False), (1, 1, False), (0, 12, False), (0, 11, True)],
)
def test_a_part_has_its_number_among_as_many_as_a_path_may_have(
    index: int, parts: int, is_taken: bool
) -> None:
    order = replace(_part(0, 1), part=index, parts=parts)
    refused = path_flight.part_refusal(PathFlight(), order, _VEHICLE, _FLEET)
    has_wrong_number = refused is not None and "needs one of its parts" in refused
    assert has_wrong_number is not is_taken


def test_a_path_is_whole_with_its_last_part_and_another_one_begins_anew() -> None:
    flight = PathFlight()
    for index in (0, 1):
        order = _part(index, 2)
        assert path_flight.part_refusal(flight, order, _VEHICLE, _FLEET) is None
        flight.load(order)
        assert (flight.path is not None) is (index == 1)
    flight.load(_part(0, 2, path_of([_piece(5.0, [])])))
    assert flight.path is None

    following = _flight()
    refused = path_flight.part_refusal(following, _part(0, 1), _VEHICLE, _FLEET)
    assert refused is not None
    assert "follows a path now" in refused

    changed = replace(_part(0, 1), path_id="other")
    refused = path_flight.part_refusal(PathFlight(), changed, _VEHICLE, _FLEET)
    assert refused is not None
    assert "has changed on its way" in refused


def _refused_path(*pieces: list[float]) -> str | None:
    order = _part(0, 1, path_of(list(pieces)))
    return path_flight.part_refusal(PathFlight(), order, _VEHICLE, _FLEET)


def _from_rest(top_m_s: float, duration_s: float) -> list[float]:
    """A piece from rest to rest, whose speed is largest in its middle: 2 a t + 3 b t^2."""
    a = 2.0 * top_m_s / duration_s
    b = -2.0 * a / (3.0 * duration_s)
    return _piece(duration_s, [0.0, 0.0, a, b])


def test_a_path_is_refused_for_its_height_its_speed_its_ends_and_the_fence() -> None:
    top_m_s = _VEHICLE.max_speed_m_s
    assert _refused_path(_from_rest(0.9 * top_m_s, 0.5)) is None
    turning = _piece(4.0, [])
    turning[1 + 3 * 8 + 1] = 9.0  # rad/s of yaw, which are no speed
    assert _refused_path(turning) is None
    faster = _refused_path(_piece(2.0, [0.0, 0.06]))
    assert faster is not None
    assert "begin and end at rest" in faster
    assert _refused_path(_piece(2.0, [0.0, 0.04])) is None
    low = _refused_path(_piece(4.0, [], 0.05))
    assert low is not None
    assert "Raise the path" in low
    out = _refused_path(_piece(4.0, [], 99.0))
    assert out is not None
    assert "leaves the geofence at 0.0 s" in out

    quick = _refused_path(_piece(0.1, [0.0, 1.11 * top_m_s]))
    assert quick is not None
    assert "max_speed_m_s" in quick
    slower = _refused_path(_piece(0.1, [0.0, 1.09 * top_m_s]))
    assert slower is not None
    assert "max_speed_m_s" not in slower


def test_a_path_that_jumps_between_two_pieces_is_refused() -> None:
    rest = _piece(2.0, [])
    assert _refused_path(rest, _piece(2.0, [0.021])) is None
    jump = _refused_path(rest, _piece(2.0, [0.5]))
    assert jump is not None
    assert "position jumps by 0.50 m" in jump

    # the second piece begins at 0.1 m/s and ends at rest
    kink = _refused_path(rest, _piece(2.0, [0.0, 0.1, -0.025]))
    assert kink is not None
    assert "velocity jumps by 0.10 m/s" in kink


@pytest.mark.parametrize(("beside_m", "is_taken"), [(0.05, True), (-0.05, False)])
def test_a_path_may_pass_hardly_beside_a_house(beside_m: float, is_taken: bool) -> None:
    corners = ((beside_m, -1.0), (1.0, -1.0), (1.0, 1.0), (beside_m, 1.0))
    house = Fence(name="house", keep="out", polygon_enu_m=corners)
    order = _part(0, 1)  # of a path that stays at the origin
    fenced = replace(_FLEET, fences=(house,))
    refused = path_flight.part_refusal(PathFlight(), order, _VEHICLE, fenced)
    assert (refused is None) is is_taken


@pytest.mark.parametrize(
    ("wait_s", "away_m", "words"),
    [
        (10.0, 0.5, None),
        (0.05, 0.0, None),
        (10.0, 0.51, "from the first point of its path"),
        (0.0, 0.0, "would begin in 0.0 s"),
        (59.9, 0.0, None),
        (60.0, 0.0, "would begin in 60.0 s"),
    ],
)
def test_a_path_begins_within_a_minute_and_where_the_vehicle_is(
    wait_s: float, away_m: float, words: str | None
) -> None:
    moving = path_of([_piece(4.0, [0.0, 1.0])])
    flight = _flight(path=moving, path_id="p", show_id="")
    order = PathOrder(path_id="p", show_id="s", start_ns=_ns(wait_s))
    refused = path_flight.start_refusal(flight, order, _START_NS, (away_m, 0.0, 1.0))
    if words is None:
        assert refused is None
    else:
        assert refused is not None
        assert words in refused


def test_a_path_that_is_not_loaded_or_not_named_does_not_begin() -> None:
    order = PathOrder(path_id="p", show_id="s", start_ns=_ns(10.0))
    nameless = replace(order, show_id="")
    for flight, given, words in (
        (_flight(path_id="p"), None, "needs the path's id"),
        (_flight(path_id="p"), nameless, "needs the path's id"),
        (_flight(path_id="q"), order, "not loaded"),
        (_flight(path_id="p", path=None), order, "not loaded"),
    ):
        refused = path_flight.start_refusal(flight, given, _START_NS, _HERE)
        assert refused is not None
        assert words in refused


@pytest.mark.parametrize("kind", ["pause", "resume", "skip"])
@pytest.mark.parametrize(
    ("show_id", "time_s", "words"),
    [
        ("", 10.0, "follows no path"),
        ("s", 0.0, "has not begun yet"),
        ("s", 0.001, None),
        ("s", 99.9, None),
        ("s", 100.0, "at the end of its path"),
    ],
)
def test_a_path_is_paused_and_skipped_while_it_is_flown(
    kind: Literal["pause", "resume", "skip"], show_id: str, time_s: float, words: str | None
) -> None:
    refused = path_flight.change_refusal(_flight(show_id=show_id, time_s=time_s), kind)
    if words is None or (kind == "resume" and show_id):
        assert refused is None
    else:
        assert refused is not None
        assert words in refused
