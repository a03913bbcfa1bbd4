"""The flights behind ``covey evidence``: one mission, flown with every fault that can occur in it.

Each round flies every fault once. The vehicle, the time of the fault and the direction of the wind
are random numbers that follow from the number of the round, so a campaign that was stopped and
continued gives the same flights. First come undisturbed flights, which show how long the mission
takes and where its vehicles are.

What a flying vehicle has to do is judged by the claims in ``groundstation/evidence/hazards.py``,
and not by the failsafe table that the vehicle itself uses.
"""

from __future__ import annotations

import functools
import math
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import as_completed
from typing import NamedTuple

import numpy as np

from groundstation.evidence.hazards import claimed_action
from groundstation.evidence.kept_flights import NOTHING, FlightCase, FlownCase, KeptFlights
from groundstation.mission_files.loading import load_mission
from groundstation.mission_files.mission import Mission
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.config.wind_limit import GUST_SHARE, wind_limit_m_s
from onboard.control.path import point_at
from onboard.safety.failsafe_table import Action, Condition, Situation
from sitl.lockstep.campaign.broken_flight import Breaking, fly_broken, injection_of, wind_of
from sitl.lockstep.campaign.extent import Extent
from sitl.lockstep.campaign.injections import FIELD_INJECTIONS, INJECTIONS, Injection
from sitl.lockstep.campaign.judge import action_of_table
from sitl.worker_pool import worker_pool

_SEEDS_OF_A_ROUND = 1000  # seeds reserved for each round
_ARMING_S = 1.0  # the earliest fault comes this long before the first vehicle is in the air
_MIN_UNDISTURBED = 2  # least number of undisturbed flights
_NEVER_S = 1e6  # a time after the end of every flight
_PATH_STEP_S = 0.25
_NOTHING = Injection(NOTHING, lambda flight, name: None)


class Campaign(NamedTuple):
    """The flights of one campaign."""

    fleet_path: str
    mission_path: str
    wind_m_s: float  # mean wind, to which gusts are added
    rounds: int
    only: str = ""  # only faults whose name contains this are flown; empty: all


def refuse_strong_wind(fleet: FleetConfig, wind_m_s: float) -> None:
    """Refuse a wind in which missions of this fleet do not take off.

    Vehicles compare their limit with the wind over some seconds, in which gusts add to the mean. If
    the mean were the limit itself, half of all flights would end after the take-off. Therefore the
    mean plus one standard deviation of the gusts must stay below the limit.

    Raises:
        ConfigError: the wind with its gusts is above the lowest limit of the fleet, or it is
            negative or not a number.
    """
    if not wind_m_s >= 0.0:
        raise ConfigError(f"--wind is {wind_m_s:g}; it must be 0 m/s or more.")
    limits_m_s = {name: wind_limit_m_s(fleet, fleet.vehicles[name]) for name in fleet.enabled_names}
    lowest = min(limits_m_s, key=lambda name: limits_m_s[name])
    strongest_m_s = limits_m_s[lowest] / (1.0 + GUST_SHARE)
    if wind_m_s > strongest_m_s:
        shown_m_s = math.floor(10.0 * strongest_m_s) / 10.0
        raise ConfigError(
            f"--wind is {wind_m_s:g} m/s in the mean, with gusts of {GUST_SHARE:.0%}, and {lowest}"
            f" may fly in {limits_m_s[lowest]:.1f} m/s at most: in more, no mission of this fleet"
            f" sets out. Give --wind {shown_m_s:.1f} or less, or a fleet whose max_wind_m_s is"
            " higher (docs/wind.md)."
        )


def refuse_unknown_fault(only: str) -> None:
    """Refuse a filter that matches no fault name.

    Raises:
        ConfigError: no name of a fault contains it.
    """
    names = [injection.name for injection in (*INJECTIONS, *FIELD_INJECTIONS)]
    if not any(only in name for name in names):
        raise ConfigError(
            f"--only is '{only}', and no fault's name contains it. The faults are: "
            f"{'; '.join(names)}."
        )


def fly_campaign(
    campaign: Campaign, kept: KeptFlights, *, jobs: int, say: Callable[[str], None]
) -> list[FlownCase]:
    """Fly the missing flights of a campaign, and return all its flights.

    Args:
        campaign: the campaign.
        kept: the flights flown so far, to which new ones are added.
        jobs: number of processes.
        say: called with a line after each flight.

    Raises:
        ConfigError: the mission does not take off, although nothing fails; or a process has ended
            before its time.
    """
    mission = _mission(campaign.fleet_path, campaign.mission_path)
    undisturbed = undisturbed_cases(campaign)
    # first and alone, because the times of all faults depend on when the mission is in the air
    _fly_missing(campaign, undisturbed[:1], kept, jobs=1, say=None)
    reference = kept.flown[undisturbed[0]]
    if not reference.took_off:
        reason = "; ".join(reference.wrong) or "nobody took off"
        raise ConfigError(
            f"{campaign.mission_path} does not take off although nothing fails: {reason}."
        )

    cases = [*undisturbed, *broken_cases(campaign, mission, reference)]
    _fly_missing(campaign, cases, kept, jobs=jobs, say=say)
    return [kept.flown[case] for case in cases]


