"""Ensures that only one agent uses an autopilot's endpoint.

Two programs at one port or serial device would each get only part of its packets. A lock file in
the temporary folder prevents that, whichever users run the programs. Ports belong to a network
namespace, but serial devices do not. Containers that share a temporary folder have separate ports
but common serial devices.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import socket
import tempfile
from pathlib import Path

from onboard.autopilot import LinkError

_UDP = re.compile(r"udpin://(?P<host>.+):(?P<port>\d+)")
_READABLE_BY_ALL = 0o644  # mode of a lock file
_NAMESPACE = "/proc/self/ns/net"  # its inode identifies the network namespace, see namespaces(7)


class PortClaim:
    """Claim of an autopilot's endpoint for this process, until :meth:`release`.

    A file lock excludes other agents. Briefly binding the UDP port detects other programs.
    """

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self._lock_fd: int | None = None  # descriptor of the locked file; None without a claim

    def take(self) -> None:
        """Claim the UDP port, the remote port or the serial device of the endpoint.

        A second call does nothing.

        Raises:
            LinkError: Another process uses the endpoint, or it cannot be locked.
        """
        if self._lock_fd is not None:
            return

        try:
            fd = _open_lock_file(f"covey-{_key(self.endpoint)}.lock")
        except OSError as error:
            raise LinkError(
                f"{_in_words(self.endpoint)} cannot be locked against other programs ({error}). "
                "Give this user a temporary folder in which it can create files, for instance with "
                "TMPDIR."
            ) from None
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_in_use = _is_bound(self.endpoint)
        except OSError:
            is_in_use = True

        if is_in_use:
            os.close(fd)
            raise LinkError(
                f"{_in_words(self.endpoint)} is in use. Another agent or ground station is "
                "connected to this autopilot: stop it, or change 'autopilot' of this vehicle in "
                "the fleet file."
            )
        self._lock_fd = fd

    def release(self) -> None:
        """Release the port; a second call does nothing."""
        if self._lock_fd is not None:
            os.close(self._lock_fd)
            self._lock_fd = None


def _open_lock_file(name: str) -> int:
    """Open a lock file in the temporary folder, or create it, and return its descriptor.

    Every user can lock the file, because a lock needs no right to write. An existing file is opened
    without O_CREAT: with it, Linux refuses the file of another user (fs.protected_regular).
    """
    path = Path(tempfile.gettempdir()) / name
    flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW
    try:
        return os.open(path, flags)
    except FileNotFoundError:
        pass

    try:
        fd = os.open(path, flags | os.O_CREAT | os.O_EXCL)
    except FileExistsError:  # another process has just created it
        return os.open(path, flags)
    os.fchmod(fd, _READABLE_BY_ALL)  # whatever the umask is
    return fd


def _is_bound(endpoint: str) -> bool:
    """Return whether another socket is bound to the UDP port of an endpoint."""
    udp = _UDP.fullmatch(endpoint)
    if udp is None:
        return False

    host = udp["host"].strip("[]")
    try:
        resolved = socket.getaddrinfo(host, int(udp["port"]), type=socket.SOCK_DGRAM)
        first, *_ = resolved
        family, _, _, _, address = first
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.bind(address)
    except OSError as error:
        # all other errors are reported by the relay when it opens the endpoint
        return error.errno == errno.EADDRINUSE
    except ValueError:  # this cannot be a host name
        return False
    return False


def _in_words(endpoint: str) -> str:
    """Return the resource of an endpoint for a sentence."""
    udp = _UDP.fullmatch(endpoint)
    if udp is None:
        return endpoint
    return f"UDP port {udp['port']} of {endpoint}"


def _key(endpoint: str) -> str:
    """Return a file name for the endpoint's resource.

    The resource is a local port, a remote endpoint, or a serial device at any baud rate.
    """
    kind, _, address = endpoint.partition("://")
    if kind == "udpin":
        _, _, port = address.rpartition(":")
        return f"udp-{port}-{_network_namespace()}"
    if kind.startswith("serial"):
        device, _, rate = address.rpartition(":")
        if not device or not rate.isdigit():
            device = address  # the device without its baud rate
        return _as_file_name(f"{kind}-{os.path.realpath(device)}")
    return _as_file_name(f"{kind}-{address}-{_network_namespace()}")


def _as_file_name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]", "_", text)


def _network_namespace() -> int:
    """Return the number of this process's network namespace; 0 if the kernel has none."""
    try:
        return os.stat(_NAMESPACE).st_ino
    except OSError:
        return 0
