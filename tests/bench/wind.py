"""Winds, gusts, fleets and seeds: what comes of the paper's mission in each, in lockstep.

    make bench-wind                                  # the whole table: about an hour
    make bench-wind ARGS="--winds 0,4 --seeds 1:3"   # a part of it
    make bench-wind ARGS="--ramp 2 --seeds 1:21"     # the wind rises to twice the limit instead
    make bench-wind ARGS="--ramp 2 --over 5"         # within 5 s instead of 20 s
    make bench-wind ARGS="--row 1.5 --winds 6.5"     # a row along the wind takes off
    make bench-wind ARGS="--row 1.5 --winds 6.5 --by 1"  # one vehicle after another

A line for each flight: smallest distance by ground truth, collisions, how far outside the fence,
whether the mission passed, and the conditions that held. The wind comes from another direction in
each flight.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from groundstation.missions.hover_check import WindTooStrong
from groundstation.orders.result import OrderFailed
from onboard.config.fleet import load_fleet
from onboard.config.wind_limit import tilt_acceleration_m_s2, wind_limit_m_s
from onboard.safety.failsafe_table import Condition
from sitl.emulator.emulator import Environment
from sitl.faults.catalogue import Fault
from sitl.lockstep.flight import Lockstep
from sitl.physics.wind import WindSettings

ROOT = Path(__file__).parents[2]
MISSION = ROOT / "configs/missions/paper.toml"
FLEETS = ("paper", "sih")
WINDS_M_S = (0.0, 3.0, 4.0, 5.0, 6.0, 8.0)
STRONG_GUSTS_M_S = 3.0
GUST_SHARE = 0.15
HEIGHT_M = 1.0
RAMP_S = 20.0  # in which the wind rises to a multiple of the limit
_TO_LAND_S = 20.0  # after the rise; by then, everybody has disarmed

_TURN_RAD = 2.399963  # from the direction of one seed to that of the next: none comes again
_CODES = {condition.name.lower().replace("_", "-") for condition in Condition}


@dataclass(frozen=True, slots=True)
class WindyFlight:
    """What came of one flight."""

    min_separation_m: float
    collisions: int
    outside_m: float  # the farthest that a vehicle came outside the fence, horizontally
    has_passed: bool
    down_s: float  # time at which all were down; NaN: never
    # from then until a rising wind takes all of the tilt; NaN: it does not rise
    spare_s: float
    conditions: tuple[str, ...]
    reason: str


@dataclass(frozen=True, slots=True)
class Row:
    """Vehicles that take off in a row along the wind."""

    apart_m: float
    by: int  # so many at once; 0: all


def fly(fleet: str, mean_m_s: float, gust_m_s: float, seed: int) -> WindyFlight:
    """Fly the paper's mission in a steady wind with gusts."""
    east, north = _direction(seed)
    wind = WindSettings((mean_m_s * east, mean_m_s * north, 0.0), gust_m_s)
    with Lockstep(_path(fleet), seed=seed, environment=Environment(wind)) as flight:
        outside = _Outside(flight)
        verdict = flight.fly(MISSION)
        reason = ""
        if not verdict.passed:
            reason = verdict.sentences[-1]
        return _flown(flight, outside, has_passed=verdict.passed, reason=reason)


def fly_ramp(fleet: str, times_the_limit: float, seed: int, ramp_s: float = RAMP_S) -> WindyFlight:
    """Hover, let the wind rise to a multiple of the limit, and see how all come down."""
    config = load_fleet(_path(fleet))
    limit_m_s = min(wind_limit_m_s(config, vehicle) for vehicle in config.vehicles.values())
    east, north = _direction(seed)
    from_deg = math.degrees(math.atan2(-east, -north))
    gusts = WindSettings(gust_std_m_s=GUST_SHARE * limit_m_s)

    with Lockstep(config, seed=seed, environment=Environment(gusts)) as flight:
        outside = _Outside(flight)
        try:
            flight.takeoff(HEIGHT_M)
        except OrderFailed as failure:
            return _flown(flight, outside, has_passed=False, reason=str(failure))
        begin_s = flight.time_s
        values = {"speed_m_s": times_the_limit * limit_m_s, "from_deg": from_deg, "over_s": ramp_s}
        flight.inject(
            Fault(
                name="wind_ramp",
                vehicle=config.enabled_names[0],
                at_s=flight.time_s,
                duration_s=0.0,
                parameters=values,
            )
        )

        is_down = flight.until(
            lambda state: all(state.is_landed(name) for name in config.enabled_names),
            ramp_s + _TO_LAND_S,
        )
        flown = _flown(flight, outside, has_passed=is_down, reason="")

    too_much_m_s = min(
        tilt_acceleration_m_s2(vehicle) / vehicle.drag_1_s for vehicle in config.vehicles.values()
    )
    too_much_after_s = ramp_s * too_much_m_s / (times_the_limit * limit_m_s)
    return replace(flown, spare_s=begin_s + too_much_after_s - flown.down_s)


