"""The radio channel of the simulated bus: losses in bursts, airtime, and flights over it."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from groundstation.file_checks.examination import examine
from groundstation.processes.free_ports import toml_text
from onboard.config.fleet import ConfigError, RadioConfig, fleet_from_mapping
from onboard.feasibility.airtime import OFDM, OVERHEAD_BYTES, airtime_finding, turn_s
from onboard.feasibility.pair_checks import message_age_s
from sitl.lockstep.channel import FIRST_WINDOW, MAX_DOUBLED, Channel
from sitl.lockstep.connections import BusSettings, Losses
from sitl.lockstep.flight import Lockstep
from tests.bench import radio as bench_radio
from tests.bench.fixture import fleet_data

_MS = 1_000_000


@pytest.mark.parametrize(("loss", "burst"), [(0.05, 3.0), (0.2, 5.0), (0.05, 1.0)])
def test_losses_have_their_share_and_their_mean_length(loss: float, burst: float) -> None:
    rng = np.random.default_rng(5)
    losses = Losses()
    settings = BusSettings(loss=loss, burst=burst)
    lost = [
        losses.takes(("a", "b"), settings, draw, 20 * _MS * k)
        for k, draw in enumerate(rng.random(200_000))
    ]
    runs = [len(list(run)) for is_lost, run in itertools.groupby(lost) if is_lost]
    assert np.mean(lost) == pytest.approx(loss, rel=0.08)
    assert np.mean(runs) == pytest.approx(max(burst, 1.0 / (1.0 - loss)), rel=0.05)


def test_a_packet_between_vehicles_goes_over_the_access_point_and_takes_its_time_twice() -> None:
    arrivals: dict[str, list[int]] = {"access point": [], "direct": []}
    for link, seed in itertools.product(arrivals, range(200)):
        channel = Channel(RadioConfig(link=link), frozenset(("a", "b")), lambda: 0, seed=seed)  # type: ignore[arg-type]
        channel.send(("a", "b"), (), arrivals[link].append, True)
        channel.advance(10 * _MS)
        assert channel.busy_ns == arrivals[link][-1] < _MS
    assert np.mean(arrivals["access point"]) == pytest.approx(
        2.0 * np.mean(arrivals["direct"]), rel=0.03
    )


@pytest.mark.long
@pytest.mark.parametrize("stations", [2, 10, 30])
def test_stations_that_always_have_something_to_send_get_what_bianchi_computes(
    stations: int,
) -> None:
    """Bianchi, "Performance Analysis of the IEEE 802.11 Distributed Coordination Function", 2000,
    equations 7 to 9.
    """
    window = FIRST_WINDOW
    doubled = MAX_DOUBLED
    rate = 65.0

    def attempts(collided: float) -> float:
        series = sum((2.0 * collided) ** k for k in range(doubled))
        return 2.0 / (1.0 + window + collided * window * series)

    low = 0.0
    high = 1.0
    # the share of its attempts that collide, of a station that sends with that probability
    for _ in range(60):
        collided = 0.5 * (low + high)
        is_less = 1.0 - (1.0 - attempts(collided)) ** (stations - 1) > collided
        low, high = (collided, high) if is_less else (low, collided)
    tau = attempts(collided)
    any_sends = 1.0 - (1.0 - tau) ** stations
    one_sends = stations * tau * (1.0 - tau) ** (stations - 1)
    exchange_s = turn_s(1, 100 + OVERHEAD_BYTES, rate, OFDM._replace(backoff_slots=0.0))
    computed = one_sends / ((1.0 - any_sends) * OFDM.slot_us * 1e-6 + any_sends * exchange_s)

    now = [0]
    names = [f"mav{k}" for k in range(stations)]
    channel = Channel(RadioConfig(rate_mbit_s=rate), frozenset(names), lambda: now[0], seed=1)

    def send_again(name: str, at_ns: int) -> None:
        now[0] = at_ns
        channel.send((name, "ground-1"), (), lambda end_ns: send_again(name, end_ns), False)

    for name in names:
        send_again(name, 0)
    channel.advance(3_000 * _MS)
    assert channel.packets / 3.0 == pytest.approx(computed, rel=0.05)


def test_a_channel_that_is_full_drops_states_and_carries_orders() -> None:
    now = [0]
    states = list[int]()
    orders = list[int]()
    channel = Channel(RadioConfig(), frozenset(("a", "b", "c")), lambda: now[0], seed=1)
    for step in range(100):
        now[0] = step * 4 * _MS
        for _ in range(300):
            channel.send(("a", "b"), (), states.append, True)
        channel.send(("c", "b"), (), orders.append, False)
        channel.advance(now[0])
    assert channel.dropped > 100
    now[0] += 1000 * _MS
    channel.advance(now[0])
    assert len(orders) == 100


@pytest.mark.long
def test_a_flight_over_a_bad_radio_arrives_and_takes_the_airtime_that_check_says(
    tmp_path: Any,
) -> None:
    data = fleet_data(4, 2.0)
    data["radio"] = {"loss_frac": 0.03, "burst_packets": 3.0, "jitter_s": 0.002}
    fleet = fleet_from_mapping(data)
    with Lockstep(fleet, seed=2) as flight:
        flight.takeoff(1.0)
        channel = flight.bus.channel
        assert channel is not None
        before_ns = channel.busy_ns
        begin_s = flight.time_s
        flight.run(2.0)
        busy_pct = (channel.busy_ns - before_ns) / (flight.time_s - begin_s) * 1e-7
        assert flight.min_separation_m > fleet.fleet.safety_distance_m
    assert fleet.radio is not None
    assert busy_pct == pytest.approx(airtime_finding(fleet, fleet.radio, 3).value, rel=0.25)
    path = tmp_path / "fleet.toml"
    path.write_text(toml_text(data), encoding="utf-8")
    assert "airtime" in {finding.name for finding in examine(str(path))[2]}


def test_a_radio_that_no_air_carries_is_refused() -> None:
    for key, value in (
        ("rate_mbit_s", 0.5),
        ("loss_frac", 1.0),
        ("states_hz", 40),
        ("burst_packets", 0.0),
    ):
        with pytest.raises(ConfigError, match=key):
            fleet_from_mapping({**fleet_data(2, 2.0), "radio": {key: value}})


def _crossing(flight: Lockstep, back: bool) -> Callable[[], Any]:
    """Two rows of three, each through the gaps of the other."""

    async def go() -> Any:
        import asyncio

        names = flight.config.enabled_names
        goals = []
        for name in names:
            x, y, _ = flight.config.vehicles[name].start_enu_m
            if back:
                goals.append((x, y, 1.0))
                continue
            aside_m = 1.3 if y < 0 else -1.3
            goals.append((x + aside_m, -y, 1.0))

        moves = (
            flight.fleet[name].move(goal, timeout_s=40.0)
            for name, goal in zip(names, goals, strict=True)
        )
        return await asyncio.gather(*moves, return_exceptions=True)

    return go


def _partition(at_s: float, lasts_s: float, seed: int) -> None:
    """Cut the fleet into 3 + 3, the ground with the first: nobody is hit, all orders end, and all
    fly on.
    """
    data = fleet_data(6, 2.6)
    for k, vehicle in enumerate(data["vehicles"].values()):
        vehicle["start_enu_m"] = [2.6 * (k % 3) - 2.6, -1.8 if k < 3 else 1.8, 0.0]
    fence = data["fleet"]["geofence_m"]
    fence["x"] = [-9.0, 9.0]
    fence["y"] = [-9.0, 9.0]
    fleet = fleet_from_mapping(data)
    names = fleet.enabled_names
    with Lockstep(fleet, seed=seed) as flight:
        flight.takeoff(1.0)
        begin_s = flight.time_s
        flight.at(
            begin_s + at_s,
            lambda: flight.bus.partition([*names[:3], "ground-1"], names[3:], bridging=["sitl"]),
        )
        flight.at(begin_s + at_s + lasts_s, flight.bus.heal)
        answers = flight.wait_for(_crossing(flight, back=False)())
        # every order's end is heard, also later
        assert not [one for one in answers if isinstance(one, Exception)]
        flight.run(max(0.0, begin_s + at_s + lasts_s + 3.0 - flight.time_s))
        again = flight.wait_for(_crossing(flight, back=True)())
        assert not [one for one in again if isinstance(one, Exception)]
        silent = {event.vehicle for event in flight.events if event.code == "neighbour-silent"}
        assert set(names[:3]) <= silent  # what the ground can hear: it does not hear the others
        assert flight.min_separation_m > fleet.fleet.safety_distance_m


@pytest.mark.long
def test_a_fleet_that_is_cut_in_two_on_its_crossing_holds_and_goes_on_afterwards() -> None:
    _partition(1.5, 2.0, seed=3)


@pytest.mark.long
@pytest.mark.parametrize("half_seconds", range(1, 17))  # at 0 an order itself would be cut off
def test_a_fleet_is_cut_in_two_at_any_time_of_a_crossing(half_seconds: int) -> None:
    _partition(0.5 * half_seconds, 10.0, seed=half_seconds)


@pytest.mark.long
def test_thirty_vehicles_share_one_channel() -> None:
    case = next(case for case in bench_radio.CASES if case.vehicles == 30)
    flown = bench_radio.fly(case, seed=2)
    assert not flown.failure
    assert flown.min_separation_m > bench_radio.fleet_of(case).fleet.safety_distance_m
    assert flown.age_p99_ms <= 1e3 * message_age_s(bench_radio.fleet_of(case))
