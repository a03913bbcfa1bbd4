"""``covey demo``: the paper's experiment in simulation, or a fleet of any size.

Examples:
  covey demo
  covey demo --law off
  covey demo --vehicles 8
  covey demo --headless --record flights/first
  covey demo --lockstep --bus-loss 0.1
  covey demo --secure

Exit status: 0 all expectations came true; 1 one did not; 2 wrong input, nothing
started; 10 nobody answered; 50 some vehicles did a step and others did not; 130
interrupted. Ctrl-C lands; a second one ends the processes that were started.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.fly import fly_mission
from groundstation.commands.parameters import BusOptions, File, FlightOptions, WorldOptions
from groundstation.flights.demo_missions import locked_copy, mission_of_ring
from groundstation.mission_files.loading import load_mission
from groundstation.mission_files.mission import Mission
from groundstation.processes.supervisor import most_agents
from onboard.config.fleet import ConfigError, load_fleet

_NO_OPTIONS = FlightOptions()
_NO_BUS_OPTIONS = BusOptions()
_NO_WORLD_OPTIONS = WorldOptions()
_PAPER_FORMATION = "triangle"  # the formation that the paper's mission flies


def demo(
    *,
    mission: File | None = None,
    vehicles: Annotated[int | None, Parameter(metavar="N")] = None,
    secure: bool = False,
    options: FlightOptions = _NO_OPTIONS,
    world: WorldOptions = _NO_WORLD_OPTIONS,
    bus: BusOptions = _NO_BUS_OPTIONS,
) -> int:
    """Fly the paper's experiment: emulator, agents and console of three weak drones.

    All of it runs on free ports of this computer.

    Args:
        mission: fly this mission instead
        vehicles: number of the same drones, which form a ring instead
        secure: make keys for this flight: every link of the bus is encrypted, and both of its ends
            prove who they are; a fleet that has keys always flies so
    """
    if secure and options.lockstep:
        raise ConfigError(
            "--secure is for the bus of real processes, and --lockstep has none."
            " Leave one of them out."
        )

    if vehicles is None:
        flown = _loaded(mission or "paper", options)
    else:
        flown = _ring(mission, vehicles, options)

    is_locked = secure or flown.fleet.has_keys
    if options.lockstep or not is_locked:
        return fly_mission(flown, options, world, bus, is_simulated=True, has_free_ports=True)

    with tempfile.TemporaryDirectory(prefix="covey-demo-") as folder:
        locked = locked_copy(flown, Path(folder))
        return fly_mission(locked, options, world, bus, is_simulated=True, has_free_ports=False)


def _loaded(mission: str, options: FlightOptions) -> Mission:
    """Return a mission, loaded with the fleet that the options name."""
    if mission == "paper" and options.fleet is not None:
        fleet = load_fleet(options.fleet)
        if _PAPER_FORMATION not in {**fleet.formations, **fleet.shapes}:
            raise ConfigError(
                f"The demo's mission flies the formation '{_PAPER_FORMATION}', which"
                f" {options.fleet} has not. Name a mission for this fleet: covey demo --fleet"
                f" {options.fleet} --mission FILE"
            )
    return load_mission(mission, options.fleet)


def _ring(mission: str | None, vehicles: int, options: FlightOptions) -> Mission:
    """Return a mission in which this number of vehicles form a ring."""
    for name, value in (("mission", mission), ("fleet", options.fleet)):
        if value is not None:
            raise ConfigError(
                f"--vehicles makes a fleet and a mission of its own: leave --{name} out."
            )

    if vehicles > most_agents() and not options.lockstep:
        raise ConfigError(
            f"--vehicles is {vehicles}; this machine flies up to {most_agents()} in real time."
            f" More of them fly in simulated time: covey demo --vehicles {vehicles} --lockstep"
        )
    return mission_of_ring(vehicles)
