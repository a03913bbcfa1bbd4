"""One client per UDP port: MAVSDK binds a taken port without an error and then the clients starve each other."""

from __future__ import annotations

import fcntl
import os
import re
import socket
import tempfile
from pathlib import Path

from onboard.link.autopilot import LinkError


class PortClaim:
    """A UDP port that this process alone listens at, held by a file lock until :meth:`release`.

    The lock finds other agents (their MAVSDK shares the port), binding once finds everybody else.
    """

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self._lock_fd: int | None = None

    def take(self) -> None:
        """Claim the port of ``udpin://HOST:PORT``; other kinds of endpoint need no claim.

        Raises:
            LinkError: somebody else listens there.
        """
        found = re.fullmatch(r"udpin://(.+):(\d+)", self.endpoint)
        if found is None or self._lock_fd is not None:
            return
        host, port = found[1], int(found[2])
        path = Path(tempfile.gettempdir()) / f"covey-{os.getuid()}-udp-{port}.lock"
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind((host, port))
        except OSError as error:
            os.close(fd)
            raise LinkError(
                f"UDP port {port} of {self.endpoint} is taken ({error.strerror}). Another agent or ground station "
                "listens to this autopilot: stop it, or change 'autopilot' of this vehicle in the fleet file."
            ) from None
        self._lock_fd = fd

    def release(self) -> None:
        """Give the port back; a second call does nothing."""
        fd, self._lock_fd = self._lock_fd, None
        if fd is not None:
            os.close(fd)
