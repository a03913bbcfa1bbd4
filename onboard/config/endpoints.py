"""Parses endpoints of the fleet file: host, port, and whether other computers reach it. Pure."""

from __future__ import annotations

import ipaddress

LAST_PORT = 65_535


def host_of(endpoint: str) -> str:
    """Return the name or address in an endpoint.

    Args:
        endpoint: an endpoint, for instance ``quic/10.0.0.11:7460`` or ``udpin://127.0.0.1:14540``.
    """
    _, _, address = endpoint.partition("/")
    host, _, _ = address.lstrip("/").rpartition(":")
    return host


def split_host_and_port(address: str) -> tuple[str, int]:
    """Return the host and the port of ``HOST:PORT``; an IPv6 address without its brackets.

    Args:
        address: a checked address of the fleet file.
    """
    host, _, port = address.rpartition(":")
    return host.strip("[]"), int(port)


def is_loopback(host: str) -> bool:
    """Whether a host name or address means this computer only.

    Args:
        host: name or address, an IPv6 address with or without its brackets.
    """
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def is_on_network(endpoint: str) -> bool:
    """Whether other computers can reach an endpoint: it is neither a serial device nor a loopback
    address.

    Args:
        endpoint: an endpoint of the fleet file.
    """
    return not endpoint.startswith("serial://") and not is_loopback(host_of(endpoint))
