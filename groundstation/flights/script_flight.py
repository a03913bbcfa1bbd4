"""One flight of a script: a Python program that connects with a fleet by itself.

A mission is called with a connected fleet. A script is a program that connects when it wants to,
with groundstation.Fleet, groundstation.BlockingFleet or groundstation.crazyswarm. It may fail in
any way, or leave without landing; the verdict says what became of the fleet.
"""

from __future__ import annotations

import ast
import asyncio
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from groundstation.crazyswarm.module_names import PROVIDED, crazyswarm_names
from groundstation.flights.mission_flight import clock_say
from groundstation.missions.connection import Host, RealTime, run_script
from groundstation.missions.readiness import NotReady
from groundstation.missions.runner import READY_TIMEOUT_SIM_S
from groundstation.missions.step_runner import first_failure
from groundstation.missions.taken import FleetTaken
from groundstation.orders.result import OrderFailed
from groundstation.processes.fleet_processes import start_fleet
from groundstation.processes.supervisor import Processes
from groundstation.recording.writer import RecordEnd
from groundstation.verdict.expectations import Expect
from groundstation.verdict.final_verdict import final_verdict
from onboard.config.file_reading import SCRIPT, python_tree, read_text
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.exit_status import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_OK
from onboard.plain_text import plain_lines

_ROS = ("rclpy", "rospy", "tf2_ros", "geometry_msgs", "nav_msgs", "sensor_msgs", "std_msgs")

# whose own sentence is enough; others are shown with where they were raised
_TOLD = (ConfigError, FleetTaken, NotReady, OrderFailed, TimeoutError)


class _ScriptEnd(NamedTuple):
    """The end of a script."""

    status: int
    failure: str  # a sentence; empty when nothing went wrong


def refuse_what_is_no_script(path: str) -> None:
    """Refuse a file that cannot be run, before anything starts.

    Raises:
        ConfigError: it cannot be read, is not Python, or is a mission.
    """
    tree = python_tree(read_text(path, SCRIPT), path)
    for node in tree.body:
        if isinstance(node, ast.AsyncFunctionDef) and node.name == "mission":
            raise ConfigError(
                f"{path} is a mission, 'async def mission(fleet)'. Fly it with: covey fly {path}"
            )


def fly_script_in_real_time(
    script: str, arguments: Sequence[str], fleet: FleetConfig, folder: Path
) -> int:
    """Run a script with the agents that run already; return the exit status.

    Args:
        script: path of the Python file.
        arguments: for the script.
        fleet: to connect with.
        folder: of the flight, with its files.
    """
    host = RealTime(fleet, folder=folder, say=clock_say())
    return fly_script(script, arguments, host, folder)


def fly_script_emulated(
    script: str, arguments: Sequence[str], fleet: FleetConfig, folder: Path, seed: int
) -> int:
    """Start emulator and agents, run a script with them, and end them; return the exit status.

    Args:
        script: path of the Python file.
        arguments: for the script.
        fleet: of the file ``fleet.toml`` in the folder.
        folder: of the flight, with its files.
        seed: seed of everything random in the emulator.
    """
    host = RealTime(fleet, folder=folder, say=clock_say())
    host.ready_timeout_s = READY_TIMEOUT_SIM_S
    processes = Processes(folder)
    try:
        start_fleet(fleet, folder, seed, processes)
        return fly_script(script, arguments, host, folder)
    finally:
        asyncio.run(processes.stop())


def fly_script(
    script: str,
    arguments: Sequence[str],
    host: Host,
    folder: Path,
    run_it: Callable[..., None] | None = None,
) -> int:
    """Run a script, print the verdict and the folder; return the exit status.

    Args:
        script: path of the Python file.
        arguments: for the script.
        host: to which the script connects.
        folder: of the flight.
        run_it: runs the script with its arguments, where time is simulated.
    """
    end = _run_to_end(script, arguments, host, run_it)

    if host.flown is None:
        sentence = end.failure
        if not sentence:
            sentence = "The script has connected with no fleet: groundstation.Fleet.connect() does."
        print(plain_lines(f"{script}: {sentence}"), file=sys.stderr)
        return end.status or EXIT_FAILED

    host.flown.failure = end.failure
    host.flown.is_interrupted = end.status == EXIT_INTERRUPTED

    # Whoever flies on has to be declared: a script says so with the state in which it leaves.
    is_up = any(view.is_airborne for view in host.flown.state.vehicles.values())
    may_stay_up = is_up and host.at_end == "hold"
    record_end = host.end_record() or RecordEnd(begin_ns=host.flown.begin_ns)
    expect = Expect(all_landed=not may_stay_up)
    verdict = final_verdict(host.flown, expect, folder, record_end)

    for line in verdict.sentences:
        print(plain_lines(line), flush=True)
    print(f"See it again: covey replay {folder}", flush=True)
    return end.status or verdict.exit_status


