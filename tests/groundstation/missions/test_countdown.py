"""Starts at a time of the wall clock: counted down, stopped, and refused where clocks differ."""

from __future__ import annotations

import asyncio
from typing import Any

import numpy as np
import pytest

from groundstation.client.client import FleetClient
from groundstation.client.wall_clock import WallClock
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.wall_time import local_now
from groundstation.missions.api import Fleet
from groundstation.missions.countdown import Countdown, CountdownEnded, clock_words, count_down
from groundstation.missions.runner import MissionRun
from groundstation.paths.pieces import through
from onboard.config.fleet import ConfigError, FleetConfig
from tests.groundstation.missions.wall_clocks import NOW_NS, MovableClock


def looks(countdown: Countdown, clock: MovableClock, seconds: float) -> str:
    """Look as a countdown does for some time; return why it has ended."""
    for _ in range(round(seconds / 0.2)):
        ended = countdown.problem()
        if ended:
            return ended
        clock.pass_time(0.2)
    return countdown.last_problem()


def test_a_countdown_over_computers_with_the_same_time_goes_to_its_end() -> None:
    clock = MovableClock()
    countdown = Countdown(clock, clock.after(12.0), ("mav0", "mav1"))
    assert countdown.left_s == pytest.approx(12.0, abs=1e-6)
    assert looks(countdown, clock, 12.0) == ""
    assert countdown.left_s == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("shift_s", "words"), [(3.0, "3.0 s forwards"), (-7200.0, "2 h back")])
def test_a_clock_that_is_set_during_the_countdown_ends_it(shift_s: float, words: str) -> None:
    clock = MovableClock()
    countdown = Countdown(clock, clock.after(60.0), ("mav0",))
    assert looks(countdown, clock, 10.0) == ""
    clock.shift_ns = round(shift_s * 1e9)
    ended = looks(countdown, clock, 1.0)
    assert f"was set {words}" in ended


def test_a_process_that_waits_between_two_readings_is_no_step() -> None:
    clock = MovableClock()
    countdown = Countdown(clock, clock.after(60.0), ())
    clock.shift_ns = 1_000_000_000
    assert countdown.problem() == ""
    clock.shift_ns = 0
    assert looks(countdown, clock, 5.0) == ""


def test_a_computer_with_another_time_ends_the_countdown() -> None:
    clock = MovableClock()
    countdown = Countdown(clock, clock.after(60.0), ("mav0", "mav1"))
    assert looks(countdown, clock, 5.0) == ""
    clock.ahead["mav1"] = (-3.25, 0.002)
    ended = looks(countdown, clock, 3.0)
    assert "mav1's computer is 3.2 s behind this one" in ended
    assert "time server" in ended


def test_a_computer_that_thinks_it_is_1970_is_named() -> None:
    clock = MovableClock()
    clock.ahead["mav1"] = (-NOW_NS * 1e-9, 0.002)
    assert "56.9 years behind" in looks(
        Countdown(clock, clock.after(60.0), ("mav0", "mav1")), clock, 9.0
    )


def test_a_single_message_with_another_time_ends_nothing() -> None:
    clock = MovableClock()
    countdown = Countdown(clock, clock.after(60.0), ("mav0",))
    assert looks(countdown, clock, 5.0) == ""
    clock.ahead["mav0"] = (1.0, 0.002)
    assert looks(countdown, clock, 0.8) == ""
    del clock.ahead["mav0"]
    assert looks(countdown, clock, 5.0) == ""


def test_a_computer_that_tells_no_time_or_is_known_badly_starts_nothing() -> None:
    clock = MovableClock()
    clock.ahead["mav0"] = None
    assert "does not tell" in looks(Countdown(clock, clock.after(60.0), ("mav0",)), clock, 9.0)
    # also when the time comes before it can have been measured
    assert "does not tell" in looks(Countdown(clock, clock.after(0.4), ("mav0",)), clock, 0.4)

    clock.ahead["mav0"] = (0.0, 0.8)
    assert "0.8 s only" in looks(Countdown(clock, clock.after(60.0), ("mav0",)), clock, 9.0)


def test_whose_clocks_agree_is_said() -> None:
    clock = MovableClock()
    clock.ahead = {"mav1": (-0.2, 0.01), "mav2": (7.0, 0.01), "mav3": None}
    assert clock_words(clock, ("mav0", "mav1", "mav2", "mav3")) == (
        "Same time within 0.210 s: mav0, mav1. The clock differs: mav2. "
        "The clock is not measured yet, or not reported: mav3."
    )


async def test_a_countdown_says_how_long_it_is_and_an_operator_stops_it() -> None:
    clock = MovableClock()
    countdown = Countdown(clock, clock.after(61.0), ())
    assert "in 0:01:01" in countdown.line
    lines: list[str] = []
    counting = asyncio.create_task(count_down(countdown, lines.append))
    await asyncio.sleep(0)
    clock.pass_time(2.0)
    await asyncio.sleep(0.25)
    countdown.stop("Stopped.")
    with pytest.raises(CountdownEnded, match="Stopped"):
        await asyncio.wait_for(counting, 5.0)
    assert [line.strip() for line in lines] == [f"1 min until the start at {countdown.at.words}"]


