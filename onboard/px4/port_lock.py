"""One agent per autopilot: MAVSDK binds a taken port without an error, and then the clients starve each other."""

from __future__ import annotations

import fcntl
import os
import re
import socket
import tempfile
from pathlib import Path

from onboard.autopilot import LinkError


class PortClaim:
    """An autopilot's endpoint that this process alone uses, held by a file lock until :meth:`release`.

    The lock finds other agents (their MAVSDK shares the port), binding a UDP port once finds everybody else.
    """

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self._lock_fd: int | None = None

    def take(self) -> None:
        """Claim the UDP port, the remote port or the serial device of the endpoint; a second call does nothing.

        Raises:
            LinkError: somebody else has it.
        """
        if self._lock_fd is not None:
            return
        found = re.fullmatch(r"udpin://(.+):(\d+)", self.endpoint)
        path = Path(tempfile.gettempdir()) / f"covey-{os.getuid()}-{_key(self.endpoint)}.lock"
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if found is not None:
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.bind((found[1], int(found[2])))
        except OSError as error:
            os.close(fd)
            what = f"UDP port {found[2]} of {self.endpoint}" if found is not None else self.endpoint
            raise LinkError(
                f"{what} is taken ({error.strerror}). Another agent or ground station "
                "listens to this autopilot: stop it, or change 'autopilot' of this vehicle in the fleet file."
            ) from None
        self._lock_fd = fd

    def release(self) -> None:
        """Give the port back; a second call does nothing."""
        fd, self._lock_fd = self._lock_fd, None
        if fd is not None:
            os.close(fd)


def _key(endpoint: str) -> str:
    """A file name for what can be used once only: a port here, a port there, or a device whatever its baud rate."""
    kind, _, where = endpoint.partition("://")
    if kind == "udpin":
        return f"udp-{where.rpartition(':')[2]}"
    if kind.startswith("serial"):
        device, _, rate = where.rpartition(":")
        where = os.path.realpath(device if device and rate.isdigit() else where)
    return re.sub(r"[^A-Za-z0-9._-]", "_", f"{kind}-{where}")
