"""The processes of a simulated fleet: its routers, one emulator, an agent for each vehicle, and the
node of corrections where the fleet takes some.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from groundstation.processes.free_ports import is_free_endpoint
from groundstation.processes.supervisor import Processes, agent_command, leaves_room
from onboard.config.fleet import FleetConfig

EMULATOR = "sitl"  # name of the emulator's process and of its log
CORRECTIONS = "corrections"  # the same of the node of corrections


def start_fleet(
    fleet: FleetConfig,
    folder: Path,
    seed: int,
    processes: Processes,
    *,
    emulator_options: Sequence[str] = (),
) -> None:
    """Start the processes of the ``fleet.toml`` in a folder.

    All start at once: they find each other in whatever order they come up.

    Args:
        fleet: the fleet of that file.
        folder: the flight's folder, which holds ``fleet.toml``.
        seed: seed of everything random in the emulator.
        processes: gets the processes.
        emulator_options: further words for ``covey sitl``, for instance its weather.

    Raises:
        ProcessError: one of them cannot start.
    """
    path = str(folder / "fleet.toml")

    for number, endpoint in enumerate(fleet.fleet.routers):
        # An endpoint that is taken has a router already, which serves this fleet as well.
        if is_free_endpoint(endpoint):
            words = ["groundstation", "router", path, "--endpoint", endpoint]
            processes.start(f"router{number}", words)

    processes.start(EMULATOR, ["sitl", "--fleet", path, "--seed", str(seed), *emulator_options])

    if fleet.corrections is not None:
        # No real base stands beside emulated vehicles: this one is made up.
        words = ["groundstation", "corrections", "--fleet", path, "--source", "mock"]
        processes.start(CORRECTIONS, words)

    names = fleet.enabled_names
    is_realtime = leaves_room(len(names))
    for name in names:
        processes.start(name, agent_command(path, name, is_realtime=is_realtime))
