"""One agent per autopilot.

Two programs at one port, or at one serial device, would get some of its packets each. Ports belong
to a network namespace: containers that share a temporary folder have ports of their own each, and
serial devices together.
"""

from __future__ import annotations

import fcntl
import os
import re
import socket
import tempfile
from pathlib import Path

from onboard.autopilot import LinkError

_NAMESPACE = "/proc/self/ns/net"  # namespaces(7): its inode tells namespaces apart


class PortClaim:
    """An autopilot's endpoint that only this process uses, until :meth:`release`.

    A file lock excludes other agents; binding the UDP port once finds other programs.
    """

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self._lock_fd: int | None = None  # descriptor of the locked file; None without a claim

    def take(self) -> None:
        """Claim the UDP port, the remote port or the serial device of the endpoint.

        A second call does nothing.

        Raises:
            LinkError: another process has it.
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
    """Return a file name for the resource.

    It is a local port, a remote endpoint, or a device whatever its baud rate.
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
    """Return the number of this process's network namespace; 0 where the kernel tells none."""
    try:
        return os.stat(_NAMESPACE).st_ino
    except OSError:
        return 0
