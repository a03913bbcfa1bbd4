"""One flight of a script: a Python program that connects with a fleet by itself.

A mission is a function that is called with a connected fleet. A script is a whole program that
connects through groundstation.Fleet, groundstation.BlockingFleet or groundstation.crazyswarm. It
may fail in any way, or end without landing; the verdict tells whether the fleet has landed.
"""

from __future__ import annotations

import ast
import asyncio
import shlex
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from groundstation.crazyswarm.module_names import PROVIDED, crazyswarm_names
from groundstation.flights.mission_flight import clock_say
from groundstation.missions.connection import Host, RealTime, run_script
from groundstation.missions.lasting_output import lasting_output
from groundstation.missions.left_out_awaits import left_out_awaits
from groundstation.missions.readiness import NotReady
from groundstation.missions.runner import READY_TIMEOUT_SIM_S
from groundstation.missions.step_runner import first_failure
from groundstation.missions.taken import FleetTaken
from groundstation.orders.result import OrderFailed
from groundstation.processes.fleet_processes import start_fleet
from groundstation.processes.supervisor import ProcessError, Processes
from groundstation.recording.writer import RecordEnd
from groundstation.verdict.expectations import Expect
from groundstation.verdict.final_verdict import final_verdict
from onboard.config.file_reading import SCRIPT, python_tree, read_text, toml_values
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.exit_status import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_NO_ANSWER,
    EXIT_OK,
    EXIT_WRONG_INPUT,
)
from onboard.plain_text import plain_lines

_ROS = ("rclpy", "rospy", "tf2_ros", "geometry_msgs", "nav_msgs", "sensor_msgs", "std_msgs")

# exceptions whose message is enough for the user; all others are printed with a traceback
_SELF_EXPLANATORY = (ConfigError, FleetTaken, NotReady, OrderFailed, TimeoutError)


class _ScriptEnd(NamedTuple):
    """How a script has ended."""

    status: int  # exit status
    failure: str  # a sentence about what went wrong; empty if nothing did
    is_refused: bool = False  # whether something in it was refused


def refuse_what_is_no_script(path: str) -> None:
    """Refuse a file that cannot be run, before anything starts.

    Raises:
        ConfigError: the file cannot be read, is not Python, or is a mission or a fleet file.
    """
    text = read_text(path, SCRIPT)
    if path.endswith(".toml"):
        if "vehicles" in toml_values(text, path):
            raise ConfigError(
                f"{path} is a fleet file, not a script. Name the script, and the fleet behind "
                f"--fleet: covey fly script SCRIPT --fleet {path}"
            )
        raise ConfigError(f"{path} is a mission, not a script. Fly it with: covey fly {path}")

    tree = python_tree(text, path)
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
        arguments: arguments for the script.
        fleet: the fleet to which the script connects.
        folder: the flight folder with its files.
    """
    host = RealTime(fleet, folder=folder, say=clock_say())
    return fly_script(script, arguments, host, folder)


def fly_script_emulated(
    script: str, arguments: Sequence[str], fleet: FleetConfig, folder: Path, seed: int
) -> int:
    """Start emulator and agents, run a script with them, and end them; return the exit status.

    Args:
        script: path of the Python file.
        arguments: arguments for the script.
        fleet: the fleet of the file ``fleet.toml`` in the folder.
        folder: the flight folder with its files.
        seed: seed of all random numbers of the emulator.

    Raises:
        ConfigError: emulator or agents cannot be started.
    """
    host = RealTime(fleet, folder=folder, say=clock_say())
    host.ready_timeout_s = READY_TIMEOUT_SIM_S
    processes = Processes(folder)
    try:
        start_fleet(fleet, folder, seed, processes)
        return fly_script(script, arguments, host, folder)
    except ProcessError as error:
        raise ConfigError(str(error)) from None
    finally:
        asyncio.run(processes.stop())


@lasting_output()
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
        arguments: arguments for the script.
        host: the host that connects the script with a fleet.
        folder: the flight folder.
        run_it: runs the script with its arguments in simulated time; None: real time.
    """
    end = _run_to_end(script, arguments, host, run_it)

    if host.flown is None:
        sentence = end.failure
        if not sentence:
            sentence = "The script has connected with no fleet: groundstation.Fleet.connect() does."
        if not sentence.startswith(script):
            sentence = f"{script}: {sentence}"
        print(plain_lines(sentence), file=sys.stderr)
        if end.is_refused:
            return EXIT_WRONG_INPUT
        if end.status != EXIT_OK:
            return end.status
        return EXIT_FAILED

    host.flown.failure = end.failure
    host.flown.is_interrupted = end.status == EXIT_INTERRUPTED

    # vehicles may stay in the air only if the script has declared "hold" as its state at the end
    is_up = any(view.is_airborne for view in host.flown.state.vehicles.values())
    may_stay_up = is_up and host.at_end == "hold"
    record_end = host.end_record()
    if record_end is None:  # nothing was recorded
        record_end = RecordEnd(begin_ns=host.flown.begin_ns)
    expect = Expect(all_landed=not may_stay_up)
    verdict = final_verdict(host.flown, expect, folder, record_end)

    for line in verdict.sentences:
        print(plain_lines(line), flush=True)
    if record_end.written or record_end.failure is not None:
        print(f"See it again: covey replay {shlex.quote(str(folder))}", flush=True)
    nobody_answered = end.status == EXIT_FAILED and verdict.exit_status == EXIT_NO_ANSWER
    if end.status != EXIT_OK and not nobody_answered:
        return end.status
    return verdict.exit_status


