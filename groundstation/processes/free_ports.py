"""Copies of a fleet file, in another folder or on ports of their own that meet nothing else on the
machine.
"""

from __future__ import annotations

import os
import random
import socket
from collections.abc import Iterator
from typing import Any

import tomli_w

from onboard.config.endpoints import host_of, is_loopback
from onboard.config.fleet import ConfigError, FleetConfig

# Below the kernel's own range for outgoing connections, so that nobody is handed one of these by
# accident.
PORT_RANGE = (20_000, 30_000)
PX4_OFFSET = 40


def is_free(port: int, kind: socket.SocketKind) -> bool:
    """Whether a loopback port can be bound now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind == socket.SOCK_STREAM:
            # As the bus's listener does it: a connection of the last flight that lingers in
            # TIME_WAIT is no hindrance.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def is_free_endpoint(endpoint: str) -> bool:
    """Whether an endpoint of the bus on this machine can be listened at now."""
    kind = socket.SOCK_STREAM if endpoint.startswith(("tcp/", "tls/")) else socket.SOCK_DGRAM
    return is_free(int(endpoint.rsplit(":", 1)[-1]), kind)


def with_free_ports(data: dict[str, Any], fleet: FleetConfig) -> dict[str, Any]:
    """Return the fleet file's data with every endpoint on a free loopback port, without keys; all
    else stays as it is.

    Args:
        data: the file's content; not changed.
        fleet: the same, resolved.
    Raises:
        ConfigError: no free ports.
    """
    ports = _free_ports()
    vehicles = {}
    for name, table in data["vehicles"].items():
        own = {
            **table,
            "agent": f"tcp/127.0.0.1:{_next(ports)}",
            "autopilot": f"udpin://127.0.0.1:{_next(ports)}",
        }
        if fleet.vehicles[name].mavlink_signing:
            own["mavlink_signing"] = False  # the keys belong to the real vehicles
        if fleet.vehicles[name].direct is not None:
            own["direct"] = f"udpout://127.0.0.1:{_next(ports)}"
        vehicles[name] = own
    section = {**data["fleet"], "simulator": f"tcp/127.0.0.1:{_next(ports)}"}
    if fleet.fleet.routers:
        section["routers"] = [f"tcp/127.0.0.1:{_next(ports)}" for _ in fleet.fleet.routers]
    section.pop("keys", None)
    return {**data, "fleet": section, "vehicles": vehicles}


def in_another_folder(data: dict[str, Any], fleet: FleetConfig) -> dict[str, Any]:
    """Return the data of a fleet file for a copy elsewhere: a law of somebody's own and the keys
    stay where they are.

    Args:
        data: the file's content; not changed.
        fleet: the same, resolved.
    """
    copied = dict(data)
    if "law" in data:
        folder = os.path.join(
            os.path.dirname(os.path.abspath(fleet.path)), data["law"].get("folder", ".")
        )
        copied["law"] = {**data["law"], "folder": folder}
    if fleet.has_keys or any(vehicle.mavlink_signing for vehicle in fleet.vehicles.values()):
        copied["fleet"] = {**data["fleet"], "keys": fleet.keys_folder}
    return copied


def is_local(fleet: FleetConfig) -> bool:
    """Whether every endpoint of a fleet file is of this machine alone, so that a simulated flight
    may use it.
    """
    endpoints = [fleet.simulator_endpoint, *fleet.fleet.routers]
    for vehicle in fleet.vehicles.values():
        endpoints += [
            vehicle.agent,
            vehicle.autopilot,
            *([] if vehicle.direct is None else [vehicle.direct]),
        ]
    return all(is_loopback(host_of(endpoint)) for endpoint in endpoints)


def busy_ports(fleet: FleetConfig) -> list[str]:
    """Return a sentence for each endpoint of a fleet file on this machine that is in use."""
    bus = (
        socket.SOCK_STREAM
        if fleet.simulator_endpoint.startswith(("tcp/", "tls/"))
        else socket.SOCK_DGRAM
    )
    endpoints = [("fleet.simulator", fleet.simulator_endpoint, 0, bus)]
    for name in fleet.enabled_names:
        vehicle = fleet.vehicles[name]
        endpoints.append((f"vehicles.{name}.agent", vehicle.agent, 0, bus))
        for offset in (0, PX4_OFFSET):
            endpoints.append(
                (f"vehicles.{name}.autopilot", vehicle.autopilot, offset, socket.SOCK_DGRAM)
            )
        if vehicle.direct is not None:
            endpoints.append((f"vehicles.{name}.direct", vehicle.direct, 0, socket.SOCK_DGRAM))
    busy = []
    for key, endpoint, offset, kind in endpoints:
        port = endpoint.rsplit(":", 1)[-1]
        if port.isdigit() and not is_free(int(port) + offset, kind):
            protocol = "TCP" if kind == socket.SOCK_STREAM else "UDP"
            busy.append(
                f"'{key}' ({endpoint}) needs {protocol} port {int(port) + offset}, which is in use."
            )
    return busy


def _free_ports() -> Iterator[int]:
    """Yield ports that are free for TCP and UDP, together with the one that an emulated PX4 binds
    beside them.
    """
    low, high = PORT_RANGE
    step = 2 * PX4_OFFSET
    starts = list(range(low, high - step, step))
    random.SystemRandom().shuffle(starts)
    for start in starts:
        for port in range(start, start + PX4_OFFSET):
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
