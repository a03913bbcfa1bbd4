"""Which nodes run with which authority: asked over links, because what lies on a disk says nothing
of what runs.

A node that was forgotten when the authority was replaced opens no link with the present keys. So
the certificate of a viewer of each former authority is kept, beside the keys, and used for nothing
but to look who still takes it.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from pathlib import Path

from groundstation.keys.authority import folder_of
from onboard.bus.control_token import WATCHER
from onboard.bus.protocol import NoRouterError, OnAlive
from onboard.bus.session import BusSession
from onboard.config.fleet import FleetConfig
from onboard.security.access_control import access_control
from onboard.security.credentials import Credentials, credentials_of, files_of
from onboard.security.node_roles import NodeRole

WAIT_S = 2.0  # links are tried anew twice a second and more
_POLL_S = 0.05


def keep_former(fleet: FleetConfig) -> None:
    """Keep what is needed to find nodes that run on with the authority that is about to be
    replaced.
    """
    folder, former = folder_of(fleet), _former_folder(fleet)
    files = [folder / name for name in files_of(NodeRole.VIEWER)]
    if not all(file.exists() for file in files):
        return
    kept = former / f"{len(_formers(fleet)) + 1}"
    kept.mkdir(mode=0o700, parents=True, exist_ok=True)
    for file in files:
        shutil.copy2(file, kept / file.name)  # with its mode


def running_authorities(fleet: FleetConfig, wait_s: float = WAIT_S) -> dict[str, str]:
    """Return the nodes that answer, each with the authority that it runs with.

    Args:
        fleet: a fleet with keys; its present ones, at least a viewer's or a ground's, are on this
            computer.
        wait_s: time for all nodes to answer.

    Returns:
        "present" or "former" for each node that answers: vehicles, and the relay or the emulator.
        Who is missing is off, not reached, or has keys that this computer has never had.

    Raises:
        ConfigError: this computer's own keys do not fit.
    """
    has_viewer = (folder_of(fleet) / files_of(NodeRole.VIEWER)[1]).exists()
    present = credentials_of(fleet, NodeRole.VIEWER if has_viewer else NodeRole.GROUND)
    seen: dict[str, str] = {}
    with contextlib.ExitStack() as stack:
        for kept in (None, *_formers(fleet)):
            bus = _watcher(
                fleet, present if kept is None else _kept_credentials(kept, fleet), wait_s
            )
            try:
                bus.start()
            except NoRouterError:
                continue
            stack.callback(bus.stop)
            bus.watch_alive(_note(seen, "present" if kept is None else "former"))
        deadline_s = time.monotonic() + wait_s
        while time.monotonic() < deadline_s and not seen.keys() >= set(fleet.enabled_names):
            time.sleep(_POLL_S)
    nodes = (*fleet.vehicles, NodeRole.MOCAP.value, NodeRole.EMULATOR.value)
    return {node: seen[node] for node in nodes if node in seen}


def _note(seen: dict[str, str], state: str) -> OnAlive:
    def on_alive(node: str, is_alive: bool) -> None:
        if is_alive:
            seen.setdefault(node, state)

    return on_alive


def _kept_credentials(kept: Path, fleet: FleetConfig) -> Credentials:
    authority, certificate, key = (str(kept / name) for name in files_of(NodeRole.VIEWER))
    access = access_control({fleet.namespace: fleet.vehicles}, has_router=bool(fleet.fleet.routers))
    return Credentials(authority, certificate, key, access)


def _watcher(fleet: FleetConfig, credentials: Credentials | None, wait_s: float) -> BusSession:
    return BusSession(
        namespace=fleet.namespace,
        node=f"{WATCHER}-{os.getpid()}",
        connect=[*(vehicle.agent for vehicle in fleet.vehicles.values()), *fleet.pose_endpoints],
        credentials=credentials,
        routers=fleet.fleet.routers,
        router_timeout_s=wait_s,
    )


def _former_folder(fleet: FleetConfig) -> Path:
    return Path(f"{fleet.keys_folder}-former")


def _formers(fleet: FleetConfig) -> list[Path]:
    """Return the folders of former authorities, the newest first."""
    return sorted(
        _former_folder(fleet).glob("[0-9]*"), key=lambda path: int(path.name), reverse=True
    )