def fly_row(fleet: str, mean_m_s: float, gust_m_s: float, seed: int, row: Row) -> WindyFlight:
    """Put the vehicles down in a row along the wind, and let them take off in it."""
    east, north = _direction(seed)
    config = load_fleet(_path(fleet))
    middle = 0.5 * (len(config.vehicles) - 1)
    vehicles = {}
    for place, (name, vehicle) in enumerate(config.vehicles.items()):
        along_m = row.apart_m * (place - middle)
        _, _, ground_m = vehicle.start_enu_m
        start_enu_m = (along_m * east, along_m * north, ground_m)
        vehicles[name] = msgspec.structs.replace(vehicle, start_enu_m=start_enu_m)

    config = msgspec.structs.replace(config, vehicles=vehicles)
    wind = WindSettings((mean_m_s * east, mean_m_s * north, 0.0), gust_m_s)
    with Lockstep(config, seed=seed, environment=Environment(wind)) as flight:
        outside = _Outside(flight)
        has_taken_off = True
        reason = ""
        try:
            flight.ready()
            flight.wait_for(flight.fleet.takeoff(HEIGHT_M, by=row.by))
        except (OrderFailed, WindTooStrong) as failure:
            has_taken_off = False
            reason = str(failure)
        return _flown(flight, outside, has_passed=has_taken_off, reason=reason)


def main(words: Sequence[str]) -> int:
    """Fly and print; the exit status is 1 when two collided."""
    parser = argparse.ArgumentParser(prog="make bench-wind", description=__doc__)
    parser.add_argument("--fleets", default=",".join(FLEETS))
    parser.add_argument("--winds", default=",".join(f"{wind:g}" for wind in WINDS_M_S))
    parser.add_argument("--gusts", default="0,15%,3", help="m/s, or a share of the wind")
    parser.add_argument("--seeds", default="1:4", help="first:end")
    parser.add_argument("--ramp", type=float, help="rise to so many times the limit instead")
    parser.add_argument("--over", type=float, default=RAMP_S, help="the time of the rise in s")
    parser.add_argument("--row", type=float, help="take off in a row, so many metres apart")
    parser.add_argument("--by", type=int, default=0, help="so many at once; 0: all")
    options = parser.parse_args(words)
    first, end = (int(part) for part in options.seeds.split(":"))

    collided = 0
    for fleet in options.fleets.split(","):
        for title, mean_m_s, gust_m_s in _cases(options):
            for seed in range(first, end):
                if options.ramp is not None:
                    flown = fly_ramp(fleet, options.ramp, seed, options.over)
                elif options.row is not None:
                    row = Row(options.row, options.by)
                    flown = fly_row(fleet, mean_m_s, gust_m_s, seed, row)
                else:
                    flown = fly(fleet, mean_m_s, gust_m_s, seed)
                print(f"{fleet:6} {title:12} seed {seed:3} {_line(flown)}", flush=True)
                collided += flown.collisions > 0
    return int(collided > 0)


def _cases(options: argparse.Namespace) -> Iterable[tuple[str, float, float]]:
    """Yield title, mean and gusts of each case."""
    if options.ramp is not None:
        yield f"x{options.ramp:g} in {options.over:g} s", 0.0, 0.0
        return

    for mean_text in options.winds.split(","):
        mean_m_s = float(mean_text)
        for gust_text in options.gusts.split(","):
            if gust_text.endswith("%"):
                gust_m_s = 0.01 * float(gust_text[:-1]) * mean_m_s
            else:
                gust_m_s = float(gust_text)
            yield f"{mean_text}, {gust_text}", mean_m_s, gust_m_s


def _line(flown: WindyFlight) -> str:
    words = [
        f"{flown.min_separation_m:.3f} m",
        f"{flown.collisions} collisions",
        f"{flown.outside_m:.2f} m outside",
        "passed" if flown.has_passed else "failed",
        "" if math.isnan(flown.down_s) else f"down at {flown.down_s:.0f} s",
        "" if math.isnan(flown.spare_s) else f"{flown.spare_s:.1f} s before the tilt is used up",
        " ".join(flown.conditions),
        flown.reason[:160],
    ]
    return "; ".join(word for word in words if word)


class _Outside:
    """Follows how far outside the fence anybody comes."""

    def __init__(self, flight: Lockstep) -> None:
        self.farthest_m = 0.0
        self.down_s = math.nan
        self._flight = flight
        self._was_up = False
        self._look()

    def _look(self) -> None:
        simulation = self._flight.simulation
        fence = simulation.fleet.fleet.geofence_m
        position, _, _ = simulation.emulator.world.truth_enu()
        for x, y, _ in position.tolist():
            beyond = (fence.x[0] - x, x - fence.x[1], fence.y[0] - y, y - fence.y[1])
            self.farthest_m = max(self.farthest_m, *beyond)

        is_down = bool(simulation.emulator.world.vehicles.states.on_ground.all())
        if not is_down:
            self._was_up = True
            self.down_s = math.nan
        elif self._was_up and math.isnan(self.down_s):
            self.down_s = simulation.time_s
        simulation.at(simulation.time_s + 0.1, self._look)


def _flown(flight: Lockstep, outside: _Outside, *, has_passed: bool, reason: str) -> WindyFlight:
    conditions = sorted({event.code for event in flight.events} & _CODES)
    return WindyFlight(
        min_separation_m=flight.min_separation_m,
        collisions=len(flight.simulation.emulator.world.collisions),
        outside_m=outside.farthest_m,
        has_passed=has_passed,
        down_s=outside.down_s,
        spare_s=math.nan,
        conditions=tuple(conditions),
        reason=reason,
    )


def _direction(seed: int) -> tuple[float, float]:
    """Return where the air of a flight goes, as a unit vector east and north."""
    return math.cos(_TURN_RAD * seed), math.sin(_TURN_RAD * seed)


def _path(fleet: str) -> Path:
    return ROOT / f"configs/fleets/{fleet}.toml"
