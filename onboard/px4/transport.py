"""The transport to one autopilot: a UDP socket or a serial device.

Sending never waits. Bytes that cannot be sent at once are lost.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import select
import socket
import struct
import threading
import time
from typing import Protocol

from onboard.config.endpoints import LAST_PORT
from onboard.serial_device import open_serial

Address = tuple[str, int]  # host and port
_LARGEST_BYTES = 65_535  # largest number of bytes received at once
_SOCKET_WAIT = struct.pack("ll", 1, 0)  # one second, as C's struct timeval (s, us)
_SERIAL_WAIT_MS = 200  # short, because closing a serial device does not end a waiting read
_CLOSED = -1  # stands for a closed descriptor

log = logging.getLogger("covey.agent")


class Transport(Protocol):
    """Bytes to and from an autopilot."""

    def receive(self) -> tuple[bytes, Address | None]:
        """Wait for bytes.

        Returns:
            The bytes, and the address of their sender if the transport knows it. After a second
            without bytes, and after :meth:`stop`, they are empty.
        """

    def send(self, data: bytes, address: Address | None) -> bool:
        """Send bytes at once; a transport with several peers needs the address.

        Returns:
            False if the bytes are lost.
        """

    def stop(self) -> None:
        """End a waiting :meth:`receive`, and close."""


def open_transport(endpoint: str) -> Transport:
    """Open an endpoint of the fleet file.

    Args:
        endpoint: ``udpin://HOST:PORT``, ``udpout://HOST:PORT`` or ``serial://DEVICE:BAUD``.
    Raises:
        ValueError: The endpoint is malformed.
        OSError: The endpoint cannot be opened.
    """
    match = re.fullmatch(r"(?P<kind>udpin|udpout)://(?P<host>.+):(?P<port>\d+)", endpoint)
    if match is None:
        return _Serial(endpoint)

    port = int(match["port"])
    if port > LAST_PORT:
        raise ValueError(f"{port} is no port")
    host = match["host"].strip("[]")
    return _Datagrams((host, port), listens=match["kind"] == "udpin")


class _Datagrams:
    """A UDP socket that listens to all senders, or is connected to one address."""

    def __init__(self, address: Address, *, listens: bool) -> None:
        host, port = address
        first, *_ = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        family, _, _, _, resolved = first
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._is_connected = not listens
        try:
            if listens:
                self._socket.bind(resolved)
            else:
                self._socket.connect(resolved)  # the kernel then drops what others send
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _SOCKET_WAIT)
        except OSError:
            self._socket.close()
            raise

    def receive(self) -> tuple[bytes, Address | None]:
        try:
            data, address = self._socket.recvfrom(_LARGEST_BYTES)
        except OSError:  # nothing arrived, the peer does not exist (ICMP), or the socket was closed
            return b"", None
        if self._is_connected or not address:
            return data, None
        return data, address[:2]

    def send(self, data: bytes, address: Address | None) -> bool:
        if address is None and not self._is_connected:
            return False
        try:
            if self._is_connected:
                self._socket.send(data, socket.MSG_DONTWAIT)
            elif address is not None:
                self._socket.sendto(data, socket.MSG_DONTWAIT, address)
        except OSError:
            return False
        return True

    def stop(self) -> None:
        # an error only means that the socket is not connected; a waiting receive still ends
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


class _Serial:
    """A serial device. It is reopened when it comes back after it was unplugged."""

    def __init__(self, endpoint: str) -> None:
        self._endpoint = endpoint
        self._descriptor = open_serial(endpoint)
        # No thread may close or replace the descriptor while another writes to it, because the
        # number of a closed descriptor may belong to another file.
        self._lock = threading.Lock()
        self._is_stopped = False

    def receive(self) -> tuple[bytes, Address | None]:
        descriptor = self._descriptor
        try:
            poll = select.poll()
            poll.register(descriptor, select.POLLIN)
            if not poll.poll(_SERIAL_WAIT_MS):
                return b"", None
            data = os.read(descriptor, _LARGEST_BYTES)
        except BlockingIOError:  # nothing has arrived after all
            return b"", None
        except (OSError, ValueError):  # unplugged; ValueError: closed
            data = b""

        # an unplugged device is readable at all times, and has no bytes
        if not data:
            time.sleep(_SERIAL_WAIT_MS * 1e-3)
            self._open_again()
        return data, None

    def send(self, data: bytes, address: Address | None) -> bool:
        with self._lock:
            try:
                return os.write(self._descriptor, data) == len(data)
            except OSError:
                return False

    def stop(self) -> None:
        self._is_stopped = True
        self._close()

    def _open_again(self) -> None:
        """Open the device again, unless it is still unplugged or this transport was stopped."""
        # close it first, because a device in use comes back under another name
        if self._close():
            log.warning("%s is unplugged", self._endpoint)
        try:
            descriptor = open_serial(self._endpoint)
        except OSError:
            return

        with self._lock:
            is_wanted = not self._is_stopped
            if is_wanted:
                self._descriptor = descriptor
        if is_wanted:
            log.info("%s is plugged in again", self._endpoint)
        else:
            os.close(descriptor)

    def _close(self) -> bool:
        """Close the device; return False if it is already closed."""
        with self._lock:
            descriptor = self._descriptor
            self._descriptor = _CLOSED
        if descriptor == _CLOSED:
            return False
        with contextlib.suppress(OSError):
            os.close(descriptor)
        return True
