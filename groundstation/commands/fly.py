"""``covey fly``: a mission from its file to its verdict, in real time or in lockstep.

Examples:
  covey fly my_mission.py --sitl
  covey fly paper --fleet fleet.toml --headless --record flights/first
  covey fly paper --lockstep --law off
  covey fly my_show/mission.toml --fleet fleet.toml --at 21:30:00
  covey fly my_mission.py --lockstep --arg height_m=1.5
  covey fly paper --lockstep --wind-m-s 3,0 --fault 'mav1 mocap_lost at=14'

Exit status: 0 all expectations of the mission came true; 1 one did not; 2 wrong
input, nothing started; 10 nobody answered; 50 some vehicles did a step and
others did not; 130 interrupted. Ctrl-C lands; a second one ends the processes
that were started.
"""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.mission_faults import refuse_wrong_fault_steps, refuse_wrong_faults
from groundstation.commands.parameters import (
    BusOptions,
    FileName,
    FlightOptions,
    WorldOptions,
)
from groundstation.flights.flight_settings import flight_folder, prepare
from groundstation.flights.mission_flight import MissionFlight, clock_say
from groundstation.flights.simulation_settings import (
    SimulationSettings,
    order_for,
    refuse_wrong_settings,
    wind_of,
)
from groundstation.mission_files.loading import load_mission
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.wall_time import WallTime, local_now, wall_time
from onboard.config.fleet import ConfigError

_NO_OPTIONS = FlightOptions()
_NO_BUS_OPTIONS = BusOptions()
_NO_WORLD_OPTIONS = WorldOptions()


def fly(
    mission: Annotated[FileName, Parameter(name="MISSION")],
    /,
    *,
    sitl: bool = False,
    at: Annotated[str, Parameter(metavar="TIME", show_default=False)] = "",
    options: FlightOptions = _NO_OPTIONS,
    world: WorldOptions = _NO_WORLD_OPTIONS,
    bus: BusOptions = _NO_BUS_OPTIONS,
) -> int:
    """Fly a mission, TOML or Python, and say whether its expectations came true.

    Args:
        mission: mission file, or the name of an example
        sitl: start the emulator and the agents too, on the fleet file's ports
        at: begin at this wall-clock time, 21:30:00, if all computers have the same time
    """
    if sitl and options.lockstep:
        raise ConfigError(
            "--sitl flies in real time, --lockstep in simulated time. Leave one of them out."
        )
    return fly_mission(mission, options, world, bus, is_simulated=sitl, has_free_ports=False, at=at)


def fly_mission(
    mission: Mission | str,
    options: FlightOptions,
    world: WorldOptions,
    bus: BusOptions,
    *,
    is_simulated: bool,
    has_free_ports: bool,
    at: str = "",
) -> int:
    """Fly a mission as the options say; return the exit status.

    Args:
        mission: the loaded mission, or its path.
        options: options of all commands that fly a mission.
        world: weather, faults and orders of others.
        bus: delays and losses of the simulated bus.
        is_simulated: whether emulator and agents are started; a flight in lockstep always does.
        has_free_ports: whether a simulated fleet gets ports that no other program uses.
        at: time of day at which it begins; empty: when the vehicles are ready.

    Raises:
        ConfigError: wrong input; nothing was started.
    """
    is_simulated = is_simulated or options.lockstep
    _refuse_misplaced(options, world, bus, is_simulated=is_simulated)
    begin = _begin_of(at, options)
    simulation = _simulation(options, world, bus)
    if isinstance(mission, str):
        mission = load_mission(mission, options.fleet)
    refuse_wrong_faults(world.fault, mission.fleet)
    refuse_wrong_fault_steps(mission)
    for line in simulation.orders:
        order_for(mission.fleet, line)  # refuses a wrong one before the flight has a folder

    with flight_folder(options.record) as folder:
        return _fly_into(
            folder,
            mission,
            options,
            simulation,
            is_simulated=is_simulated,
            has_free_ports=has_free_ports,
            at=begin,
        )


def _fly_into(
    folder: Path,
    mission: Mission,
    options: FlightOptions,
    simulation: SimulationSettings,
    *,
    is_simulated: bool,
    has_free_ports: bool,
    at: WallTime | None,
) -> int:
    """Fly a mission that has been loaded into a folder; return the exit status."""
    settings = prepare(
        mission,
        folder,
        fleet_path=options.fleet,
        law=options.law,
        is_simulated=is_simulated,
        has_free_ports=has_free_ports and not options.lockstep,
        is_headless=options.headless or options.lockstep,
        simulation=simulation,
        needs_ports=not options.lockstep,
        arguments=_arguments(options.arg),
        at=at,
    )
    if not options.lockstep:
        return asyncio.run(MissionFlight(settings, say=clock_say()).fly())

    # Imported here: a flight with real agents does not need the simulation.
    from sitl.lockstep.command import fly_mission as fly_in_lockstep

    return fly_in_lockstep(settings.mission, settings.folder, settings.simulation)


def _refuse_misplaced(
    options: FlightOptions, world: WorldOptions, bus: BusOptions, *, is_simulated: bool
) -> None:
    """Refuse options that need a simulated flight or lockstep, if this flight is not one."""
    if bus.given and not options.lockstep:
        first = next(iter(bus.given)).replace("_", "-")
        raise ConfigError(f"--bus-{first} is for flights in lockstep. Add --lockstep.")
    if world.order and not options.lockstep:
        raise ConfigError(
            "--order is for flights in lockstep. Add --lockstep, or give the order from another"
            " terminal with covey order."
        )
    if world.given and not is_simulated:
        raise ConfigError(f"{world.given[0]} is for simulated flights. Add --sitl or --lockstep.")


def _begin_of(at: str, options: FlightOptions) -> WallTime | None:
    """Return the time of day at which the mission begins; None if the option is not given.

    Raises:
        ConfigError: the time is wrong, or the flight is in lockstep.
    """
    if not at:
        return None
    if options.lockstep:
        raise ConfigError(
            "--at is for flights in real time: a flight in lockstep has a time of its own. Leave"
            " one of them out."
        )

    try:
        return wall_time(at, local_now(time.time_ns()))
    except ConfigError as error:
        raise ConfigError(f"--at: {error}") from None


def _simulation(options: FlightOptions, world: WorldOptions, bus: BusOptions) -> SimulationSettings:
    """Return the settings of the simulation from the options, after checks."""
    wind_enu_m_s = (0.0, 0.0)
    if world.wind_m_s is not None:
        wind_enu_m_s = wind_of(world.wind_m_s)

    simulation = SimulationSettings(
        is_lockstep=options.lockstep,
        seed=options.seed,
        wind_enu_m_s=wind_enu_m_s,
        gust_m_s=world.gust_m_s,
        faults=world.fault,
        orders=world.order,
        bus=bus.given,
    )
    refuse_wrong_settings(simulation)
    return simulation


def _arguments(written: tuple[str, ...]) -> dict[str, str]:
    """Return arguments NAME=VALUE as a mapping from name to value."""
    arguments: dict[str, str] = {}
    for word in written:
        name, sign, value = word.partition("=")
        if not sign or not name.isidentifier() or name in arguments:
            raise ConfigError(f"--arg {word}: write each argument once, as NAME=VALUE.")
        arguments[name] = value
    return arguments
