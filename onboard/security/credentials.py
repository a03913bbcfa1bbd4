"""A node's certificate and key: files in ``keys/`` beside the fleet file.

``ca.pem`` is the certificate of the fleet's own certificate authority, ``NODE.pem`` is a node's
certificate, and ``NODE.key`` its private key, which never leaves that node's computer. ``covey keys
secure`` makes these files. Before a program opens a node of the bus, it checks the files here and
passes the resulting credentials to the bus.
"""

from __future__ import annotations

import datetime
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from onboard.bus.protocol import OrderSignatures
from onboard.config.endpoints import host_of
from onboard.config.file_reading import KEY_FILE, read_bytes
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.security.access_control import access_control
from onboard.security.certificate_times import longest_required_validity_s
from onboard.security.node_roles import ROUTER, NodeRole
from onboard.security.private_files import refuse_open_to_others


@dataclass(frozen=True, slots=True)
class Credentials:
    """Files of one node, and the access that it grants to other nodes."""

    authority: str  # path of the certificate of the fleet's certificate authority
    certificate: str  # path of the node's certificate
    key: str  # path of the node's private key
    # zenoh's ``access_control``: the messages accepted from the holder of each certificate
    access: dict[str, object]
    # after a certificate expires, links stay open and orders in flight stay valid for this time
    grace_s: float = 0.0

    def order_signatures(self) -> OrderSignatures:
        """Return the object that signs orders of this node, and checks those that it receives."""
        # Imported here, because it loads ten megabytes that a fleet without keys does not need.
        from onboard.security.order_signature import NodeSignatures

        return NodeSignatures(self.authority, self.certificate, self.key, grace_s=self.grace_s)


class NodeFiles(NamedTuple):
    """Names of a node's files in the folder of keys."""

    authority: str  # certificate of the fleet's certificate authority
    certificate: str  # node's own certificate
    key: str  # node's private key


def files_of(node: str) -> NodeFiles:
    """Return the names of a node's files."""
    return NodeFiles(authority="ca.pem", certificate=f"{node}.pem", key=f"{node}.key")


def credentials_of(
    fleet: FleetConfig, node: str, now: datetime.datetime | None = None
) -> Credentials | None:
    """Return a node's credentials; None for a fleet whose bus has no keys.

    Args:
        fleet: the fleet file.
        node: a vehicle's name, or the value of a role.
        now: time at which the certificate must be valid; None: now.
    Returns:
        the credentials; their files exist and match.
    Raises:
        NotYetValidError: a certificate is not valid yet.
        ConfigError: a file is missing, damaged, of another certificate authority, not valid any
            more, or readable by other users.
    """
    if not fleet.has_keys:
        return None

    authority, certificate, key = [os.path.join(fleet.keys_folder, name) for name in files_of(node)]
    for path in (authority, certificate, key):
        if not os.path.isfile(path):
            raise ConfigError(
                f"{path} is missing: {_description(node)} cannot join this fleet's bus. "
                f"Make what is missing with: covey keys secure {fleet.path}"
            )

    refuse_open_to_others(key)

    # Imported here, because it loads ten megabytes that a fleet without keys does not need.
    from onboard.security.certificates import check, check_hosts

    if now is None:
        now = datetime.datetime.now(datetime.UTC)
    check(authority, certificate, key, node, now)
    has_router = bool(fleet.fleet.routers)
    if node == ROUTER or not has_router:  # with routers, nodes connect only to routers
        check_hosts(certificate, node, hosts_of(fleet, node))

    access = access_control({fleet.namespace: fleet.vehicles}, has_router=has_router)
    return Credentials(
        authority=authority,
        certificate=certificate,
        key=key,
        access=access,
        grace_s=longest_required_validity_s(fleet),
    )


def router_credentials(fleets: Sequence[FleetConfig]) -> Credentials | None:
    """Return the credentials of a router, which has one certificate for all of its fleets.

    Args:
        fleets: fleets whose messages the router forwards.
    Returns:
        the credentials, with the access control of all fleets; None for fleets without keys.
    Raises:
        ConfigError: a file is missing or does not match, or one certificate cannot serve all
            fleets.
    """
    first_fleet = fleets[0]
    first = credentials_of(first_fleet, ROUTER)

    for fleet in fleets[1:]:
        other = credentials_of(fleet, ROUTER)
        if _authority_bytes(first) != _authority_bytes(other):
            raise ConfigError(
                f"{first_fleet.path} and {fleet.path} have different authorities, and a router "
                "shows one certificate. Run a router for each, or let both fleets use one folder "
                "of keys: [fleet] keys = ..."
            )
        shared_names = sorted(first_fleet.vehicles.keys() & fleet.vehicles.keys())
        if first is not None and shared_names:
            raise ConfigError(
                f"{first_fleet.path} and {fleet.path} both have a vehicle '{shared_names[0]}': one "
                "certificate would be both. Give one of them another name, or run a router for "
                "each fleet."
            )

    if first is None:
        return None
    vehicles = {fleet.namespace: fleet.vehicles for fleet in fleets}
    return replace(first, access=access_control(vehicles, has_router=True))


def _authority_bytes(credentials: Credentials | None) -> bytes | None:
    """Return the certificate of the authority; None for a fleet without keys."""
    if credentials is None:
        return None
    return read_bytes(credentials.authority, KEY_FILE._replace(words="certificate"))


def hosts_of(fleet: FleetConfig, node: str) -> list[str]:
    """Return the addresses where other nodes connect to a node. Nodes do not connect to a ground.

    Args:
        fleet: the fleet file.
        node: a vehicle's name, or the value of a role.
    """
    if node in fleet.vehicles:
        return [fleet.vehicles[node].host]
    if node in (NodeRole.MOCAP, NodeRole.EMULATOR):
        return [host_of(fleet.simulator_endpoint)]
    if node == ROUTER:
        return list(dict.fromkeys(host_of(endpoint) for endpoint in fleet.fleet.routers))
    return []


def _description(node: str) -> str:
    """Return a node in words, for the middle of a sentence."""
    descriptions: dict[str, str] = {
        NodeRole.GROUND.value: (
            "a ground that orders (one with keys/viewer.pem only may watch: --readonly)"
        ),
        NodeRole.VIEWER.value: "a ground that only watches",
        NodeRole.MOCAP.value: "the relay of the motion capture",
        NodeRole.CORRECTIONS.value: "the node of corrections",
        NodeRole.EMULATOR.value: "the emulator",
        ROUTER: "a router",
    }
    return descriptions.get(node, f"the agent of {node}")
