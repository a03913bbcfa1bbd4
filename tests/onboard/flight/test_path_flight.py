"""A vehicle that follows a path: what it refuses, its clock among the others, and how it leaves."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from groundstation.orders.path_orders import parts_of
from groundstation.paths.pieces import fitted
from onboard import agent_inputs
from onboard.agent.core import AgentCore
from onboard.bus.schema import OrderKind, PathOrder
from onboard.config.fences import Fence
from onboard.control.path import Path, path_id, point_at, to_bytes
from onboard.estimation import wind
from onboard.flight import state_machine
from onboard.flight.path_flight import CATCH_UP_LIMIT_S, OtherClock, PathFlight, other_clocks
from onboard.flight.types import FlightStep, FlightView
from onboard.safety.failsafe_table import Action
from tests.onboard.agent.rig import Rig, fleet

_REST = (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)


def line(metres: float = 2.0, duration_s: float = 6.0, yaw_rad: float = 0.0) -> Path:
    """From the take-off spot eastwards, and no further."""
    times_s = np.linspace(0.0, duration_s, 13)
    share = times_s / duration_s
    eased = share**3 * (10 - 15 * share + 6 * share**2)
    return fitted(
        times_s, np.column_stack([metres * eased, 0 * share, 1 + 0 * share, yaw_rad * eased])
    )


def start(rig: Rig, path: Path, ahead_s: float = 1.0, on_lag: str = "land") -> PathOrder:
    """The start of a path, that much later."""
    start_ns = rig.now_ns + round(1e9 * ahead_s)
    return PathOrder(path_id=path_id(to_bytes(path)), show_id="s", start_ns=start_ns, on_lag=on_lag)  # type: ignore[arg-type]


def alone(battery_frac: float = 0.9) -> Rig:
    """A vehicle without neighbours."""
    return Rig(AgentCore(fleet(("mav0",)), "mav0", boot_id=7), battery_frac=battery_frac)


def following(path: Path, on_lag: str = "land") -> Rig:
    """A vehicle that has just begun."""
    rig = alone()
    rig.fly()
    for part in parts_of(path):
        assert rig.order("load_path", path=part).is_accepted
    assert rig.order(
        "follow_path", order_id="show", path=start(rig, path, on_lag=on_lag)
    ).is_accepted
    return rig


def test_a_path_is_followed_to_its_end_and_turns_the_vehicle() -> None:
    path = line(yaw_rad=1.0)
    rig = following(path)
    rig.run(1.0 + 0.5 * path.duration_s)
    assert rig.core.flight.path.lag_m < 0.1
    assert rig.telemetry is not None
    assert rig.telemetry.path_lag_m == pytest.approx(rig.core.flight.path.lag_m, abs=0.02)
    rig.run(0.5 * path.duration_s + 1.5)
    assert rig.outcomes()["show"] == "done"
    assert rig.core.flight.state == "flying"
    assert rig.position[0] == pytest.approx(2.0, abs=0.1)
    assert rig.telemetry.show_id == ""
    assert rig.setpoint is not None
    assert rig.setpoint.quaternion_wxyz[3] == pytest.approx(np.sin(0.5), abs=0.03)


def test_a_path_through_a_house_is_refused_with_its_time_and_one_above_it_is_not() -> None:
    for top_m, is_accepted in ((2.0, False), (0.5, True)):
        house = Fence(
            name="house",
            keep="out",
            polygon_enu_m=((0.8, -0.5), (1.2, -0.5), (1.2, 0.5), (0.8, 0.5)),
            height_m=(0.0, top_m),
        )
        fenced = msgspec.structs.replace(fleet(("mav0",)), fences=(house,))
        rig = Rig(AgentCore(fenced, "mav0", boot_id=7))
        rig.fly()
        (part,) = parts_of(line())
        reply = rig.order("load_path", path=part)
        assert reply.is_accepted == is_accepted
        if not is_accepted:
            assert "path lies inside the fence 'house'" in reply.reason
            assert reply.reason.startswith("At 2.9 s")


def test_a_path_through_a_table_of_a_spot_is_refused_and_one_above_it_is_not() -> None:
    pair = fleet(("mav0", "mav1"))
    for top_m, is_accepted in ((1.5, False), (0.7, True)):
        raised = msgspec.structs.replace(pair.vehicles["mav1"], start_enu_m=(2.0, 0.0, top_m))
        vehicles = {**pair.vehicles, "mav1": raised}
        rig = Rig(AgentCore(msgspec.structs.replace(pair, vehicles=vehicles), "mav0", boot_id=7))
        rig.fly()
        (part,) = parts_of(line())
        reply = rig.order("load_path", path=part)
        assert reply.is_accepted == is_accepted
        if not is_accepted:
            assert "-0.50 m above the ground at 1.5 m" in reply.reason


def test_what_cannot_be_followed_is_refused_in_words() -> None:
    rig = alone(0.31)
    rig.fly()
    good = line()
    (part,) = parts_of(good)
    loads = [
        (None, "one of its parts"),
        (msgspec.structs.replace(part, part=3, parts=2), "one of its parts"),
        (
            msgspec.structs.replace(part, data=part.data[:-1] + b"!"),
            "does not have its id|do not have its id",
        ),
        (parts_of(line(metres=9.0, duration_s=60.0))[0], "geofence"),
        (parts_of(line(duration_s=2.0))[0], "max_speed_m_s"),
    ]
    for order, words in loads:
        reply = rig.order("load_path", path=order)
        assert not reply.is_accepted
        assert any(word in reply.reason for word in words.split("|")), reply.reason
    assert "not loaded" in rig.order("follow_path", path=start(rig, good)).reason
    assert rig.order("load_path", path=part).is_accepted
    starts = [
        (start(rig, line(metres=1.5)), "not loaded"),
        (start(rig, good, ahead_s=-1.0), "would begin in"),
        (start(rig, good, ahead_s=90.0), "would begin in"),
        (None, "needs the path's id"),
    ]
    for order, words in starts:
        assert words in rig.order("follow_path", path=order).reason
    rig.battery_frac = 0.295
    rig.run(0.3)
    assert "battery" in rig.order("follow_path", path=start(rig, good)).reason
    rig.battery_frac = 0.31
    rig.carry(1.0, 0.0, 1.0)
    assert (
        "from the first point of its path" in rig.order("follow_path", path=start(rig, good)).reason
    )


def test_a_path_in_parts_is_complete_with_the_last_one() -> None:
    rig = alone()
    rig.fly()
    data = to_bytes(line())
    own_id = path_id(to_bytes(line()))
    cuts = data[:132], data[132:]
    halves = [PathOrder(path_id=own_id, part=k, parts=2, data=cut) for k, cut in enumerate(cuts)]
    assert rig.order("load_path", path=halves[1]).is_accepted
    assert "not loaded" in rig.order("follow_path", path=start(rig, line())).reason
    assert rig.order("load_path", path=halves[0]).is_accepted
    assert rig.order("follow_path", path=start(rig, line())).is_accepted
    assert "follows a path now" in rig.order("load_path", path=halves[0]).reason


def test_a_hold_before_the_start_ends_it_and_nobody_moves() -> None:
    rig = following(line())
    assert rig.order("hold").is_accepted
    rig.run(4.0)
    assert abs(rig.position[0]) < 0.05
    assert rig.outcomes()["show"] == "superseded"


def test_all_slow_down_for_the_one_who_is_behind() -> None:
    rig = following(line())
    rig.run(2.0)
    assert rig.telemetry is not None
    now_ns = rig.telemetry.stamp_ns + 500_000_000
    seconds = rig.telemetry.path_time_s
    behind = msgspec.structs.replace(rig.telemetry, vehicle="mav1", is_behind=True)
    (clock,) = other_clocks([behind], "s", now_ns)
    assert clock == OtherClock(clock.time_s, True)
    assert clock.time_s == pytest.approx(seconds + 0.5)
    assert (
        other_clocks([behind], "another", now_ns)
        == other_clocks([behind], "s", now_ns + 2 * 10**9)
        == []
    )
    flight = PathFlight(path=line(duration_s=30.0))
    flight.begin(PathOrder(path_id="", show_id="s", start_ns=0))
    rates = [flight.rate]
    for tick in range(1, 400):
        others = [OtherClock(flight.time_s, tick < 200)] if tick % 5 == 0 else None
        flight.advance(20_000_000 * tick, 0.02, (0.0, 0.0, 1.0), others)
        flight.is_lagging = False
        rates.append(flight.rate)
    assert min(rates) == pytest.approx(0.5)
    assert rates[-1] == pytest.approx(1.0)


def test_a_clock_that_is_ahead_waits_for_the_slowest() -> None:
    flight = PathFlight(path=line(duration_s=30.0))
    now_ns = 10**9
    flight.begin(PathOrder(path_id="", show_id="s", start_ns=now_ns))
    assert flight.path is not None
    for tick in range(500):
        here = point_at(flight.path, flight.time_s).position_enu_m
        flight.advance(
            now_ns + 20_000_000 * tick, 0.02, here, [OtherClock(0.02 * tick - 1.0, False)]
        )
    assert flight.time_s == pytest.approx(0.02 * 500 - 1.0, abs=0.15)
    assert flight.rate > 0.9


@pytest.mark.parametrize(("on_lag", "state"), [("land", "landing"), ("hold", "holding")])
def test_who_stays_behind_leaves_by_the_missions_policy(
    monkeypatch: pytest.MonkeyPatch, on_lag: str, state: str
) -> None:
    # what holds it looks like a gust, for which it would land
    monkeypatch.setattr(wind, "step", lambda memory, *_: memory)
    path = line(duration_s=8.0)
    rig = following(path, on_lag)
    rig.run(3.0)
    here = rig.position.copy()

    def is_held() -> None:
        rig.position = here.copy()
        rig.velocity = np.zeros(3)

    rig.after_move = is_held  # by whatever stands in its way
    for _ in range(round((CATCH_UP_LIMIT_S + 6.0) / 0.02)):
        rig.step()
        if rig.core.flight.state == state:
            break
    assert rig.core.flight.state == state
    assert rig.outcomes()["show"] == "failed"
    assert "behind its path" in rig.core.flight.reason
    assert rig.telemetry is not None
    assert not rig.telemetry.is_behind


def test_a_path_is_flown_to_its_end_without_the_ground() -> None:
    path = line()
    rig = following(path)
    rig.run(2.0)
    rig.core.handle(agent_inputs.NodeChanged("ground-1", False), rig.now_ns)
    rig.run(path.duration_s + 1.0)
    assert rig.outcomes()["show"] == "done"
    assert rig.position[0] == pytest.approx(2.0, abs=0.1)


def test_slow_flight_asked_by_a_failsafe_slows_the_clock_for_a_while() -> None:
    rig = following(line())
    rig.run(2.0)
    flight = rig.core.flight
    state_machine.begin_failsafe(
        flight, FlightView(rig.now_ns, *_REST, True, rig.snapshot), Action.SLOW, "near."
    )
    rig.run(0.6)
    assert flight.path.rate < 0.8
    assert flight.state == "flying"
    rig.run(1.5)
    assert flight.path.rate > 0.95


@pytest.mark.long
def test_a_pause_stops_the_vehicle_on_its_path_and_resume_lets_it_go_on_to_the_end() -> None:
    path = line()
    rig = following(path)
    rig.run(1.0 + 0.4 * path.duration_s)
    reply = rig.order("pause", order_id="pause")
    assert reply.is_accepted
    event = next(one for one in rig.events if one.order_id == "pause")
    assert event.order_outcome == "done"
    assert "The battery has 90 %; at 20 % it lands." in event.sentence

    rig.run(4.0)
    flight = rig.core.flight
    stands_at = rig.position.copy()
    time_s = flight.path.time_s
    assert flight.path.rate == 0.0
    assert float(np.linalg.norm(rig.velocity)) < 0.05
    rig.run(30.0)  # longer than any limit of a path
    assert flight.path.time_s == time_s
    assert float(np.linalg.norm(rig.position - stands_at)) < 0.1
    assert flight.order is not None
    assert flight.order.order_id == "show"
    assert rig.telemetry is not None
    assert rig.telemetry.is_path_paused

    assert rig.order("resume").is_accepted
    rig.run(0.6 * path.duration_s + 5.0)
    assert rig.outcomes()["show"] == "done"
    assert rig.position[0] == pytest.approx(2.0, abs=0.1)


def test_a_skip_leads_straight_to_the_end_and_the_order_to_follow_the_path_is_done_there() -> None:
    path = line(metres=3.0, duration_s=60.0)
    rig = following(path)
    rig.run(5.0)
    assert rig.position[0] < 1.0
    assert rig.order("pause").is_accepted  # a paused vehicle may skip as well
    assert rig.order("skip", order_id="skip").is_accepted
    event = next(one for one in rig.events if one.order_id == "skip")
    assert event.order_outcome == "done"

    rig.run(0.1)
    assert rig.telemetry is not None
    assert rig.telemetry.show_id == ""  # the others do not wait for it
    assert not rig.telemetry.is_path_paused
    rig.run(12.0)
    assert rig.outcomes()["show"] == "done"
    assert rig.position[0] == pytest.approx(3.0, abs=0.1)


def test_a_vehicle_that_skips_and_misses_poses_for_a_moment_still_goes_to_the_end() -> None:
    rig = following(line(metres=3.0, duration_s=60.0))
    rig.run(5.0)
    assert rig.order("skip").is_accepted
    rig.run(1.5)
    rig.has_mocap = False
    rig.run(0.4)
    assert rig.core.flight.step is FlightStep.COASTING
    rig.has_mocap = True
    rig.run(1.0)
    assert "show" not in rig.outcomes(), "it is not at the end of its path yet"
    rig.run(12.0)
    assert rig.outcomes()["show"] == "done"
    assert rig.position[0] == pytest.approx(3.0, abs=0.1)


@pytest.mark.long
def test_a_vehicle_that_skips_is_slowed_held_and_landed_as_on_any_way() -> None:
    ends: tuple[tuple[OrderKind, str], ...] = (("hold", "holding"), ("land", "landing"))
    for kind, state in ends:
        rig = following(line(metres=3.0, duration_s=60.0))
        rig.run(5.0)
        assert rig.order("skip").is_accepted
        rig.run(1.0)
        assert rig.order(kind).is_accepted
        rig.run(0.1)
        assert rig.core.flight.state == state
        assert rig.outcomes()["show"] == "superseded"


def test_nobody_skips_without_a_path_or_before_it_begins() -> None:
    rig = alone()
    rig.fly()
    assert "follows no path" in rig.order("skip").reason
    assert "has not begun yet" in following(line()).order("skip").reason


@pytest.mark.long
def test_land_and_hold_end_a_paused_path_and_a_weak_battery_lands_it() -> None:
    ends: tuple[tuple[OrderKind, str], ...] = (("hold", "holding"), ("land", "landing"))
    for kind, state in ends:
        rig = following(line())
        rig.run(3.0)
        assert rig.order("pause").is_accepted
        rig.run(3.0)
        assert rig.order(kind).is_accepted
        rig.run(0.1)
        assert rig.core.flight.state == state
        assert rig.telemetry is not None
        assert not rig.telemetry.is_path_paused

    rig = following(line())
    rig.run(3.0)
    assert rig.order("pause").is_accepted
    rig.battery_frac = 0.1
    rig.until("landing")

    rig = following(line())
    rig.run(3.0)
    assert rig.order("pause").is_accepted
    rig.core.handle(agent_inputs.NodeChanged("ground-1", False), rig.now_ns)
    rig.until("landing", timeout_s=90.0)


def test_nobody_pauses_without_a_path_before_it_begins_or_after_its_end() -> None:
    rig = alone()
    rig.fly()
    assert "follows no path" in rig.order("pause").reason
    assert "follows no path" in rig.order("resume").reason
    rig = following(line())
    assert "has not begun yet" in rig.order("pause").reason


def test_all_who_fly_a_show_pause_with_one_and_go_on_when_nobody_is_paused() -> None:
    own = PathFlight(path=line())
    own.begin(PathOrder(path_id="p", show_id="s", start_ns=0))
    own.time_s = 2.0

    def run(others: tuple[OtherClock, ...], seconds: float) -> None:
        for tick in range(round(50 * seconds)):
            own.advance(10**10 + tick, 0.02, (0.0, 0.0, 1.0), others)
            own.is_lagging = False

    run((OtherClock(2.0, is_behind=False, is_paused=True),), 3.0)
    assert own.rate == 0.0
    run((OtherClock(99.0, is_behind=False),), 3.0)
    assert own.rate > 0.9
