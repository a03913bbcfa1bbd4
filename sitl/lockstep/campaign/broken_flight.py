"""One flight of a mission with one or two injected faults, judged until all vehicles are down."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from groundstation.fleet.state import FleetState
from groundstation.mission_files.mission import Mission
from groundstation.missions.api import OrderFailed
from groundstation.verdict.verdict import Verdict
from onboard.config.fleet import FleetConfig
from onboard.config.wind_limit import GUST_SHARE
from onboard.feasibility.blind_descent import blind_descent_findings
from onboard.safety.failsafe_table import Condition, Situation
from onboard.tuples import Xyz
from sitl.emulator.emulator import Environment
from sitl.lockstep.campaign.injections import FIELD_INJECTIONS, INJECTIONS, Injection
from sitl.lockstep.campaign.judge import ActionOf, Judge, action_of_table
from sitl.lockstep.flight import Lockstep
from sitl.physics.wind import WindSettings

# share of the safety distance that vehicles keep when all have lost their poses: 0.7 m of 0.8 m
BLIND_SHARE = 0.7 / 0.8

_DOWN_TIMEOUT_S = 60.0  # time for the landing at the end, in addition to the descent
_SLOWEST_DESCENT_M_S = 0.4


class Breaking(NamedTuple):
    """The faults of one flight, their times and their victims."""

    injection: Injection
    victim: str
    at_s: float  # time of the first, since the start of the simulation
    second: Injection | None = None
    second_victim: str = ""
    gap_s: float = 0.0  # from the first to the second


class BrokenFlight(NamedTuple):
    """The outcome of one flight."""

    wrong: list[str]  # sentences about what must not happen
    seen: dict[str, int]  # name of a condition -> ticks of all vehicles in which it held
    # smallest distance [m] of pairs in which no vehicle, one, or both are silenced
    smallest_m: tuple[float, float, float]
    had_pair: bool  # whether two vehicles were in the air at the same time
    verdict: Verdict
    is_injected: bool  # whether the flight has reached the time of the fault


def wind_of(mean_enu_m_s: tuple[float, float]) -> WindSettings:
    """Return a wind whose gusts are the share of the mean that the wind limit allows for."""
    east_m_s, north_m_s = mean_enu_m_s
    return WindSettings(
        mean_enu_m_s=(east_m_s, north_m_s, 0.0),
        gust_std_m_s=GUST_SHARE * math.hypot(east_m_s, north_m_s),
    )


def injection_of(name: str) -> Injection:
    """Return the injection of this name."""
    injections = (*INJECTIONS, *FIELD_INJECTIONS)
    return next(injection for injection in injections if injection.name == name)


def both_of(first: Injection, second: Injection) -> Injection:
    """Return an injection that allows whatever one of two injections allows.

    It demands no conditions that vehicles have to notice.
    """
    return replace(
        first,
        own=frozenset(),
        others=frozenset(),
        is_silenced=first.is_silenced or second.is_silenced,
        is_cut_off=first.is_cut_off or second.is_cut_off,
        may_leave_fence=first.may_leave_fence or second.may_leave_fence,
        is_falling=first.is_falling or second.is_falling,
        is_astray=first.is_astray or second.is_astray,
        is_blind=first.is_blind or second.is_blind,
        has_false_height=first.has_false_height or second.has_false_height,
        rises_m=max(first.rises_m, second.rises_m),
    )


def fly_broken(
    mission: Mission,
    breaking: Breaking,
    *,
    seed: int,
    wind: WindSettings,
    height_m: float,
    folder: Path | None = None,
    action_of: ActionOf = action_of_table,
    watch: Callable[[Lockstep], None] = lambda flight: None,
) -> BrokenFlight:
    """Fly a mission in which something breaks, and judge it.

    Args:
        mission: the mission with its fleet.
        breaking: the faults.
        seed: the seed of all random numbers.
        wind: the wind.
        height_m: height of the mission, which decides how long a descent without poses takes.
        folder: the folder of the record; None records nothing.
        action_of: returns what a vehicle has to do; by default what the failsafe table says.
        watch: called with the flight before it begins.

    Raises:
        KeyboardInterrupt: Ctrl-C has ended the mission.
    """
    injection = breaking.injection
    if breaking.second is not None:
        injection = both_of(breaking.injection, breaking.second)

    silenced = set()
    if breaking.injection.is_silenced:
        silenced.add(breaking.victim)
    if breaking.second is not None and breaking.second.is_silenced:
        silenced.add(breaking.second_victim)

    environment = Environment(wind=wind)
    with Lockstep(mission.fleet, seed=seed, folder=folder, environment=environment) as flight:
        judge = Judge(
            flight=flight,
            injection=injection,
            victim=breaking.victim,
            silenced=silenced,
            action_of=action_of,
        )
        watch(flight)

        def inject() -> None:
            judge.begin()
            breaking.injection.inject(flight, breaking.victim)

        flight.at(breaking.at_s, inject)
        if breaking.second is not None:
            inject_second = functools.partial(
                breaking.second.inject, flight, breaking.second_victim
            )
            flight.at(breaking.at_s + breaking.gap_s, inject_second)

        # the mission, and then the landing of all vehicles that still fly
        verdict = flight.fly(mission)
        if verdict.is_interrupted:  # the mission has landed the vehicles and returned
            raise KeyboardInterrupt

        # a second after all cuts of the bus have ended, every vehicle receives the order to land
        flight.bus.heal()
        flight.run(1.0)
        _bring_down(flight, judge, height_m)
        judge.finish()

        # what the vehicles noticed, and the distances that they kept
        seen: dict[str, int] = {}
        for counts in judge.seen.values():
            for condition, ticks in counts.items():
                seen[condition.value] = seen.get(condition.value, 0) + ticks

        free_m, one_silenced_m, both_silenced_m = judge.smallest
        has_lost_poses = Condition.POSITION_LOST.value in seen
        promised_m = _promised_m(
            injection, flight.config, height_m=height_m, has_lost_poses=has_lost_poses
        )

        wrong = judge.wrong
        if free_m < promised_m:
            wrong.append(f"{promised_m:g} m is promised: {free_m:.2f} m")
        if one_silenced_m < flight.config.fleet.body_diameter_m and not injection.is_falling:
            wrong.append(f"bodies touch: {one_silenced_m:.2f} m")

    return BrokenFlight(
        wrong=wrong,
        seen=seen,
        smallest_m=(free_m, one_silenced_m, both_silenced_m),
        had_pair=judge.had_pair,
        verdict=verdict,
        is_injected=judge.is_injected,
    )


def _bring_down(flight: Lockstep, judge: Judge, height_m: float) -> None:
    """Order vehicles that still fly to land, and wait until all are down and disarmed."""
    airborne = []
    for name, shell in flight.agents.items():
        is_flying = shell.core.flight.situation is Situation.FLYING
        if is_flying and shell.is_ticking:
            airborne.append(name)
    if airborne:
        with contextlib.suppress(OrderFailed):  # the judge notes vehicles that are not down
            flight.land(",".join(airborne))

    names = list(flight.simulation.names)
    px4s = flight.simulation.emulator.autopilots

    def are_all_down(_state: FleetState) -> bool:
        return all(
            not px4.is_armed and judge.truths[name].is_on_ground
            for name, px4 in zip(names, px4s, strict=True)
        )

    flight.until(are_all_down, _DOWN_TIMEOUT_S + height_m / _SLOWEST_DESCENT_M_S)


def _promised_m(
    injection: Injection, fleet: FleetConfig, *, height_m: float, has_lost_poses: bool
) -> float:
    """Return the distance [m] that two vehicles must keep while the law flies both.

    If ``covey check`` refuses the descent without poses, because it takes too long, only contact of
    the bodies is excluded.
    """
    body_m = fleet.fleet.body_diameter_m
    if injection.is_astray:
        return body_m

    if has_lost_poses:
        spots: dict[str, Xyz] = {}
        for name in fleet.enabled_names:
            x, y, _ = fleet.vehicles[name].start_enu_m
            spots[name] = (x, y, height_m)
        findings = blind_descent_findings(fleet, spots, "the flight")
        if any(finding.status == "refused" for finding in findings):
            return body_m

    if injection.is_blind:
        return BLIND_SHARE * fleet.fleet.safety_distance_m
    return fleet.fleet.safety_distance_m
