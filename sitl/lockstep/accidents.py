"""Four real accidents of fleets, each flown with Covey's defence against it and without.

Each accident has a mission in the gallery (``configs/missions``). This file holds what went wrong
in the real accident, and Covey's defence against it. To take the defence out, values of the fleet
file are changed, the law is switched off, or rows of the failsafe table are set to "go on". The
emulator's truth decides whether the accident has happened again: vehicles touch, leave the fence,
or do not come down.

The accidents, and the part of each that is flown here:

* Orlando, 2024: the show's frame was turned by seven degrees, and the fence was near.
* Docklands, 2023: the wind rose to twice what the fleet could fly in.
* AAIB-29203: the ground controller's batteries were empty while a swarm returned, and several
  vehicles left the formation.
* London, 2023: many vehicles flew their paths two seconds late.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from groundstation.mission_files.mission import Mission
from groundstation.missions.runner import MissionRun
from onboard.config.fleet import FleetConfig
from onboard.config.fleet_config import Geofence
from onboard.config.wind_limit import wind_limit_m_s
from onboard.exit_status import EXIT_FAILED, EXIT_OK
from onboard.safety.failsafe_table import TABLE, Action, Condition, Situation
from sitl.emulator.emulator import Environment
from sitl.faults.catalogue import Fault
from sitl.lockstep.flight import GROUND, Lockstep
from sitl.physics.wind import WindSettings

_SAMPLE_S = 0.04  # time between two samples of the true positions
_READY_WITHIN_S = 20.0
_DIES_AFTER_S = 0.5  # time from the start of a mission step until the ground station is cut off
_LANDED_WITHIN_S = 90.0  # time to land after the mission, or after the ground station was cut off

TURN_DEG = 7.0
WIND_TIMES_LIMIT = 2.0  # strongest wind, in multiples of the fleet's wind limit
WIND_RAMP_S = 20.0  # time in which the wind rises
_GUST_M_S = 0.05  # standard deviation of the gusts, if the accident was not one of wind
_STRONG_GUST_M_S = 0.5  # about a tenth of the strongest wind
_WIND_CONDITIONS = (  # conditions of the failsafe table that a strong wind causes
    Condition.WIND_ABOVE,
    Condition.WIND_NEAR,
    Condition.PUSHED_ABOUT,
    Condition.DISTURBANCE_BOUND,
)
WIND_AT_S = 12.0  # simulated time at which the wind begins to rise
LATE_S = 2.0
LATE = ("mav0", "mav1")  # vehicles that follow their paths late


class Accident(NamedTuple):
    """One accident."""

    name: str  # name of its mission file
    defence: str  # the defence in words
    # returns the mission's fleet, changed into that of the real accident
    accident_fleet: Callable[[FleetConfig], FleetConfig]
    # returns that fleet without the defence
    undefended: Callable[[FleetConfig], FleetConfig]
    # plans what goes wrong; called before the flight begins; the bool is True with the defence
    plan_failure: Callable[[Lockstep, bool], None]
    # returns a context in which a defence that is not a fleet-file value is off
    without_defence: Callable[[], contextlib.AbstractContextManager[None]] = contextlib.nullcontext
    room_turn_deg: float = 0.0  # clockwise turn of the true fence against the fleet's frame
    gust_std_m_s: float = _GUST_M_S  # standard deviation of the gusts of the whole flight
    # name of the mission step in which the ground station is cut off; empty: never
    ground_ends_in: str = ""


@dataclass(slots=True)
class FlownAccident:
    """The outcome of one flight."""

    name: str
    is_defended: bool
    seed: int
    took_off: bool = False
    min_separation_m: float = math.inf  # true distance of pairs with at least one flying vehicle
    collisions: int = 0
    outside_m: float = 0.0  # greatest distance of a flying vehicle outside the true fence
    down: bool = False  # whether all vehicles are on the ground at the end
    reason: str = ""  # the sentence of the verdict that says why the mission failed; empty: passed
    promised_m: float = 0.0  # the safety distance of the fleet file
    # x and y of each vehicle in the frame of the true fence, every _SAMPLE_S seconds
    places_m: list[list[tuple[float, float]]] = field(default_factory=list)

    @property
    def harm(self) -> str:
        """What happened, in words; empty if there was no harm."""
        harms = []
        if self.collisions == 1:
            harms.append("a collision")
        elif self.collisions:
            harms.append(f"{self.collisions} collisions")
        if self.outside_m > 0.0:
            harms.append(f"{self.outside_m:.2f} m outside the fence")
        if not self.down:
            harms.append("not all came down")
        return ", ".join(harms)

    @property
    def line(self) -> str:
        """One-line summary of the flight."""
        which = "without"
        if self.is_defended:
            which = "with"

        nearest = "nobody flew"
        if self.took_off:
            nearest = f"closest {self.min_separation_m:.2f} m"

        harm = self.harm
        if not harm:
            harm = "no harm"
        return f"{self.name}, {which} its defence, seed {self.seed}: {harm}; {nearest}"


def fly(
    accident: Accident,
    mission: Mission,
    *,
    is_defended: bool,
    seed: int,
    folder: Path | None = None,
) -> FlownAccident:
    """Fly an accident once.

    Args:
        accident: one of ACCIDENTS.
        mission: the mission of the same name.
        is_defended: whether the fleet has its defence.
        seed: the seed of all random numbers.
        folder: the folder of the record; None records nothing.
    """
    fleet = accident.accident_fleet(mission.fleet)
    around_flight: contextlib.AbstractContextManager[None] = contextlib.nullcontext()
    if not is_defended:
        fleet = accident.undefended(fleet)
        around_flight = accident.without_defence()
    mission = replace(mission, fleet=fleet)

    gusts = Environment(WindSettings(gust_std_m_s=accident.gust_std_m_s))
    with around_flight, Lockstep(fleet, seed=seed, folder=folder, environment=gusts) as flight:
        flown = FlownAccident(accident.name, is_defended, seed)
        flown.promised_m = fleet.fleet.safety_distance_m

        accident.plan_failure(flight, is_defended)
        watch_truth(flight, flown, accident.room_turn_deg)
        flown.reason = flight.wait_for(_mission(flight, mission, accident.ground_ends_in))
        flight.until(lambda _: _is_down(flight), _LANDED_WITHIN_S)

        flown.down = _is_down(flight)
        flown.min_separation_m = flight.min_separation_m
        flown.collisions = len(flight.simulation.emulator.world.collisions)
    return flown


def fly_both(mission: Mission, *, seed: int) -> int:
    """Fly an accident without its defence and with it, and print both; return the exit status."""
    accident = ACCIDENTS[Path(mission.path).stem]
    print(f"The defence: {accident.defence}.", flush=True)

    is_as_expected = True  # harm without the defence, and no harm with it
    for is_defended in (False, True):
        flown = fly(accident, mission, is_defended=is_defended, seed=seed)
        print(flown.line, flush=True)
        if flown.reason and is_defended:
            print(f"  {flown.reason}", flush=True)
        is_harmed = bool(flown.harm)
        if is_harmed == is_defended:
            is_as_expected = False

    if is_as_expected:
        return EXIT_OK
    return EXIT_FAILED


def watch_truth(flight: Lockstep, flown: FlownAccident, room_turn_deg: float) -> None:
    """Sample the true positions of the vehicles, now and every _SAMPLE_S seconds.

    Args:
        flight: the flight that is sampled.
        flown: its outcome, to which take-off, distance outside the fence and positions are written.
        room_turn_deg: clockwise turn of the true fence against the fleet's frame.
    """
    cos = math.cos(math.radians(room_turn_deg))
    sin = math.sin(math.radians(room_turn_deg))
    simulation = flight.simulation
    west, east = flight.config.fleet.geofence_m.x
    south, north = flight.config.fleet.geofence_m.y
    position, _, _ = simulation.emulator.world.truth_enu()
    on_ground = simulation.emulator.world.vehicles.states.on_ground.tolist()

    positions_m = []
    for (east_m, north_m, _), is_on_ground in zip(position.tolist(), on_ground, strict=True):
        # in the frame of the true fence
        x = cos * east_m - sin * north_m
        y = sin * east_m + cos * north_m
        positions_m.append((x, y))
        if is_on_ground:
            continue

        flown.took_off = True
        beyond_m = max(west - x, x - east, south - y, y - north)
        flown.outside_m = max(flown.outside_m, beyond_m)
    flown.places_m.append(positions_m)

    simulation.at(simulation.time_s + _SAMPLE_S, lambda: watch_truth(flight, flown, room_turn_deg))


async def _mission(flight: Lockstep, mission: Mission, ground_ends_in: str) -> str:
    """Fly the mission until its end, or until the ground station is cut off.

    Returns:
        Why the mission failed, in words; empty if it passed.
    """
    ground_is_gone = asyncio.Event()

    def lose_ground() -> None:
        flight.bus.partition([GROUND])
        ground_is_gone.set()

    def on_progress(line: str) -> None:
        """Plan the loss of the ground when the line announces the step ``ground_ends_in``."""
        if ground_ends_in and line.startswith(f"{ground_ends_in} "):
            flight.at(flight.time_s + _DIES_AFTER_S, lose_ground)

    run = MissionRun(mission, flight.client, say=on_progress, ready_timeout_s=_READY_WITHIN_S)
    mission_task = asyncio.create_task(run.run())
    gone_task = asyncio.create_task(ground_is_gone.wait())
    await asyncio.wait({mission_task, gone_task}, return_when=asyncio.FIRST_COMPLETED)
    gone_task.cancel()
    if not mission_task.done():
        run.abort("The ground is gone.", can_land=False)
        await mission_task
        return "the ground is gone"

    verdict = mission_task.result()
    if verdict.passed:
        return ""
    return verdict.sentences[-1]


def _is_down(flight: Lockstep) -> bool:
    return bool(flight.simulation.emulator.world.vehicles.states.on_ground.all())


# -- Orlando ---------------------------------------------------------------------------------------


def _near_fence(fleet: FleetConfig) -> FleetConfig:
    """Return a fleet whose fence is narrow from west to east."""
    fence = fleet.fleet.geofence_m
    narrow = Geofence(x=(-2.4, 2.4), y=fence.y, z=fence.z)
    return replace(fleet, fleet=replace(fleet.fleet, geofence_m=narrow))


def _without_placing_check(fleet: FleetConfig) -> FleetConfig:
    """Return a fleet whose vehicles pass preflight even when they stand far from their spots."""
    return replace(fleet, fleet=replace(fleet.fleet, placing_m=1.0))


def turn_places(flight: Lockstep, turn_deg: float = TURN_DEG) -> None:
    """Turn the positions of all vehicles clockwise about the origin, as the frame was turned."""
    cos = math.cos(math.radians(turn_deg))
    sin = math.sin(math.radians(turn_deg))
    for place_m in flight.simulation.emulator.world.vehicles.states.position_ned_m:
        north_m, east_m, _ = place_m.tolist()
        place_m[0] = cos * north_m - sin * east_m
        place_m[1] = cos * east_m + sin * north_m


# -- Docklands -------------------------------------------------------------------------------------


def _let_wind_rise(flight: Lockstep, _is_defended: bool) -> None:
    config = flight.config
    limit_m_s = min(wind_limit_m_s(config, vehicle) for vehicle in config.vehicles.values())
    values = {"speed_m_s": WIND_TIMES_LIMIT * limit_m_s, "over_s": WIND_RAMP_S}
    flight.inject(
        Fault(
            name="wind_ramp",
            vehicle=config.enabled_names[0],
            at_s=WIND_AT_S,
            parameters=values,
        )
    )


@contextlib.contextmanager
def _flying_in_any_wind() -> Iterator[None]:
    """Change the failsafe table so that vehicles fly on in any wind while the block runs."""
    changed = {(Situation.FLYING, condition): Action.GO_ON for condition in _WIND_CONDITIONS}
    before = {row: TABLE[row] for row in changed}
    TABLE.update(changed)
    try:
        yield
    finally:
        TABLE.update(before)


# -- AAIB-29203 ------------------------------------------------------------------------------------


def _without_law(fleet: FleetConfig) -> FleetConfig:
    """Return a fleet whose vehicles do not avoid each other."""
    return fleet.with_law("off")


def _without_law_or_landing(fleet: FleetConfig) -> FleetConfig:
    """Return a fleet whose vehicles neither avoid each other nor land when the ground is lost."""
    # longer than any flight
    never_landing = replace(fleet, fleet=replace(fleet.fleet, ground_lost_land_s=3600.0))
    return _without_law(never_landing)


def _plan_nothing(_flight: Lockstep, _is_defended: bool) -> None:
    """Plan nothing: only the loss of the ground (``ground_ends_in``) goes wrong."""


# -- London ----------------------------------------------------------------------------------------


def _start_late(flight: Lockstep, is_defended: bool) -> None:
    """Let the vehicles of LATE follow their paths late.

    Without the defence the vehicles also do not compare their show clocks with each other.
    """
    for name in LATE:
        flight.agents[name].path_delay_s = LATE_S
    for agent in flight.agents.values():
        agent.follows_alone = not is_defended


def _unchanged(fleet: FleetConfig) -> FleetConfig:
    """Return the same fleet, for accidents that need no changes."""
    return fleet


ACCIDENTS = {
    accident.name: accident
    for accident in (
        Accident(
            name="orlando",
            defence="preflight compares the spots of all vehicles with where they are seen",
            accident_fleet=_near_fence,
            undefended=_without_placing_check,
            plan_failure=lambda flight, _: turn_places(flight),
            room_turn_deg=TURN_DEG,
        ),
        Accident(
            name="docklands",
            defence="each vehicle estimates the wind and lands above its limit",
            accident_fleet=_unchanged,
            undefended=_unchanged,
            without_defence=_flying_in_any_wind,
            plan_failure=_let_wind_rise,
            gust_std_m_s=_STRONG_GUST_M_S,
        ),
        Accident(
            name="aaib-29203",
            defence="vehicles keep their distance and land by themselves, without a ground",
            accident_fleet=_unchanged,
            undefended=_without_law_or_landing,
            plan_failure=_plan_nothing,
            ground_ends_in="home",
        ),
        Accident(
            name="london",
            defence="vehicles compare the show's clock, and the law keeps distances",
            accident_fleet=_unchanged,
            undefended=_without_law,
            plan_failure=_start_late,
        ),
    )
}
