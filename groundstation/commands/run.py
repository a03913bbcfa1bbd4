"""``covey run``: a Python script that connects with a fleet, in simulated time, with emulated PX4s,
or as it is.

Examples:
  covey run script.py --fleet fleet.toml --lockstep
  covey run script.py --fleet fleet.toml --sitl -- --height 1.5
  covey run script.py --fleet fleet.toml --record flights/first

The script uses groundstation.Fleet, groundstation.BlockingFleet or groundstation.crazyswarm:
docs/python-api.md. Without --lockstep and --sitl it meets the agents that run. What follows -- goes
to the script.

Exit status: 0 the script has ended and all are down; 1 it failed, or somebody is not down; 2 wrong
input, nothing started; 130 interrupted. Ctrl-C leaves the fleet in the state that the script
declares; a second one ends at once.
"""

from __future__ import annotations

import ast
import asyncio
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.fly import new_folder
from groundstation.commands.parameters import FleetFile, Folder, LawName
from groundstation.commands.shared.flight import (
    clock_say,
    open_folder,
    simulated_fleet,
    start_fleet,
)
from groundstation.missions.connection import Host, RealTime, run_script
from groundstation.missions.readiness import NotReady
from groundstation.missions.runner import READY_TIMEOUT_SIM_S
from groundstation.orders.result import OrderFailed
from groundstation.processes.supervisor import Processes
from groundstation.verdict.expectations import Expect
from groundstation.verdict.final_verdict import final_verdict
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_OK
from onboard.plain_text import plain_lines


def run(
    script: Annotated[str, Parameter(name="SCRIPT")],
    /,
    *arguments: Annotated[str, Parameter(name="ARGUMENT")],
    fleet: FleetFile,
    lockstep: bool = False,
    sitl: bool = False,
    record: Folder | None = None,
    law: LawName = None,
    seed: int = 0,
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
    """
    _check(script)
    is_simulated = lockstep or sitl
    if lockstep and sitl:
        raise ConfigError("--lockstep and --sitl are two ways to simulate: give one.")
    if law is not None and not is_simulated:
        raise ConfigError(
            "--law is for simulated flights: agents that run already fly the law of their fleet file."
        )
    if seed < 0:
        raise ConfigError(f"--seed is {seed}; it must be 0 or more.")
    folder = (record or new_folder()).absolute()
    config = load_fleet(fleet)
    if is_simulated:
        config = simulated_fleet(config, folder, law=law, has_free_ports=sitl, needs_ports=sitl)
    files = {"fleet.toml": config.text, "script.py": Path(script).read_text(encoding="utf-8")}
    open_folder(folder, files, is_headless=True)
    print(f"Everything goes to {folder}.", flush=True)
    if lockstep:
        return _in_lockstep(script, arguments, config, folder, seed)
    host = RealTime(config, folder=folder, say=clock_say())
    if not sitl:
        return _fly(script, arguments, host, folder)
    host.ready_timeout_s = READY_TIMEOUT_SIM_S
    processes = Processes(folder)
    try:
        start_fleet(config, folder, seed, processes)
        return _fly(script, arguments, host, folder)
    finally:
        asyncio.run(processes.stop())


def _check(script: str) -> None:
    """Refuse what is no script before anything starts."""
    try:
        tree = ast.parse(Path(script).read_text(encoding="utf-8"), script)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{script}: this script cannot be read ({error}). Check the path."
        ) from None
    except (SyntaxError, ValueError) as error:
        raise ConfigError(f"{script}: not valid Python: {error}. Correct that line.") from None
    if any(isinstance(node, ast.AsyncFunctionDef) and node.name == "mission" for node in tree.body):
        raise ConfigError(
            f"{script} is a mission, 'async def mission(fleet)'. Fly it with: covey fly {script}"
        )


def _in_lockstep(
    script: str, arguments: tuple[str, ...], config: FleetConfig, folder: Path, seed: int
) -> int:
    from sitl.lockstep.flight import Lockstep

    with Lockstep(config, seed=seed, folder=folder) as flight:
        flight.say = lambda line: print(f"{flight.time_s:6.1f} s  {plain_lines(line)}", flush=True)
        return _fly(script, arguments, flight, folder, run_it=flight.run_script)


def _fly(
    script: str,
    arguments: Sequence[str],
    host: Host,
    folder: Path,
    run_it: Callable[..., None] | None = None,
) -> int:
    """Run the script, print the verdict and the folder; the exit status."""
    status, failure = EXIT_OK, ""
    try:
        if run_it is None:
            run_script(script, arguments, host)
        else:
            run_it(script, *arguments)
    except (KeyboardInterrupt, asyncio.CancelledError):
        status = EXIT_INTERRUPTED
    except SystemExit as end:
        status = (
            end.code if isinstance(end.code, int) else EXIT_OK if end.code is None else EXIT_FAILED
        )
        failure = f"The script has ended with status {end.code}." if status else ""
    except (ConfigError, NotReady, OrderFailed, TimeoutError) as error:
        status, failure = EXIT_FAILED, str(error)
    except Exception as error:  # noqa: BLE001 - whatever a script raises is its author's to see; the fleet has been left
        traceback.print_exc()
        status, failure = EXIT_FAILED, f"{type(error).__name__}: {error}"
    if host.flown is None:
        words = (
            failure or "The script has connected with no fleet: groundstation.Fleet.connect() does."
        )
        print(plain_lines(f"{script}: {words}"), file=sys.stderr)
        return status or EXIT_FAILED
    host.flown.failure = failure
    host.flown.is_interrupted = status == EXIT_INTERRUPTED
    is_up = any(view.is_airborne for view in host.flown.state.vehicles.values())
    begin_ns, record_failure = host.end_record()
    expect = Expect(all_landed=not (is_up and host.at_end == "hold"))
    verdict = final_verdict(
        host.flown, expect, folder, begin_ns=begin_ns, record_failure=record_failure
    )
    for line in verdict.sentences:
        print(plain_lines(line), flush=True)
    print(f"See it again: covey replay {folder}", flush=True)
    return status or verdict.exit_status
