"""``covey fly script``: a Python script that connects with a fleet, emulated or real.

Examples:
  covey fly script script.py --fleet fleet.toml --lockstep
  covey fly script script.py --fleet fleet.toml --sitl -- --height 1.5
  covey fly script script.py --fleet fleet.toml --record flights/first
  covey fly script script.py --fleet fleet.toml --rehearse

The script uses groundstation.Fleet, groundstation.BlockingFleet or
groundstation.crazyswarm: docs/python-api.md. Without --lockstep and --sitl it
connects with running agents. Words after -- go to the script.

A rehearsal is a flight in simulated time before the flight with the fleet, which
follows only if the rehearsal went well. --rehearse asks for one. A script of
Crazyswarm for running agents always gets one, unless --no-rehearse is given.

Exit status: 0 the script has ended and all are down; 1 it failed, or a vehicle
is not down; 2 wrong input, nothing started; 130 interrupted. Ctrl-C leaves the
fleet in the state that the script declares; a second one ends at once.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import (
    FileName,
    FleetFile,
    Folder,
    LawName,
    refuse_wrong_seed,
)
from groundstation.crazyswarm.script_check import is_of_crazyswarm
from groundstation.flights.flight_settings import (
    flight_folder,
    open_folder,
    refuse_law_of_real_flight,
    simulated_fleet,
)
from groundstation.flights.script_flight import (
    fly_script,
    fly_script_emulated,
    fly_script_in_real_time,
    refuse_what_is_no_script,
)
from onboard.config.file_reading import SCRIPT, read_text
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_INTERRUPTED, EXIT_OK
from onboard.plain_text import plain_lines


def run(
    script: Annotated[FileName, Parameter(name="SCRIPT")],
    /,
    *arguments: Annotated[str, Parameter(name="ARGUMENT")],
    fleet: FleetFile,
    lockstep: bool = False,
    sitl: bool = False,
    record: Folder | None = None,
    law: LawName = None,
    seed: int = 0,
    rehearse: bool = False,
    no_rehearse: bool = False,
) -> int:
    """Run a Python script with a fleet; the same script flies simulated and for real.

    Args:
        script: Python file
        arguments: for the script, after --
        lockstep: agents and emulator in one process, in simulated time
        sitl: start the emulator and the agents too, on free ports
        record: flight folder (default: flights/<time>)
        law: covey, paper, off or a law of your own, instead of the fleet file's (simulated flights)
        seed: seed of everything random in the emulator
        rehearse: fly the script in simulated time first; nothing takes off when that fails
        no_rehearse: do not rehearse a script of Crazyswarm before it flies with running agents
    """
    refuse_what_is_no_script(script)
    if lockstep and sitl:
        raise ConfigError("--lockstep and --sitl are two ways to simulate: give one.")
    if lockstep and rehearse:
        raise ConfigError("--lockstep flies in simulated time already: leave --rehearse out.")
    if rehearse and no_rehearse:
        raise ConfigError("--rehearse and --no-rehearse: give one.")
    refuse_law_of_real_flight(law, is_simulated=lockstep or sitl)
    refuse_wrong_seed(seed)

    config = load_fleet(fleet)
    is_simulated = lockstep or sitl
    needs_rehearsal = not is_simulated and not no_rehearse and is_of_crazyswarm(script)
    with flight_folder(record) as folder:
        return _run_into(
            folder.absolute(),
            script,
            arguments,
            config,
            lockstep=lockstep,
            sitl=sitl,
            law=law,
            seed=seed,
            is_rehearsed=rehearse or needs_rehearsal,
        )


def _run_into(
    folder: Path,
    script: str,
    arguments: tuple[str, ...],
    config: FleetConfig,
    *,
    lockstep: bool,
    sitl: bool,
    law: str | None,
    seed: int,
    is_rehearsed: bool,
) -> int:
    """Run a script, after a rehearsal if it gets one, into a folder; return the exit status."""
    if is_rehearsed:
        _rehearse(script, arguments, config, folder / "rehearsal", seed)
    if lockstep or sitl:
        config = simulated_fleet(config, folder, law=law, has_free_ports=sitl, needs_ports=sitl)

    files = {"fleet.toml": config.text, "script.py": read_text(script, SCRIPT)}
    open_folder(folder, files, is_headless=True)
    print(f"Everything goes to {folder}.", flush=True)

    if lockstep:
        return _fly_in_lockstep(script, arguments, config, folder, seed)
    if sitl:
        return fly_script_emulated(script, arguments, config, folder, seed)
    return fly_script_in_real_time(script, arguments, config, folder)


def _rehearse(
    script: str, arguments: tuple[str, ...], config: FleetConfig, folder: Path, seed: int
) -> None:
    """Fly a script in simulated time.

    Raises:
        ConfigError: the exit status of this flight is not 0.
    """
    print("Rehearsal in simulated time, before anything takes off:", flush=True)
    simulated = simulated_fleet(config, folder, law=None, has_free_ports=False, needs_ports=False)
    files = {"fleet.toml": simulated.text, "script.py": read_text(script, SCRIPT)}
    open_folder(folder, files, is_headless=True)

    status = _fly_in_lockstep(script, arguments, simulated, folder, seed)
    if status == EXIT_INTERRUPTED:
        raise KeyboardInterrupt
    if status != EXIT_OK:
        raise ConfigError(
            f"The rehearsal of {script} ended with status {status}, for the reason above: nothing "
            f"has taken off. See it: covey replay {shlex.quote(str(folder))}"
        )
    print("The rehearsal went well.\n", flush=True)


def _fly_in_lockstep(
    script: str, arguments: tuple[str, ...], config: FleetConfig, folder: Path, seed: int
) -> int:
    # Imported here: a flight with real agents does not need the simulation.
    from sitl.lockstep.flight import Lockstep

    with Lockstep(config, seed=seed, folder=folder) as flight:

        def say(line: str) -> None:
            print(f"{flight.time_s:6.1f} s  {plain_lines(line)}", flush=True)

        flight.say = say
        return fly_script(script, arguments, flight, folder, run_it=flight.run_script)
