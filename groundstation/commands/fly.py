"""``covey fly``: a mission from its file to its verdict, in real time or in lockstep.

Examples:
  covey fly my_mission.py --sitl
  covey fly configs/missions/paper.toml --fleet fleet.toml --headless --record flights/first
  covey fly configs/missions/paper.toml --lockstep --law off
  covey fly my_mission.py --lockstep --arg height_m=1.5

Exit status: 0 all that the mission declares came true; 1 something did not; 2 wrong input, nothing
started; 130 interrupted. Ctrl-C lands; a second one ends the processes that were started.
"""

from __future__ import annotations

import asyncio
import datetime
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import BusOptions, FlightOptions
from groundstation.commands.shared.flight import MissionFlight, clock_say, prepare
from groundstation.mission_files.mission import Mission
from onboard.config.fleet import ConfigError

_OPTIONS, _BUS = FlightOptions(), BusOptions()


def fly(
    mission: Annotated[str, Parameter(name="MISSION")],
    /,
    *,
    sitl: bool = False,
    options: FlightOptions = _OPTIONS,
    bus: BusOptions = _BUS,
) -> int:
    """Fly a mission, TOML or Python, and say whether all came true that it declares.

    Args:
        mission: mission file
        sitl: start the emulator and the agents too, on the file's ports
    """
    return fly_mission(mission, options, bus, is_simulated=sitl, has_free_ports=False)


def fly_mission(
    mission: Mission | str,
    options: FlightOptions,
    bus: BusOptions,
    *,
    is_simulated: bool,
    has_free_ports: bool,
) -> int:
    """Fly a mission as the options say; the exit status.

    Raises:
        ConfigError: wrong input; nothing was started.
    """
    if options.seed < 0:
        raise ConfigError(f"--seed is {options.seed}; it must be 0 or more.")
    if bus.given and not options.lockstep:
        raise ConfigError(
            f"--bus-{next(iter(bus.given)).replace('_', '-')} is for flights in lockstep. Add --lockstep."
        )
    folder = options.record or new_folder()
    settings = prepare(
        mission,
        folder if options.record else folder.absolute(),
        fleet_path=options.fleet,
        law=options.law,
        is_simulated=is_simulated or options.lockstep,
        has_free_ports=has_free_ports and not options.lockstep,
        is_headless=options.headless or options.lockstep,
        seed=options.seed,
        needs_ports=not options.lockstep,
        arguments=_arguments(options.arg),
    )
    if not options.lockstep:
        return asyncio.run(MissionFlight(settings, say=clock_say()).fly())
    from sitl.lockstep.command import fly_mission as fly_in_lockstep
    from sitl.lockstep.connections import BusSettings

    return fly_in_lockstep(
        settings.mission, settings.folder, seed=settings.seed, bus=BusSettings(**bus.given)
    )


def _arguments(written: tuple[str, ...]) -> dict[str, str]:
    """Return NAME=VALUE by name."""
    arguments: dict[str, str] = {}
    for word in written:
        name, sign, value = word.partition("=")
        if not sign or not name.isidentifier() or name in arguments:
            raise ConfigError(f"--arg {word}: write each argument once, as NAME=VALUE.")
        arguments[name] = value
    return arguments


def new_folder() -> Path:
    """Return the folder of a flight that begins now."""
    return Path("flights") / datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
