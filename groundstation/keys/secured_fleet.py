"""Gives keys to a fleet's bus (``covey keys secure``).

It makes the authority and the certificates of nodes that are missing, and turns the endpoints in
the fleet file into ``quic/`` endpoints.
"""

from __future__ import annotations

import datetime
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from groundstation.keys.authority import (
    AUTHORITY_KEY,
    CertificateAuthority,
    folder_of,
    has_authority_key,
    issue,
    load_authority,
    make_authority,
    nodes_of,
)
from groundstation.keys.key_folder import make_key_folder
from groundstation.keys.running import keep_former
from groundstation.starter.fleet_edit import edited, write_changes
from onboard.config.example_files import EXAMPLES
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping, load_fleet
from onboard.security.credentials import credentials_of, files_of, hosts_of

_PLAIN = ("tcp/", "udp/")  # protocols without keys


def secure_fleet(path: str, now: datetime.datetime) -> FleetConfig:
    """Make missing keys, and change the endpoints of the fleet file; a second call changes nothing.

    Args:
        path: path of the fleet file, which is changed; its comments remain.
        now: present time, from which the certificates are valid.

    Returns:
        The changed fleet.

    Raises:
        ConfigError: the fleet file is wrong, is an example, or cannot be written; or the
            certificate of the authority is lost, or a key or certificate is not valid.
    """
    plain = load_fleet(path)
    refuse_example(plain)

    changes = _changes(plain)
    text = edited(plain.text, changes)
    secured = fleet_from_mapping(tomllib.loads(text), path=plain.path, text=text)

    _issue_missing(secured, now)
    if changes:
        write_changes(Path(plain.path), changes)
    return secured


def _issue_missing(fleet: FleetConfig, now: datetime.datetime) -> None:
    """Issue the missing certificates; if there are no keys at all, make an authority and issue all.

    Raises:
        ConfigError: there are keys, but the certificate of their authority was lost, or one of
            them is not valid.
    """
    folder = folder_of(fleet)
    authority_file = folder / "ca.pem"
    has_authority = authority_file.exists()
    if not has_authority and has_issued(fleet):
        raise ConfigError(
            f"{authority_file} is missing, but other keys of this fleet are there. A new authority"
            " would lock out every vehicle that has its keys already. Copy ca.pem back from the"
            f" keys of any vehicle, or begin anew: covey keys init {fleet.path} --force"
        )

    if not has_authority:
        authority = make_authority(folder, fleet.fleet.name, now)
        issue_all(fleet, authority, nodes_of(fleet), now)
        return

    missing = []
    for node in nodes_of(fleet):
        has_certificate = (folder / f"{node}.pem").exists()
        has_key = (folder / f"{node}.key").exists()
        if has_certificate and has_key:
            credentials_of(fleet, node, now)  # refuses files that do not fit
        else:
            missing.append(node)

    has_authority_key(fleet)  # refuses a key that does not fit
    if missing:
        issue_all(fleet, load_authority(fleet), missing, now)


def has_issued(fleet: FleetConfig) -> bool:
    """Return whether the folder of the keys has a file of an authority or of any node."""
    folder = folder_of(fleet)
    names = ["ca.pem", AUTHORITY_KEY]
    for node in nodes_of(fleet):
        names += [f"{node}.pem", f"{node}.key"]
    return any((folder / name).exists() for name in names)


def copied_files(fleet: FleetConfig, node: str) -> list[str]:
    """Return the files that a node's computer needs, as paths relative to the fleet file."""
    return [f"{fleet.fleet.keys}/{file}" for file in files_of(node)]


def renew_authority(fleet: FleetConfig, now: datetime.datetime) -> list[str]:
    """Make a new authority and reissue the certificates of all nodes.

    The former files are no longer valid. A viewer's certificate of the former authority is kept,
    to find nodes that still run with it.

    Args:
        fleet: the fleet.
        now: present time, from which the certificates are valid.

    Returns:
        The names of the nodes.
    """
    nodes = nodes_of(fleet)
    keep_former(fleet)
    authority = make_authority(folder_of(fleet), fleet.fleet.name, now)
    issue_all(fleet, authority, nodes, now)
    return nodes


def issue_all(
    fleet: FleetConfig,
    authority: CertificateAuthority,
    nodes: Sequence[str],
    now: datetime.datetime,
) -> None:
    """Issue the certificates of some nodes.

    Args:
        fleet: the fleet file, with the addresses of the nodes.
        authority: the authority that signs them.
        nodes: names of vehicles and roles.
        now: present time, from which they are valid.

    Raises:
        ConfigError: there is no such node; no certificate was issued.
    """
    known = nodes_of(fleet)
    for node in nodes:
        if node not in known:
            raise ConfigError(
                f"'{node}' is no node of {fleet.path}. Its nodes: {', '.join(known)}."
            )
    folder = folder_of(fleet)
    make_key_folder(folder)  # a folder of an older version has no .gitignore
    for node in nodes:
        issue(folder, authority, node, hosts_of(fleet, node), now)


def refuse_example(fleet: FleetConfig) -> None:
    """Refuse to make keys beside an example.

    Raises:
        ConfigError: the fleet file is an example that is installed with Covey.
    """
    if Path(fleet.path).resolve().is_relative_to(Path(EXAMPLES).resolve()):
        raise ConfigError(
            f"{fleet.path} is an example that is installed with Covey."
            " Copy it, and secure the copy."
        )


def _changes(fleet: FleetConfig) -> dict[str, Any]:
    """Return the changes of the fleet file, as nested tables."""
    changes: dict[str, Any] = {}

    agents = {name: _with_keys(vehicle.agent) for name, vehicle in fleet.vehicles.items()}
    if any(endpoint != fleet.vehicles[name].agent for name, endpoint in agents.items()):
        changes["vehicles"] = {name: {"agent": endpoint} for name, endpoint in agents.items()}

    section: dict[str, Any] = {}
    simulator = fleet.fleet.simulator
    if simulator is not None and simulator.startswith(_PLAIN):
        section["simulator"] = _with_keys(simulator)
    if any(endpoint.startswith(_PLAIN) for endpoint in fleet.fleet.routers):
        section["routers"] = [_with_keys(endpoint) for endpoint in fleet.fleet.routers]
    if section:
        changes["fleet"] = section
    return changes


def _with_keys(endpoint: str) -> str:
    if not endpoint.startswith(_PLAIN):
        return endpoint
    return f"quic/{endpoint.partition('/')[2]}"
