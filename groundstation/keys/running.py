"""Finds out with which authority each running node runs.

This needs links to the nodes, because the files on a disk do not tell which keys a process has
loaded. A node that was forgotten when the authority was replaced opens no link with the present
keys. Therefore a viewer's certificate of each former authority is kept beside the keys. It is used
only to find nodes that still accept it.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from pathlib import Path

from groundstation.keys.authority import folder_of
from groundstation.keys.key_folder import make_key_folder
from onboard.bus.control_token import WATCHER
from onboard.bus.protocol import NoRouterError, OnAlive
from onboard.bus.session import BusSession
from onboard.config.fleet import FleetConfig
from onboard.security.access_control import access_control
from onboard.security.credentials import Credentials, credentials_of, files_of
from onboard.security.node_roles import NodeRole

WAIT_S = 2.0  # enough for several attempts, since links are tried twice a second or more often


def keep_former(fleet: FleetConfig) -> None:
    """Keep the viewer's certificate of the authority that is about to be replaced.

    With it :func:`running_authorities` finds nodes that still run with that authority.
    """
    folder = folder_of(fleet)
    files = [folder / name for name in files_of(NodeRole.VIEWER)]
    if not all(file.exists() for file in files):
        return

    newest_first = _former_authorities(fleet)
    number = 1
    if newest_first:
        number = int(newest_first[0].name) + 1

    former_folder = _former_folder(fleet) / str(number)
    make_key_folder(_former_folder(fleet))
    former_folder.mkdir(mode=0o700, exist_ok=True)
    for file in files:
        shutil.copy2(file, former_folder / file.name)  # copies the permissions, too


def running_authorities(fleet: FleetConfig, wait_s: float = WAIT_S) -> dict[str, str]:
    """Return the nodes that answer, each with the authority with which it runs.

    Args:
        fleet: a fleet with keys; the present keys of a viewer or a ground are on this computer.
        wait_s: time for all nodes to answer.

    Returns:
        node -> "present" or "former", for all nodes that answer: vehicles, the mocap relay and the
        emulator. A missing node is off, cannot be reached, or has keys that this computer has never
        had.

    Raises:
        ConfigError: this computer's own keys are not valid.
    """
    own_role = NodeRole.GROUND
    _, viewer_certificate, _ = files_of(NodeRole.VIEWER)
    if (folder_of(fleet) / viewer_certificate).exists():
        own_role = NodeRole.VIEWER
    present = credentials_of(fleet, own_role)

    # The present authority is tried first, and the first one with which a node answers counts.
    seen: dict[str, str] = {}
    with contextlib.ExitStack() as stack:
        _watch(fleet, present, "present", seen, stack, wait_s)
        for former_folder in _former_authorities(fleet):
            _watch(fleet, _kept_credentials(former_folder, fleet), "former", seen, stack, wait_s)

        # Always wait the whole time, because a mocap relay or an emulator may or may not run.
        time.sleep(wait_s)

    nodes = (*fleet.vehicles, NodeRole.MOCAP.value, NodeRole.EMULATOR.value)
    return {node: seen[node] for node in nodes if node in seen}


def _watch(
    fleet: FleetConfig,
    credentials: Credentials | None,
    authority: str,
    seen: dict[str, str],
    stack: contextlib.ExitStack,
    wait_s: float,
) -> None:
    """Open links with the keys of one authority, and note the nodes that answer.

    Args:
        fleet: the fleet of the nodes.
        credentials: credentials of the authority.
        authority: "present" or "former".
        seen: the nodes that answer are added here, unless they are there already.
        stack: closes the links at its end.
        wait_s: time for a router to answer.
    """
    bus = BusSession(
        namespace=fleet.namespace,
        node=f"{WATCHER}-{os.getpid()}",
        connect=[*(vehicle.agent for vehicle in fleet.vehicles.values()), *fleet.pose_endpoints],
        credentials=credentials,
        routers=fleet.fleet.routers,
        router_timeout_s=wait_s,
    )
    try:
        bus.start()
    except NoRouterError:
        return
    stack.callback(bus.stop)
    bus.watch_alive(_noted(seen, authority))


def _noted(seen: dict[str, str], authority: str) -> OnAlive:
    def on_alive(node: str, is_alive: bool) -> None:
        if is_alive:
            seen.setdefault(node, authority)

    return on_alive


def _kept_credentials(former_folder: Path, fleet: FleetConfig) -> Credentials:
    """Return the credentials of a viewer of a former authority."""
    authority, certificate, key = (str(former_folder / name) for name in files_of(NodeRole.VIEWER))
    access = access_control({fleet.namespace: fleet.vehicles}, has_router=bool(fleet.fleet.routers))
    return Credentials(authority, certificate, key, access)


def _former_folder(fleet: FleetConfig) -> Path:
    return Path(f"{fleet.keys_folder}-former")


def _former_authorities(fleet: FleetConfig) -> list[Path]:
    """Return the folders of former authorities, the newest first.

    A folder that lacks a file is left out, because its copying was interrupted.
    """
    folders = []
    for path in _former_folder(fleet).glob("[0-9]*"):
        is_whole = all((path / name).exists() for name in files_of(NodeRole.VIEWER))
        if path.name.isdecimal() and is_whole:
            folders.append(path)
    return sorted(folders, key=lambda path: int(path.name), reverse=True)
