"""Asks for what an emulated PX4 does not have: missions, a shell, logs, files. Each has to end, and
soon.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable
from typing import Any

from mavsdk.asyncio import ComponentType
from mavsdk.asyncio.plugins.ftp import FtpAsync
from mavsdk.asyncio.plugins.log_files import LogFilesAsync
from mavsdk.asyncio.plugins.mission_raw import MissionItem, MissionRawAsync
from mavsdk.asyncio.plugins.shell import ShellAsync
from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.shell import Device
from vehicle import connected, first, run


async def refused(endpoint: str, seen: dict[str, Any]) -> None:
    """One after the other."""
    _client, system = await connected(endpoint, ComponentType.GROUND_STATION)
    mission = MissionRawAsync(system)
    shell = ShellAsync(system)
    waypoint = MissionItem(
        frame=6, command=16, current=1, autocontinue=1, x=473977420, y=85455940, z=5.0
    )
    await _try(seen, "upload", mission.upload_mission([waypoint]))
    await _try(seen, "download", mission.download_mission())
    await _try(
        seen,
        "geofence",
        mission.upload_geofence([MissionItem(frame=5, command=5003, mission_type=1)]),
    )
    await _try(seen, "start", mission.start_mission())
    await _try(seen, "clear", mission.clear_mission())
    await _try(seen, "shell", shell.send("ver all\n", Device.SHELL))
    await _try(seen, "shell_answer", first(shell.subscribe_receive(), 1.0))
    await _try(seen, "logs", LogFilesAsync(system).get_entries())
    await _try(seen, "files", FtpAsync(system).list_directory("/"))


async def _try(seen: dict[str, Any], what: str, attempt: Awaitable[Any]) -> None:
    begin_s = time.monotonic()
    try:
        await asyncio.wait_for(attempt, 20)
        outcome = "done"
    except MavsdkError as error:
        outcome = str(error).split(";")[0]
    except TimeoutError:
        outcome = "silence"
    seen[what] = [outcome, round(time.monotonic() - begin_s, 2)]


run(refused)
