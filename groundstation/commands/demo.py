"""``covey demo``: the paper's experiment in simulation, or a fleet of any size.

Examples:
  covey demo
  covey demo --law off
  covey demo --vehicles 8
  covey demo --headless --record flights/first
  covey demo --lockstep --bus-loss 0.1
  covey demo --secure

Exit status: 0 all came true; 1 an expectation failed; 2 wrong input, nothing started; 130
interrupted. Ctrl-C lands; a second one ends the processes that were started.
"""

from __future__ import annotations

import datetime
import tempfile
import tomllib
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from msgspec.structs import replace

from groundstation.commands.fly import fly_mission
from groundstation.commands.parameters import BusOptions, File, FlightOptions
from groundstation.keys.secured_fleet import secure_fleet
from groundstation.mission_files.loading import load_mission, with_fleet
from groundstation.mission_files.mission import Mission
from groundstation.processes.free_ports import in_another_folder, toml_text, with_free_ports
from groundstation.processes.supervisor import most_agents
from groundstation.starter.files import Answers, starter
from onboard.config.fleet import ConfigError, load_fleet

_OPTIONS, _BUS = FlightOptions(), BusOptions()
_FORMATION = "triangle"  # of the paper's mission


def demo(
    *,
    mission: File | None = None,
    vehicles: Annotated[int | None, Parameter(metavar="N")] = None,
    secure: bool = False,
    options: FlightOptions = _OPTIONS,
    bus: BusOptions = _BUS,
) -> int:
    """Fly the paper's experiment: emulator, agents and console of three weak drones, on free ports.

    Args:
        mission: fly this mission instead
        vehicles: as many of the same drones form a ring instead
        secure: with keys of its own: every link of the bus encrypted, both ends of it proven; so
            flies a fleet that has keys anyway
    """
    flown = mission or "paper" if vehicles is None else _made(mission, vehicles, options)
    if flown == "paper" and options.fleet is not None:
        own = load_fleet(options.fleet)
        if _FORMATION not in {**own.formations, **own.shapes}:
            raise ConfigError(
                f"The demo's mission flies the formation '{_FORMATION}', which {options.fleet} has not. Name a mission "
                f"for this fleet: covey demo --fleet {options.fleet} --mission FILE"
            )
    if secure and options.lockstep:
        raise ConfigError(
            "--secure is for the bus of real processes, and --lockstep has none. Leave one of them out."
        )
    loaded = load_mission(flown, options.fleet) if isinstance(flown, str) else flown
    if options.lockstep or not (secure or loaded.fleet.has_keys):
        return fly_mission(loaded, options, bus, is_simulated=True, has_free_ports=True)
    with tempfile.TemporaryDirectory(prefix="covey-demo-") as folder:
        locked = locked_copy(loaded, Path(folder))
        return fly_mission(locked, options, bus, is_simulated=True, has_free_ports=False)


def locked_copy(mission: Mission, folder: Path) -> Mission:
    """Return a mission with a copy of its fleet on free ports and with keys of its own.

    Args:
        mission: stays as it is, and so do its fleet file and the keys of that.
        folder: of the copy, there already.
    """
    fleet, file = mission.fleet, folder / "fleet.toml"
    data = with_free_ports(in_another_folder(tomllib.loads(fleet.text), fleet), fleet)
    file.write_text(toml_text(data), encoding="utf-8")
    return with_fleet(mission, secure_fleet(str(file), datetime.datetime.now(datetime.UTC)))


def _made(mission: str | None, vehicles: int, options: FlightOptions) -> Mission:
    """Make a mission of as many vehicles."""
    for name, value in (("mission", mission), ("fleet", options.fleet)):
        if value is not None:
            raise ConfigError(
                f"--vehicles makes a fleet and a mission of its own: leave --{name} out."
            )
    if vehicles > most_agents() and not options.lockstep:
        raise ConfigError(
            f"--vehicles is {vehicles}; this machine flies up to {most_agents()} in real time. More of them fly in "
            f"simulated time: covey demo --vehicles {vehicles} --lockstep"
        )
    made = starter(Answers(name="demo", vehicles=vehicles, type="ardrone"))
    return replace(made.mission, path="demo.toml")
