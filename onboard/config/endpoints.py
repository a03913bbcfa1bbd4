"""Parses endpoints of the fleet file: host, port or serial device, and whether other computers
reach it. Pure.
"""

from __future__ import annotations

import ipaddress
import re
import termios

LAST_PORT = 65_535
THIS_COMPUTER = "127.0.0.1"
_EVERY_NETWORK = ("0.0.0.0", "::")  # a listener there has the port at all addresses of its computer
_SERIAL = "serial://"
_LABEL = re.compile(r"[A-Za-z0-9_-]{1,63}")  # part of a host name between two dots


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


def is_host(host: str) -> bool:
    """Whether a text is a host name, an IPv4 address, or an IPv6 address in brackets.

    Args:
        host: the part of an endpoint before the port.
    """
    labels = host.split(".")
    is_number = labels[-1].isdecimal()  # the name of a host does not end in a number
    if not is_number and not host.startswith("["):
        return all(_LABEL.fullmatch(label) for label in labels)

    address = host
    if host.startswith("[") and host.endswith("]"):
        address = host[1:-1]
    try:
        version = ipaddress.ip_address(address).version
    except ValueError:
        return False
    return (version == 6) == host.startswith("[")


def canonical_host(host: str) -> str:
    """Return the one spelling of a host that has several: small letters, and an address as such.

    Args:
        host: name or address, an IPv6 address with or without its brackets.
    """
    if host.lower() == "localhost":
        return THIS_COMPUTER
    try:
        return str(ipaddress.ip_address(host.strip("[]")))
    except ValueError:
        return host.lower()


def do_overlap(one: str, two: str) -> bool:
    """Whether one port at two hosts of a computer is the same port.

    Args:
        one: a host, from :func:`canonical_host`.
        two: another host.
    """
    return one == two or one in _EVERY_NETWORK or two in _EVERY_NETWORK


def split_serial(endpoint: str) -> tuple[str, int]:
    """Return the device of ``serial://DEVICE:BAUD``, and its speed as termios has it.

    Args:
        endpoint: endpoint of the fleet file.
    Raises:
        ValueError: The endpoint has another form, or the computer has no such speed.
    """
    device, _, baud = endpoint.removeprefix(_SERIAL).rpartition(":")
    speed: int | None = None
    if baud.isdecimal():  # termios has a constant for each possible speed; B0 hangs up instead
        speed = getattr(termios, f"B{baud}", None)
    if not endpoint.startswith(_SERIAL) or not device or not speed:
        raise ValueError(
            f"'{endpoint}' is no serial endpoint; write it as serial:///dev/ttyAMA0:921600"
        )
    return device, speed


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
    return not endpoint.startswith(_SERIAL) and not is_loopback(host_of(endpoint))
