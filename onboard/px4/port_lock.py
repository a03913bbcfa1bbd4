"""Ensures that only one agent uses an autopilot's endpoint.

Two programs at one port, or at one serial device, would each get a part of its packets. A lock file
in the temporary folder prevents that. Ports belong to a network namespace, but serial devices do
not: containers that share a temporary folder have separate ports and common serial devices.
"""

from __future__ import annotations

import fcntl
import os
import re
import socket
import tempfile
from pathlib import Path

from onboard.autopilot import LinkError

_NAMESPACE = "/proc/self/ns/net"  # its inode identifies the network namespace, see namespaces(7)


class PortClaim:
    """Claim of an autopilot's endpoint for this process, until :meth:`release`.

    A file lock excludes other agents. Binding the UDP port once detects other programs.
    """

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self._lock_fd: int | None = None  # descriptor of the locked file; None without a claim

    def take(self) -> None:
        """Claim the UDP port, the remote port or the serial device of the endpoint.

        A second call does nothing.

        Raises:
            LinkError: Another process uses the endpoint.
        """
        if self._lock_fd is not None:
            return

        udp = re.fullmatch(r"udpin://(.+):(\d+)", self.endpoint)
        path = Path(tempfile.gettempdir()) / f"covey-{os.getuid()}-{_key(self.endpoint)}.lock"
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if udp is not None:
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.bind((udp[1], int(udp[2])))
        except OSError as error:
            os.close(fd)
            name = self.endpoint
            if udp is not None:
                name = f"UDP port {udp[2]} of {self.endpoint}"
            raise LinkError(
                f"{name} is in use ({error.strerror}). Another agent or ground station is "
                "connected to this autopilot: stop it, or change 'autopilot' of this vehicle in "
                "the fleet file."
            ) from None
        self._lock_fd = fd

    def release(self) -> None:
        """Release the port; a second call does nothing."""
        if self._lock_fd is not None:
            os.close(self._lock_fd)
            self._lock_fd = None


def _key(endpoint: str) -> str:
    """Return a file name for the endpoint's resource.

    The resource is a local port, a remote endpoint, or a serial device at any baud rate.
    """
    kind, _, address = endpoint.partition("://")
    if kind == "udpin":
        return f"udp-{address.rpartition(':')[2]}-{_network_namespace()}"
    if kind.startswith("serial"):
        device, _, rate = address.rpartition(":")
        address = os.path.realpath(device if device and rate.isdigit() else address)
        return _as_file_name(f"{kind}-{address}")
    return _as_file_name(f"{kind}-{address}-{_network_namespace()}")


def _as_file_name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]", "_", text)


def _network_namespace() -> int:
    """Return the number of this process's network namespace; 0 if the kernel has none."""
    try:
        return os.stat(_NAMESPACE).st_ino
    except OSError:
        return 0