def _run_to_end(
    script: str, arguments: Sequence[str], host: Host, run_it: Callable[..., None] | None
) -> _ScriptEnd:
    """Run a script; whatever it raises becomes an exit status and a sentence."""
    try:
        with crazyswarm_names(script):
            if run_it is None:
                run_script(script, arguments, host)
            else:
                run_it(script, *arguments)
    except (KeyboardInterrupt, asyncio.CancelledError):
        return _ScriptEnd(EXIT_INTERRUPTED, "")
    except SystemExit as error:
        return _end_by_exit(error.code)
    except _TOLD as error:
        return _ScriptEnd(EXIT_FAILED, str(error))
    except ExceptionGroup as failures:
        first = first_failure(failures)
        if isinstance(first, _TOLD):
            return _ScriptEnd(EXIT_FAILED, str(first))
        traceback.print_exc()
        return _ScriptEnd(EXIT_FAILED, f"{type(first).__name__}: {first}")
    except ModuleNotFoundError as error:
        return _ScriptEnd(EXIT_FAILED, missing_module_words(error.name or "", script))
    except Exception as error:  # noqa: BLE001 - the script's author sees it; the fleet has been left
        traceback.print_exc()
        return _ScriptEnd(EXIT_FAILED, f"{type(error).__name__}: {error}")
    return _ScriptEnd(EXIT_OK, "")


def missing_module_words(module: str, script: str = "") -> str:
    """Return what to do about a module that a script imports and that is not here.

    Args:
        module: as Python's error names it. Where a whole package is missing, that is the package.
        script: path of the Python file that imports it. It is read for the modules of the package
            that it imports; a path that leads to no file is left unread.
    """
    package = module.partition(".")[0]
    imported = [one for one in _imports_of(script, package) if one not in PROVIDED]
    wanted = imported or [module]

    sentence = f"It imports {' and '.join(wanted)}, which is not installed here."
    if "uav_trajectory" in wanted:
        return f"{sentence} Write: from groundstation.crazyswarm import uav_trajectory"
    if any("cfsim" in one for one in wanted):
        return (
            f"{sentence} cfsim is a Crazyflie's firmware, and is not here: remove that import,"
            " and what uses it."
        )
    if any(one.endswith(".util") for one in wanted):
        return f"{sentence} Write what its functions return into the script."
    if package in ("pycrazyswarm", "crazyflie_py"):
        return f"{sentence} Write: from groundstation.crazyswarm import Crazyswarm"
    if package in _ROS:
        return f"{sentence} It belongs to ROS, without which Covey flies: docs/crazyswarm.md"
    return sentence


def _imports_of(script: str, package: str) -> list[str]:
    """Return the modules of a package that a script imports, with their dots."""
    if not Path(script).is_file():
        return []

    modules: dict[str, None] = {}
    for node in ast.walk(python_tree(read_text(script, SCRIPT), script)):
        if isinstance(node, ast.Import):
            modules |= dict.fromkeys(one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            modules[node.module] = None
    return [one for one in modules if one.partition(".")[0] == package]


def _end_by_exit(code: object) -> _ScriptEnd:
    """Return the end of a script that has called sys.exit(code)."""
    if isinstance(code, int):
        status = int(code)
    elif code is None:
        status = EXIT_OK
    else:  # Python takes any other value as a message
        status = EXIT_FAILED

    if status == EXIT_OK:
        return _ScriptEnd(EXIT_OK, "")
    return _ScriptEnd(status, f"The script has ended with status {code}.")
