"""Times at which the certificates on this computer expire, read from their files."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import NamedTuple

from onboard.config.fleet import ConfigError, FleetConfig
from onboard.security.certificate_times import longest_required_validity_s
from onboard.security.credentials import files_of
from onboard.security.node_roles import ROUTER, NodeRole

AUTHORITY = "the authority"  # name of the certificate authority in sentences


class CertificateEnd(NamedTuple):
    """End of the validity of a certificate on this computer."""

    node: str  # its holder
    end_s: float  # seconds since 1970

    def left_s(self, now_s: float) -> float:
        """Return the time [s] until the end; negative after it.

        Args:
            now_s: seconds since 1970.
        """
        return self.end_s - now_s


def first_end(fleet: FleetConfig, own: str) -> CertificateEnd | None:
    """Return the certificate on this computer that ends first.

    Args:
        fleet: the fleet file.
        own: node that runs here. Other nodes are also considered if their private key is here.
    Returns:
        the first end among these nodes and the certificate authority; None for a bus without keys,
        or if no certificate can be read.
    """
    if not fleet.has_keys:
        return None

    nodes = [own]
    for node in (*fleet.vehicles, *(role.value for role in NodeRole), ROUTER):
        key = files_of(node).key
        if node != own and os.path.exists(os.path.join(fleet.keys_folder, key)):
            nodes.append(node)

    files: dict[str, str] = {}  # holder of a certificate -> its file
    for node in nodes:
        files[node] = files_of(node).certificate
    files[AUTHORITY] = files_of(own).authority

    ends = []
    for holder, file in files.items():
        end_s = end_of(os.path.join(fleet.keys_folder, file))
        if end_s is not None:
            ends.append(CertificateEnd(holder, end_s))
    return min(ends, key=lambda end: end.end_s, default=None)


def links_left_s(fleets: Sequence[FleetConfig], own: str) -> float | None:
    """Return the time [s] from now after which a node closes all of its links.

    The links stay open after the certificate's end for as long as the longest flight, so that every
    vehicle in flight can land. The caller counts the time by a monotonic clock, since the time of
    day can be set.

    Args:
        fleets: fleets of the node, which has one certificate for all of them.
        own: node that runs here.
    Returns:
        the time; None for a bus without keys, or if no certificate can be read.
    """
    end = first_end(fleets[0], own)
    if end is None:
        return None
    return end.left_s(time.time()) + max(longest_required_validity_s(fleet) for fleet in fleets)


def end_of(path: str) -> float | None:
    """Return the end of a certificate in seconds since 1970; None if it cannot be read.

    Args:
        path: path of a PEM file.
    """
    # Imported here, because it loads ten megabytes that a fleet without keys does not need.
    from onboard.security.certificates import read_certificate

    try:
        return read_certificate(path).not_valid_after_utc.timestamp()
    except ConfigError:
        return None
