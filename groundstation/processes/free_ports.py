"""Copies of a fleet file for another folder or for free ports, and checks of ports in use."""

from __future__ import annotations

import os
import random
import socket
from collections.abc import Iterator
from typing import Any, NamedTuple

import tomli_w

from onboard.config.corrections import beside
from onboard.config.endpoints import LAST_PORT, host_of, is_loopback
from onboard.config.fleet import ConfigError, FleetConfig, LawConfig

# These ports lie below the kernel's range for outgoing connections, so that no connection gets one
# of them by chance.
PORT_RANGE = (20_000, 30_000)
PX4_OFFSET = 40  # an emulated PX4 binds the port of its agent's endpoint plus this

_AGENT_LISTENS = "udpin://"  # the scheme of an endpoint at which the agent waits for PX4
_STREAMS = ("tcp/", "tls/")  # the other protocols of the bus use datagrams


class _UsedPort(NamedTuple):
    """One port that a fleet needs on this machine."""

    key: str  # key of the fleet file
    endpoint: str
    offset: int  # this port minus the port of the endpoint
    kind: socket.SocketKind


def is_free(port: int, kind: socket.SocketKind) -> bool:
    """Return whether a loopback port can be bound now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind == socket.SOCK_STREAM:
            # The bus's listener does so, too. With it a connection of the last flight that is still
            # in TIME_WAIT does not count.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def is_free_endpoint(endpoint: str) -> bool:
    """Return whether the port of an endpoint of the bus on this machine is free now."""
    port = int(endpoint.rsplit(":", 1)[-1])
    return is_free(port, _kind_of(endpoint))


def _kind_of(endpoint: str) -> socket.SocketKind:
    if endpoint.startswith(_STREAMS):
        return socket.SOCK_STREAM
    return socket.SOCK_DGRAM


def port_of_index(first_port: int, index: int) -> int:
    """Return the port of an agent's endpoint, such that no PX4 binds the port of another agent.

    From the first port on, blocks of PX4_OFFSET ports for agents alternate with blocks of as many
    ports for their PX4s.

    Args:
        first_port: the port of index 0.
        index: index of the endpoint, from 0.
    """
    block, number = divmod(index, PX4_OFFSET)
    return first_port + block * 2 * PX4_OFFSET + number


def with_free_ports(data: dict[str, Any], fleet: FleetConfig) -> dict[str, Any]:
    """Return the data of a fleet file with all endpoints on free loopback ports, and without keys.

    All other values are unchanged.

    Args:
        data: content of the fleet file, which is not changed.
        fleet: the fleet of that content.

    Raises:
        ConfigError: there are not enough free ports.
    """
    ports = _free_ports()
    vehicles = {}
    for name, table in data["vehicles"].items():
        vehicle = dict(table)
        vehicle["agent"] = f"tcp/127.0.0.1:{_next(ports)}"
        vehicle["autopilot"] = f"udpin://127.0.0.1:{_next(ports)}"
        if fleet.vehicles[name].mavlink_signing:
            vehicle["mavlink_signing"] = False  # the keys belong to the real vehicles
        if fleet.vehicles[name].direct is not None:
            vehicle["direct"] = f"udpout://127.0.0.1:{_next(ports)}"
        vehicles[name] = vehicle

    section = dict(data["fleet"])
    section["simulator"] = f"tcp/127.0.0.1:{_next(ports)}"
    if fleet.fleet.routers:
        section["routers"] = [f"tcp/127.0.0.1:{_next(ports)}" for _ in fleet.fleet.routers]
    section.pop("keys", None)
    return {**data, "fleet": section, "vehicles": vehicles}


def in_another_folder(data: dict[str, Any], fleet: FleetConfig) -> dict[str, Any]:
    """Return the data of a fleet file for a copy in another folder.

    Files that the fleet file names are not copied: a user's own law, the keys, the files of
    formations, a recording of corrections, the password for a caster. The copy names them by their
    full paths. With a built-in law it names no folder, so that it can be used on another computer
    too.

    Args:
        data: content of the fleet file, which is not changed.
        fleet: the fleet of that content.
    """
    copied = dict(data)
    if "law" in data:
        copied["law"] = _law_elsewhere(data["law"], fleet.path)

    if "formations" in data:
        copied["formations"] = {
            name: _formation_elsewhere(table, fleet.path)
            for name, table in data["formations"].items()
        }

    if "corrections" in data:
        copied["corrections"] = _corrections_elsewhere(data["corrections"], fleet.path)

    has_signing = any(vehicle.mavlink_signing for vehicle in fleet.vehicles.values())
    if fleet.has_keys or has_signing:
        copied["fleet"] = {**data["fleet"], "keys": fleet.keys_folder}
    return copied


def _law_elsewhere(table: dict[str, Any], fleet_path: str) -> dict[str, Any]:
    """Return the table of the law with the full path of its folder, if the law is a user's own."""
    copied = dict(table)
    folder = copied.pop("folder", ".")
    name = copied.get("name", LawConfig().name)
    if LawConfig(name=name).is_own:
        copied["folder"] = os.path.normpath(beside(fleet_path, folder))
    return copied