# -- missions --------------------------------------------------------------------------------------

HOP: list[dict[str, Any]] = [{"do": "takeoff", "height_m": 1.0}, {"do": "land"}]


def make(fleet: FleetConfig, steps: list[dict[str, Any]]) -> Any:
    return mission_from_mapping({"schema": 1, "step": steps}, path="test.toml", fleet=fleet)


async def test_a_mission_begins_at_its_time_and_not_before(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    clock = client.wall_clock = MovableClock(client.now_ns)
    at = clock.after(0.4)
    run = MissionRun(make(fleet, HOP), client, at=at)
    verdict = await asyncio.wait_for(run.run(), 20.0)
    assert verdict.passed, verdict.summary
    first_ns = min(order.stamp_ns for _, order in bus.orders)
    assert first_ns - client.now_ns() + client.wall_clock.wall_ns >= at.wall_ns


async def test_a_countdown_that_is_stopped_starts_nothing(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    clock = client.wall_clock = MovableClock(client.now_ns)
    run = MissionRun(make(fleet, HOP), client, at=clock.after(60.0))
    flown = asyncio.create_task(run.run())
    assert await client.wait_for(lambda _: run.fleet.ground.countdown is not None, 5.0)
    assert run.fleet.ground.stop_countdown()
    verdict = await asyncio.wait_for(flown, 20.0)

    assert verdict.exit_status == 1
    assert "An operator has stopped the countdown" in verdict.summary
    assert not bus.orders
    assert not run.fleet.ground.stop_countdown()


ADA = "operator.1.ground-ada.ada"


@pytest.mark.parametrize("at_once", [True, False])
async def test_a_mission_of_a_fleet_that_another_ground_operates_ends_before_its_time(
    fleet: FleetConfig, bus: Any, at_once: bool
) -> None:
    client = FleetClient(fleet, author="tester", bus=bus)
    clock = client.wall_clock = MovableClock(client.now_ns)
    said: list[str] = []
    await client.start()
    # the first telemetry comes just after this ground has looked who operates
    client._control_due_ns = client.now_ns() + 60_000_000_000
    if at_once:
        bus.roles.see(ADA, True)
    beat = asyncio.create_task(bus.beat())
    run = MissionRun(make(fleet, HOP), client, at=clock.after(60.0), say=said.append)
    flown = asyncio.create_task(run.run())
    if not at_once:
        assert await client.wait_for(lambda _: run.fleet.ground.countdown is not None, 5.0)
        bus.roles.see(ADA, True)
        client._control_due_ns = 0
    verdict = await asyncio.wait_for(flown, 5.0)
    beat.cancel()
    await client.stop()

    assert verdict.exit_status == 1
    assert "operates this fleet" in verdict.summary
    assert any("Starts at" in line for line in said) is not at_once
    assert not bus.orders


async def test_a_mission_that_begins_at_once_sees_who_operates_before_its_first_order(
    fleet: FleetConfig, bus: Any
) -> None:
    client = FleetClient(fleet, author="tester", bus=bus)
    await client.start()
    client._control_due_ns = client.now_ns() + 60_000_000_000
    bus.roles.see(ADA, True)
    beat = asyncio.create_task(bus.beat())
    verdict = await asyncio.wait_for(MissionRun(make(fleet, HOP), client).run(), 5.0)
    beat.cancel()
    await client.stop()
    assert "operates this fleet" in verdict.summary
    assert not bus.orders


async def test_an_operator_stops_all_countdowns_of_parallel_steps(client: Any) -> None:
    clock = client.wall_clock = MovableClock(client.now_ns)
    ground = Fleet(client).ground
    with ground.counting(clock.after(120.0), ()) as late:
        with ground.counting(clock.after(60.0), ()) as early:
            assert ground.countdown is early
        assert ground.countdown is late
        assert ground.stop_countdown()
        assert "An operator has stopped" in late.problem()
    assert not ground.stop_countdown()


async def _counted_down(fleet: FleetConfig, client: Any) -> asyncio.Task[Any]:
    """Return a mission whose countdown has begun and ends in less than half a second."""
    clock = client.wall_clock = MovableClock(client.now_ns)
    run = MissionRun(make(fleet, HOP), client, at=clock.after(0.4))
    flown = asyncio.create_task(run.run())
    assert await client.wait_for(lambda _: run.fleet.ground.countdown is not None, 5.0)
    return flown


async def test_a_vehicle_that_is_not_ready_any_more_when_the_time_comes_starts_nobody(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    flown = await _counted_down(fleet, client)
    bus.tell("mav1", not_ready=("Its battery is low.",))
    verdict = await asyncio.wait_for(flown, 20.0)
    assert "mav1 is ready: Its battery is low" in verdict.summary
    assert not bus.orders


async def test_a_vehicle_that_falls_silent_just_before_the_time_starts_nobody(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    flown = await _counted_down(fleet, client)
    del bus.vehicles["mav1"]
    verdict = await asyncio.wait_for(flown, 20.0)
    assert "mav1 does not answer" in verdict.summary
    assert not bus.orders


async def test_a_vehicle_that_flies_when_the_time_comes_starts_nobody(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    flown = await _counted_down(fleet, client)
    bus.tell("mav1", state="flying", is_airborne=True, is_armed=True)
    verdict = await asyncio.wait_for(flown, 20.0)
    assert verdict.exit_status == 2
    assert "takeoff, begins on the ground, and mav1 flies" in verdict.summary
    assert not bus.orders


@pytest.mark.parametrize(
    ("ahead_s", "words"),
    [(2.0, "what comes before it takes about"), (-60.0, "was 1 min ago")],
)
async def test_a_step_whose_time_comes_too_early_refuses_the_whole_mission(
    fleet: FleetConfig, client: Any, bus: Any, ahead_s: float, words: str
) -> None:
    clock = client.wall_clock = MovableClock(client.now_ns)
    time = local_now(clock.wall_ns + round(ahead_s * 1e9))
    steps = [HOP[0], {"do": "wait", "at": f"{time:%H:%M:%S}"}, HOP[1]]
    verdict = await asyncio.wait_for(MissionRun(make(fleet, steps), client).run(), 20.0)
    assert verdict.exit_status == 2
    assert words in verdict.summary
    assert not bus.orders


def test_wrong_times_of_a_mission_file_are_refused_with_their_key(fleet: FleetConfig) -> None:
    with pytest.raises(ConfigError, match=r"test.toml: 'step\[0\].at': 'noon' is no time of day"):
        make(fleet, [{"do": "wait", "at": "noon"}])

    wait = {"do": "wait", "at": "21:30"}
    with pytest.raises(ConfigError, match="that time comes once"):
        make(fleet, [HOP[0], {"do": "repeat", "times": 2, "steps": [wait]}, HOP[1]])
    assert make(fleet, [wait, *HOP]).steps[0].at == "21:30"


async def test_simulated_time_waits_for_nobody(fleet: FleetConfig, client: Any) -> None:
    lines: list[str] = []
    steps = [{"do": "wait", "at": "03:00"}, *HOP]
    run = MissionRun(make(fleet, steps), client, say=lines.append)
    assert (await asyncio.wait_for(run.run(), 20.0)).passed
    assert "Simulated time has no wall clock: 03:00 counts as now." in lines


# -- paths -----------------------------------------------------------------------------------------


def paths_of(fleet: FleetConfig) -> dict[str, Any]:
    """A metre up for each above its spot."""
    paths = {}
    for name in fleet.enabled_names:
        x, y, _ = fleet.vehicles[name].start_enu_m
        points = [(x, y, 1.0, 0.0), (x, y, 2.0, 0.0)]
        paths[name] = through(np.array(points), np.full(2, 1.0))
    return paths


async def test_paths_start_at_that_instant_on_the_fleets_clock(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    clock = client.wall_clock = MovableClock(client.now_ns)
    flown = Fleet(client)
    await flown.takeoff(1.0)
    at = clock.after(4.0)
    await asyncio.wait_for(flown.follow_path(paths_of(fleet), at=at), 20.0)

    starts = [order.path.start_ns for _, order in bus.orders if order.kind == "follow_path"]
    assert len(starts) == 3
    expected_ns = at.wall_ns - clock.offset_ns()
    assert all(abs(start_ns - expected_ns) < 2_000_000 for start_ns in starts)


async def test_a_start_that_is_stopped_after_its_order_holds_all(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    clock = client.wall_clock = MovableClock(client.now_ns)
    bus.accept_only = {"follow_path"}
    flown = Fleet(client)
    await flown.takeoff(1.0)
    following = asyncio.create_task(flown.follow_path(paths_of(fleet), at=clock.after(3.6)))

    def is_ordered(_: object) -> bool:
        return any(order.kind == "follow_path" for _, order in bus.orders)

    assert await client.wait_for(is_ordered, 10.0)
    assert flown.ground.stop_countdown()
    with pytest.raises(CountdownEnded, match="operator"):
        await asyncio.wait_for(following, 20.0)
    assert [name for name, order in bus.orders if order.kind == "hold"] == list(fleet.enabled_names)


async def test_vehicles_that_come_too_late_to_their_paths_do_not_start(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    clock = client.wall_clock = MovableClock(client.now_ns)
    flown = Fleet(client)
    await flown.takeoff(1.0)
    with pytest.raises(CountdownEnded, match="too late to the first points of their paths"):
        await asyncio.wait_for(flown.follow_path(paths_of(fleet), at=clock.after(1.0)), 20.0)
    with pytest.raises(CountdownEnded, match="the vehicles came too late"):
        await asyncio.wait_for(flown.countdown(clock.after(-1.0)), 20.0)


def test_the_quickest_of_three_readings_counts() -> None:
    """This process may have to wait between reading one clock and the other."""
    mono = iter([0, 500, 1000, 1002, 2000, 2400])
    wall = iter([10_000, 11_001, 12_700])
    clock = WallClock(lambda: None, lambda: next(mono), lambda: next(wall))
    assert clock.offset_ns() == 10_000
    assert clock.is_simulated
