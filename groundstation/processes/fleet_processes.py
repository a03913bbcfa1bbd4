"""Starts the processes of a simulated fleet.

These are its routers, one emulator, an agent for each vehicle, and the node of corrections if the
fleet has corrections.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from groundstation.processes.free_ports import is_free_endpoint
from groundstation.processes.supervisor import Processes, agent_command, leaves_room
from onboard.config.fleet import FleetConfig

# names of processes and of their logs
EMULATOR = "sitl"
CORRECTIONS = "corrections"  # the node of corrections


def start_fleet(
    fleet: FleetConfig,
    folder: Path,
    seed: int,
    processes: Processes,
    *,
    emulator_options: Sequence[str] = (),
) -> None:
    """Start the processes of the ``fleet.toml`` in a folder.

    All start at once; the order in which they become ready does not matter.

    Args:
        fleet: the fleet of that file.
        folder: the flight folder, which contains ``fleet.toml``.
        seed: seed of all random numbers of the emulator.
        processes: starts and watches the processes.
        emulator_options: further options of ``covey sitl``, for instance its weather.

    Raises:
        ProcessError: one of them cannot start.
    """
    path = str(folder / "fleet.toml")

    for number, endpoint in enumerate(fleet.fleet.routers):
        # If an endpoint is in use, a router runs there already, which serves this fleet, too.
        if is_free_endpoint(endpoint):
            words = ["groundstation", "router", path, "--endpoint", endpoint]
            processes.start(f"router{number}", words, ends_last=True)

    words = ["sitl", "--fleet", path, "--seed", str(seed), *emulator_options]
    processes.start(EMULATOR, words, ends_last=True)

    if fleet.corrections is not None:
        # emulated vehicles have no real base station, so the source is an invented one
        words = ["groundstation", "corrections", "--fleet", path, "--source", "mock"]
        processes.start(CORRECTIONS, words)

    names = fleet.enabled_names
    # with more agents, real-time priority would leave the other processes no time
    is_realtime = leaves_room(len(names))
    for name in names:
        processes.start(name, agent_command(path, name, is_realtime=is_realtime))
