"""Finds out whether a process listens at an endpoint, without regard to its keys.

A process that listens and does not accept a link has other keys.
"""

from __future__ import annotations

import socket

_TIMEOUT_S = 1.0

# A reserved version that no QUIC ever uses. A QUIC server answers it with the versions that it has
# (RFC 9000, section 15; the answer: section 17.2.1).
_NO_VERSION = 0x1A2A3A4A
_LONG_HEADER = 0x80  # bit of the first byte
_MIN_BYTES = 1200  # least size of a first packet of QUIC; a shorter one is not answered
_CONNECTION_IDS = b"\x08doctor--\x08--covey-"  # two connection ids, each after its length
_LARGEST_ANSWER = 2048


def is_listening(endpoint: str) -> bool:
    """Return whether a process listens at an endpoint of the bus.

    Args:
        endpoint: an endpoint of the fleet file: ``quic/HOST:PORT``, ``tls/...`` or ``tcp/...``.
    """
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    try:
        if protocol == "quic":
            return _speaks_quic(host, int(port))
        with socket.create_connection((host, int(port)), _TIMEOUT_S):
            return True
    except OSError:
        return False


def _speaks_quic(host: str, port: int) -> bool:
    """Return whether a packet of an unknown version is answered with a list of versions."""
    first_byte = b"\xc3"  # long header of an Initial packet
    question = first_byte + _NO_VERSION.to_bytes(4, "big") + _CONNECTION_IDS
    family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    with socket.socket(family, kind) as probe:
        probe.settimeout(_TIMEOUT_S)
        probe.connect(address)  # so that the kernel reports a port that is closed
        probe.send(question.ljust(_MIN_BYTES, b"\0"))
        answer = probe.recv(_LARGEST_ANSWER)

    # The answer has a long header and version 0.
    is_long_header = len(answer) > 5 and bool(answer[0] & _LONG_HEADER)
    return is_long_header and answer[1:5] == bytes(4)
