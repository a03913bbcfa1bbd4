"""``covey demo``: the paper's experiment in simulation, or a fleet of any size.

Examples:
  covey demo
  covey demo --law off
  covey demo --vehicles 8
  covey demo --headless --record flights/first
  covey demo --lockstep --bus-loss 0.1

Exit status: 0 all came true; 1 an expectation failed; 2 wrong input, nothing started; 130 interrupted. Ctrl-C lands;
a second one ends the processes that were started.
"""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter
from msgspec.structs import replace

from groundstation.commands.fly import fly_mission
from groundstation.commands.parameters import BusOptions, File, FlightOptions
from groundstation.processes.supervisor import most_agents
from groundstation.starter.files import Answers, starter
from onboard.config.fleet import ConfigError

_OPTIONS, _BUS = FlightOptions(), BusOptions()


def demo(
    *,
    mission: File | None = None,
    vehicles: Annotated[int | None, Parameter(metavar="N")] = None,
    options: FlightOptions = _OPTIONS,
    bus: BusOptions = _BUS,
) -> int:
    """Fly the paper's experiment: emulator, agents and console of three weak drones, on free ports.

    Args:
        mission: fly this mission instead
        vehicles: as many of the same drones form a ring instead
    """
    if vehicles is None:
        return fly_mission(mission or "paper", options, bus, is_simulated=True, has_free_ports=True)
    for name, value in (("mission", mission), ("fleet", options.fleet)):
        if value is not None:
            raise ConfigError(f"--vehicles makes a fleet and a mission of its own: leave --{name} out.")
    if vehicles > most_agents() and not options.lockstep:
        raise ConfigError(
            f"--vehicles is {vehicles}; this machine flies up to {most_agents()} in real time. More of them fly in "
            f"simulated time: covey demo --vehicles {vehicles} --lockstep"
        )
    made = starter(Answers(name="demo", vehicles=vehicles, type="ardrone"))
    return fly_mission(replace(made.mission, path="demo.toml"), options, bus, is_simulated=True, has_free_ports=True)
