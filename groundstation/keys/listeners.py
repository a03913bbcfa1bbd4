"""Whether somebody listens at an endpoint at all, whatever keys it has: who does, and takes no
link, has other ones.
"""

from __future__ import annotations

import socket

_TIMEOUT_S = 1.0
# RFC 9000, 15: one that no QUIC ever has, to which each names those that it has
_NO_VERSION = 0x1A2A3A4A
_LEAST_BYTES = 1200  # of a first packet of QUIC; a shorter one is not answered
_IDS = b"\x08doctor--\x08--covey-"


def is_listening(endpoint: str) -> bool:
    """Whether somebody listens at an endpoint of the bus.

    Args:
        endpoint: as in the fleet file, ``quic/HOST:PORT``, ``tls/...`` or ``tcp/...``.
    """
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    try:
        if protocol != "quic":
            with socket.create_connection((host.strip("[]"), int(port)), _TIMEOUT_S):
                return True
        return _speaks_quic(host.strip("[]"), int(port))
    except OSError:
        return False


def _speaks_quic(host: str, port: int) -> bool:
    family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    with socket.socket(family, kind) as asking:
        asking.settimeout(_TIMEOUT_S)
        asking.connect(address)  # so that a port that is closed is heard of
        asking.send((b"\xc3" + _NO_VERSION.to_bytes(4, "big") + _IDS).ljust(_LEAST_BYTES, b"\0"))
        answer = asking.recv(2048)
    return len(answer) > 5 and bool(answer[0] & 0x80) and answer[1:5] == bytes(4)
