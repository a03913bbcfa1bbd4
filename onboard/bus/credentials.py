"""A node's certificate and key: files in ``keys/`` beside the fleet file, checked before the bus is
opened.

``ca.pem`` is the fleet's own authority, ``NODE.pem`` a node's certificate, ``NODE.key`` its private
key, which never leaves the computer of that node. ``covey secure`` makes them.
"""

from __future__ import annotations

import datetime
import os
import stat
from dataclasses import dataclass

from onboard.bus.roles import ROUTER, Role, access_control
from onboard.config.endpoints import host_of
from onboard.config.fleet import ConfigError, FleetConfig

_REMEDY = "Make what is missing with: covey secure {fleet}"


@dataclass(frozen=True, slots=True)
class Credentials:
    """Files of one node, and what may come in from whom."""

    authority: str
    certificate: str
    key: str
    access: dict[str, object]


def files_of(node: str) -> tuple[str, str, str]:
    """Return the files of a node: authority, certificate, private key."""
    return "ca.pem", f"{node}.pem", f"{node}.key"


def credentials_of(
    fleet: FleetConfig, node: str, now: datetime.datetime | None = None
) -> Credentials | None:
    """Return a node's credentials; None for a fleet whose bus has no keys.

    Args:
        fleet: the fleet file.
        node: a vehicle's name, or the value of a role.
        now: time at which the certificate must be valid; by default this computer's.
    Returns:
        paths of files that exist and fit together.
    Raises:
        ConfigError: a file is missing, damaged, of another authority, not valid now, or open to
            others.
    """
    if not fleet.has_keys:
        return None
    authority, certificate, key = (os.path.join(fleet.keys_folder, name) for name in files_of(node))
    remedy = _REMEDY.format(fleet=fleet.path)
    for path in (authority, certificate, key):
        if not os.path.isfile(path):
            raise ConfigError(
                f"{path} is missing: {_who(node)} cannot join this fleet's bus. {remedy}"
            )
    mode = stat.S_IMODE(os.stat(key).st_mode)
    if mode & 0o077:
        raise ConfigError(
            f"{key} can be read by other users of this computer (mode {mode:o}). Run: chmod 600 {key}"
        )
    # ten megabytes, which a fleet without keys need not have
    from onboard.bus.certificates import check, check_hosts

    check(authority, certificate, key, node, now or datetime.datetime.now(datetime.UTC))
    if not fleet.fleet.routers or node == ROUTER:  # behind a router the others need not reach it
        check_hosts(certificate, node, hosts_of(fleet, node))
    access = access_control({fleet.namespace: fleet.vehicles}, has_router=bool(fleet.fleet.routers))
    return Credentials(authority, certificate, key, access)


def hosts_of(fleet: FleetConfig, node: str) -> list[str]:
    """Return the addresses at which others reach a node; a ground is reached by nobody.

    Args:
        fleet: the fleet file.
        node: a vehicle's name, or the value of a role.
    """
    simulator = host_of(fleet.simulator_endpoint)
    routers = list(dict.fromkeys(map(host_of, fleet.fleet.routers)))
    hosts = {Role.MOCAP.value: [simulator], Role.EMULATOR.value: [simulator], ROUTER: routers}
    return [fleet.vehicles[node].host] if node in fleet.vehicles else hosts.get(node, [])


def _who(node: str) -> str:
    roles = {
        Role.GROUND: "a ground that orders (one with keys/viewer.pem only may watch: --readonly)",
        Role.VIEWER: "a ground that only watches",
        Role.MOCAP: "the relay of the motion capture",
        Role.EMULATOR: "the emulator",
        ROUTER: "a router",
    }
    return next((words for role, words in roles.items() if role == node), f"the agent of {node}")