def _run_to_end(
    script: str, arguments: Sequence[str], host: Host, run_it: Callable[..., None] | None
) -> _ScriptEnd:
    """Run a script; an exception becomes an exit status and a sentence."""
    try:
        with crazyswarm_names(script), left_out_awaits() as left_out:
            if run_it is None:
                run_script(script, arguments, host)
            else:
                run_it(script, *arguments)
    except (KeyboardInterrupt, asyncio.CancelledError):
        return _ScriptEnd(EXIT_INTERRUPTED, "")
    except SystemExit as error:
        return _end_by_exit(error.code)
    except _SELF_EXPLANATORY as error:
        return _ScriptEnd(EXIT_FAILED, str(error), isinstance(error, ConfigError))
    except ExceptionGroup as failures:
        first = first_failure(failures)
        if isinstance(first, _SELF_EXPLANATORY):
            return _ScriptEnd(EXIT_FAILED, str(first))
        traceback.print_exc()
        return _ScriptEnd(EXIT_FAILED, f"{type(first).__name__}: {first}")
    except ModuleNotFoundError as error:
        return _ScriptEnd(EXIT_FAILED, missing_module_words(error.name or "", script))
    except Exception as error:  # noqa: BLE001 - a script can raise anything; its author sees it
        traceback.print_exc()
        return _ScriptEnd(EXIT_FAILED, f"{type(error).__name__}: {error}")
    if left_out:
        return _ScriptEnd(EXIT_FAILED, " ".join(left_out))
    return _ScriptEnd(EXIT_OK, "")


def missing_module_words(module: str, script: str = "") -> str:
    """Return what to do about a module that a script imports and that is not installed.

    Args:
        module: name of the module in Python's error; if a whole package is missing, that is the
            name of the package.
        script: path of the script, which is read to find the modules of that package that it
            imports; if there is no such file, only ``module`` is named.
    """
    package = module.partition(".")[0]
    imported = [name for name in _imports_of(script, package) if name not in PROVIDED]
    wanted = [module]
    if imported:
        wanted = imported

    sentence = f"It imports {' and '.join(wanted)}, which is not installed here."
    if "uav_trajectory" in wanted:
        return f"{sentence} Write: from groundstation.crazyswarm import uav_trajectory"
    if any("cfsim" in name for name in wanted):
        return (
            f"{sentence} cfsim is a Crazyflie's firmware, and is not here: remove that import,"
            " and what uses it."
        )
    if any(name.endswith(".util") for name in wanted):
        return f"{sentence} Write what its functions return into the script."
    if package in ("pycrazyswarm", "crazyflie_py"):
        return f"{sentence} Write: from groundstation.crazyswarm import Crazyswarm"
    if package in _ROS:
        return f"{sentence} It belongs to ROS, without which Covey flies: docs/crazyswarm.md"
    return sentence


def _imports_of(script: str, package: str) -> list[str]:
    """Return the full names of the modules of a package that a script imports."""
    if not Path(script).is_file():
        return []

    modules: dict[str, None] = {}
    for node in ast.walk(python_tree(read_text(script, SCRIPT), script)):
        if isinstance(node, ast.Import):
            modules |= dict.fromkeys(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            modules[node.module] = None
    return [module for module in modules if module.partition(".")[0] == package]


def _end_by_exit(code: object) -> _ScriptEnd:
    """Return the end of a script that has called sys.exit(code)."""
    if isinstance(code, int):
        status = int(code)
    elif code is None:
        status = EXIT_OK
    else:  # any other value is a message, and Python's exit status is 1
        status = EXIT_FAILED

    if status == EXIT_OK:
        return _ScriptEnd(EXIT_OK, "")
    return _ScriptEnd(status, f"The script has ended with status {code}.")