def undisturbed_cases(campaign: Campaign) -> list[FlightCase]:
    """Return the flights in which nothing breaks."""
    cases = []
    for number in range(max(campaign.rounds, _MIN_UNDISTURBED)):
        # 1: other random numbers than in broken_cases
        rng = np.random.default_rng([number, 0, 1])
        cases.append(
            FlightCase(
                fault=NOTHING,
                round=number,
                seed=_SEEDS_OF_A_ROUND * number,
                wind_enu_m_s=_wind(rng, campaign.wind_m_s),
            )
        )
    return cases


def broken_cases(
    campaign: Campaign, mission: Mission, reference: FlownCase
) -> Iterator[FlightCase]:
    """Yield the flights in which something breaks, round by round.

    Args:
        campaign: the campaign.
        mission: its mission.
        reference: an undisturbed flight, which shows when the mission is in the air.
    """
    begin_s = reference.first_airborne_s - _ARMING_S
    end_s = reference.last_airborne_s
    for number in range(campaign.rounds):
        for row, injection in enumerate((*INJECTIONS, *FIELD_INJECTIONS), start=1):
            victims = possible_victims(mission.fleet, injection)
            if not victims or campaign.only not in injection.name:
                continue
            # 2: other random numbers than in undisturbed_cases
            rng = np.random.default_rng([number, row, 2])
            yield FlightCase(
                fault=injection.name,
                round=number,
                victim=str(rng.choice(victims)),
                at_s=round(float(rng.uniform(begin_s, end_s)), 2),
                seed=_SEEDS_OF_A_ROUND * number + row,
                wind_enu_m_s=_wind(rng, campaign.wind_m_s),
            )


def _wind(rng: np.random.Generator, wind_m_s: float) -> tuple[float, float]:
    """Return a wind of a random direction: its velocity to the east and to the north."""
    angle_rad = float(rng.uniform(0.0, 2.0 * math.pi))
    return (round(wind_m_s * math.cos(angle_rad), 3), round(wind_m_s * math.sin(angle_rad), 3))


def possible_victims(fleet: FleetConfig, injection: Injection) -> list[str]:
    """Return the vehicles of a fleet that a fault can hit."""
    names = list(fleet.enabled_names)
    if injection.is_of_two and len(names) < 2:
        return []
    if injection.needs_global_position:
        names = [name for name in names if not fleet.vehicles[name].flies_by_vision]
    if not injection.needs:
        return names

    if injection.needs == "corrections":
        is_fix_required = fleet.corrections is not None and fleet.corrections.fix != "any"
        if not is_fix_required:
            return []
        return [name for name in names if fleet.takes_corrections(fleet.vehicles[name])]

    if injection.needs == "poses":
        fitting = [name for name in names if fleet.vehicles[name].mocap_required]
    elif injection.needs == "camera":
        fitting = [name for name in names if fleet.vehicles[name].flies_by_vision]
    else:  # satellites
        fitting = [name for name in names if fleet.vehicles[name].flies_by_satellites]
    if injection.is_of_all and len(fitting) < len(names):
        return []
    return fitting


def _fly_missing(
    campaign: Campaign,
    cases: Sequence[FlightCase],
    kept: KeptFlights,
    *,
    jobs: int,
    say: Callable[[str], None] | None,
) -> None:
    """Fly and keep the cases that are not among the kept flights.

    Each flight is kept as soon as it is flown, and reported in the order of the cases.

    Args:
        campaign: the campaign.
        cases: all flights that there have to be.
        kept: the flights flown so far, to which new ones are added.
        jobs: number of processes.
        say: called with a line after each flight; None: nothing is reported.
    """
    missing = [case for case in cases if case not in kept.flown]
    done = len(cases) - len(missing)
    unreported = deque(missing)
    fly_one = functools.partial(fly_case, campaign.fleet_path, campaign.mission_path)
    for flown in _flown(fly_one, missing, jobs):
        kept.keep(flown)
        while say is not None and unreported and unreported[0] in kept.flown:
            case = unreported.popleft()
            done += 1
            say(f"{done} of {len(cases)}  {line_of(kept.flown[case])}")


def _flown(
    fly_one: Callable[[FlightCase], FlownCase], cases: Sequence[FlightCase], jobs: int
) -> Iterator[FlownCase]:
    """Fly the cases in a number of processes, and yield each outcome as soon as it is there."""
    if jobs == 1 or len(cases) < 2:
        yield from map(fly_one, cases)
        return

    with worker_pool(jobs) as pool:
        flights = [pool.submit(fly_one, case) for case in cases]
        for flight in as_completed(flights):
            yield flight.result()