def _formation_elsewhere(table: dict[str, Any], fleet_path: str) -> dict[str, Any]:
    """Return the table of a formation with full paths of the files that its shape reads."""
    copied = dict(table)
    if "shape" in table:
        for key in ("file", "font"):
            if key in table:
                copied[key] = beside(fleet_path, table[key])
    return copied


def _corrections_elsewhere(table: dict[str, Any], fleet_path: str) -> dict[str, Any]:
    """Return the table of corrections with full paths of its files."""
    copied = dict(table)
    if table.get("source") == "file":
        copied["address"] = beside(fleet_path, str(table["address"]))
    if table.get("password_file"):
        copied["password_file"] = beside(fleet_path, str(table["password_file"]))
    return copied


def is_local(fleet: FleetConfig) -> bool:
    """Return whether all endpoints of a fleet file are loopback addresses.

    Only then may a simulated flight use them.
    """
    endpoints = [fleet.simulator_endpoint, *fleet.fleet.routers]
    for vehicle in fleet.vehicles.values():
        endpoints += [vehicle.agent, vehicle.autopilot]
        if vehicle.direct is not None:
            endpoints.append(vehicle.direct)
    return all(is_loopback(host_of(endpoint)) for endpoint in endpoints)


def busy_ports(fleet: FleetConfig) -> list[str]:
    """Return a sentence for each port of a fleet file that cannot be bound on this machine.

    Another program uses it, or the fleet file gives it to two.
    """
    busy = []
    owners: dict[tuple[str, int, socket.SocketKind], str] = {}  # host, port, kind -> key
    for used in _used_ports(fleet):
        port_text = used.endpoint.rsplit(":", 1)[-1]
        if not port_text.isdigit():
            continue
        port = int(port_text) + used.offset
        protocol = "UDP"
        if used.kind == socket.SOCK_STREAM:
            protocol = "TCP"

        owner = owners.setdefault((host_of(used.endpoint), port, used.kind), used.key)
        if owner != used.key:
            busy.append(
                f"'{used.key}' ({used.endpoint}) needs {protocol} port {port}, which '{owner}'"
                " needs too."
            )
        elif port > LAST_PORT:
            busy.append(
                f"'{used.key}' ({used.endpoint}) needs port {port}, but the last port is"
                f" {LAST_PORT}."
            )
        elif not is_free(port, used.kind):
            busy.append(
                f"'{used.key}' ({used.endpoint}) needs {protocol} port {port}, which is in use."
            )
    return busy


def _used_ports(fleet: FleetConfig) -> list[_UsedPort]:
    """Return all ports that the enabled vehicles and the simulator need."""
    bus = _kind_of(fleet.simulator_endpoint)
    udp = socket.SOCK_DGRAM

    used = [_UsedPort("fleet.simulator", fleet.simulator_endpoint, 0, bus)]
    for name in fleet.enabled_names:
        vehicle = fleet.vehicles[name]
        used.append(_UsedPort(f"vehicles.{name}.agent", vehicle.agent, 0, bus))
        used.append(_UsedPort(f"vehicles.{name}.autopilot", vehicle.autopilot, 0, udp))
        if vehicle.autopilot.startswith(_AGENT_LISTENS):
            used.append(_UsedPort(f"vehicles.{name}.autopilot", vehicle.autopilot, PX4_OFFSET, udp))
        if vehicle.direct is not None:
            used.append(_UsedPort(f"vehicles.{name}.direct", vehicle.direct, 0, udp))
    return used


def _free_ports() -> Iterator[int]:
    """Yield ports that are free for TCP and UDP, and whose port + PX4_OFFSET is free for UDP."""
    low, high = PORT_RANGE
    blocks = list(range((high - low) // (2 * PX4_OFFSET)))
    random.SystemRandom().shuffle(blocks)
    for block in blocks:
        for number in range(PX4_OFFSET):
            port = port_of_index(low, block * PX4_OFFSET + number)
            if (
                is_free(port, socket.SOCK_STREAM)
                and is_free(port, socket.SOCK_DGRAM)
                and is_free(port + PX4_OFFSET, socket.SOCK_DGRAM)
            ):
                yield port


def _next(ports: Iterator[int]) -> int:
    port = next(ports, None)
    if port is None:
        low, high = PORT_RANGE
        raise ConfigError(
            f"There are no free ports between {low} and {high} on 127.0.0.1. Stop what uses them."
        )
    return port


def toml_text(data: dict[str, Any], comment: str = "") -> str:
    """Return a fleet file's data as TOML, below a comment."""
    lines = "".join(f"# {line}\n" for line in comment.splitlines())
    return lines + tomli_w.dumps(data)