def line_of(flown: FlownCase) -> str:
    """Return one line that sums a flight up."""
    case = flown.case
    fault = case.fault
    if case.victim:
        fault += f", {case.victim} at {case.at_s:.1f} s"
    nearest = "-"
    if flown.smallest_m is not None:
        nearest = f"{flown.smallest_m:.2f} m"
    verdict = "as it should"
    if flown.wrong:
        verdict = f"WRONG: {flown.wrong[0]}"
    return f"{fault} (seed {case.seed}, nearest {nearest}): {verdict}"


@functools.lru_cache(maxsize=1)
def _mission(fleet_path: str, mission_path: str) -> Mission:
    return load_mission(mission_path, load_fleet(fleet_path))


def fly_case(fleet_path: str, mission_path: str, case: FlightCase) -> FlownCase:
    """Fly one case; an exception becomes a sentence of ``wrong``, and the campaign goes on.

    Raises:
        KeyboardInterrupt: Ctrl-C has ended the flight, which is not kept.
    """
    mission = _mission(fleet_path, mission_path)
    injection = _NOTHING
    at_s = _NEVER_S
    if case.fault != NOTHING:
        injection = injection_of(case.fault)
        at_s = case.at_s

    extent = Extent()
    victim = case.victim
    if not victim:  # an undisturbed flight; any name will do
        victim = mission.fleet.enabled_names[0]
    wrong: list[str] = []
    seen: dict[str, int] = {}
    smallest_m = (math.inf, math.inf, math.inf)  # for pairs with 0, 1 or 2 silenced vehicles
    had_pair = False
    try:
        flown = fly_broken(
            mission,
            Breaking(injection=injection, victim=victim, at_s=at_s),
            seed=case.seed,
            wind=wind_of(case.wind_enu_m_s),
            height_m=planned_height_m(mission),
            action_of=_action_by_claims,
            watch=extent.watch,
        )
    except Exception as error:  # noqa: BLE001 - one failed flight does not end the campaign
        wrong.append(f"ends with {type(error).__name__}: {error}")
    else:
        wrong += flown.wrong
        seen = flown.seen
        smallest_m = flown.smallest_m
        had_pair = flown.had_pair
        if case.fault == NOTHING and not flown.verdict.passed:
            wrong.append(flown.verdict.sentences[-1])
        if case.fault != NOTHING and not flown.is_injected:
            wrong.append(f"the fault at {at_s:g} s was not injected: the flight ended before it")

    free_m, one_silenced_m, _ = smallest_m
    first_airborne_s = 0.0
    if extent.took_off:
        first_airborne_s = round(extent.first_airborne_s, 2)
    return FlownCase(
        case=case,
        wrong=tuple(wrong),
        seen=dict(sorted(seen.items())),
        took_off=extent.took_off,
        first_airborne_s=first_airborne_s,
        last_airborne_s=round(extent.last_airborne_s, 2),
        smallest_m=_finite(free_m),
        smallest_silenced_m=_finite(one_silenced_m),
        hull_m=extent.hull_m,
        highest_m=round(extent.highest_m, 2),
        fastest_m_s=round(extent.fastest_m_s, 2),
        had_pair=had_pair,
    )


def planned_height_m(mission: Mission) -> float:
    """Return the greatest planned height [m]; for a Python mission the ceiling of the fence."""
    heights_m = [up_m for _, _, up_m in planned_places(mission)]
    _, ceiling_m = mission.fleet.fleet.geofence_m.z
    return max(heights_m, default=ceiling_m)


def planned_places(mission: Mission) -> list[tuple[float, float, float]]:
    """Return the planned positions of a mission [m]: spots, goals and points of its paths."""
    positions = []
    for step in mission.course():
        positions += [*step.positions.values(), *step.goals.values()]
        for path in step.paths.values():
            times_s = np.arange(0.0, path.duration_s + _PATH_STEP_S, _PATH_STEP_S).tolist()
            positions += [point_at(path, time_s).position_enu_m for time_s in times_s]
    return [(float(east), float(north), float(up)) for east, north, up in positions]


def _action_by_claims(situation: Situation, conditions: Collection[Condition]) -> Action:
    """Return the action that the conditions demand of a vehicle.

    The claims decide for a flying vehicle, and the failsafe table in all other situations.
    """
    if situation is Situation.FLYING:
        return claimed_action(conditions)
    return action_of_table(situation, conditions)


def _finite(distance_m: float) -> float | None:
    """Return a distance rounded to millimetres, or None if it is infinite."""
    if math.isfinite(distance_m):
        return round(distance_m, 3)
    return None
