"""Settings of Zenoh for the nodes of the bus, and for its routers. Pure.

Endpoints are explicit, without multicast or gossip scouting: a node connects only to endpoints of
the fleet file.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from onboard.bus.protocol import LEASE_MS, NodeCredentials

Setting = tuple[str, Any]  # path in zenoh's configuration, value

# Times between two attempts to connect.
RETRY = {"period_init_ms": 200, "period_max_ms": 500, "period_increase_factor": 1.5}

# A lease is the silence after which the other end closes a link: LEASE_MS, with two exceptions.

# With several routers, the lease of a router is half as long. A node without its router receives
# nothing, so it must soon notice the loss and change to another router.
ROUTER_LEASE_MS = 500

# Over QUIC the lease is a tenth longer, so that a link survives an outage of one second. The last
# keep-alive may have come up to 0.11 s before the outage.
QUIC_LEASE_MS = 1100
_KEEP_ALIVES = 10  # number sent on a silent link during one lease

# Longest time to open a link: QUIC needs three round trips, TLS four. Over QUIC, nothing refuses an
# attempt to reach an absent node, so the attempt takes all of this time. A node that is closed in
# the meantime waits for the end of the attempt.
_OPEN_MS = 3000

# Longest time to open a link to one of several routers; then the next router is tried.
_ROUTER_OPEN_MS = 500

# Longest round-trip time at which a link can be opened within _OPEN_MS. Three such round trips over
# QUIC leave 1.2 s, enough to repeat a lost first packet; four over TLS leave 0.6 s.
LONGEST_ROUND_TRIP_S = 0.6

# Longest round-trip time at which a link can be opened within _ROUTER_OPEN_MS, with hardly any time
# to spare.
LONGEST_ROUND_TRIP_OF_ROUTERS_S = 0.15
LONGEST_ROUND_TRIP_OF_TLS_ROUTERS_S = 0.12

# A connection to a peer that reads nothing for this time is closed.
_CLOSE_AFTER_US = 1_000_000


def of_node(
    listen: Sequence[str], connect: Sequence[str], credentials: NodeCredentials | None
) -> list[Setting]:
    """Return the settings of a node that is linked with the others directly.

    Args:
        listen: endpoints to listen at.
        connect: endpoints of the others; retried forever, so that nodes may start in any order.
        credentials: credentials of the node; None for a bus without keys.
    """
    return [
        ("mode", "peer"),
        ("listen/endpoints", [_with_datagrams(endpoint) for endpoint in listen]),
        ("connect/endpoints", [_with_datagrams(endpoint) for endpoint in connect]),
        ("connect/timeout_ms", -1),
        *_common(credentials, lease_ms([*listen, *connect])),
    ]


def of_client(
    routers: Sequence[str], timeout_s: float, credentials: NodeCredentials | None
) -> list[Setting]:
    """Return the settings of a node behind routers.

    The node connects to the first router that answers, and to the next router when that link is
    lost. A single router has more time to answer, because there is no alternative.

    Args:
        routers: endpoints, in the order in which they are tried.
        timeout_s: longest search for a router at the start; later searches have no limit.
        credentials: credentials of the node; None for a bus without keys.
    """
    open_ms = _OPEN_MS
    if len(routers) > 1:
        open_ms = _ROUTER_OPEN_MS

    return [
        ("mode", "client"),
        ("connect/endpoints", [_with_datagrams(endpoint) for endpoint in routers]),
        ("connect/timeout_ms", round(1e3 * timeout_s)),
        *_common(credentials, lease_ms(routers)),
        ("transport/unicast/open_timeout", open_ms),  # replaces the common value
    ]


def of_router(
    endpoint: str, others: Sequence[str], credentials: NodeCredentials | None
) -> list[Setting]:
    """Return the settings of a router.

    Args:
        endpoint: endpoint at which it listens.
        others: endpoints of the other routers, to which it connects.
        credentials: credentials of the router; None for a bus without keys, where it passes on
            everything.
    """
    router_lease_ms = lease_ms([endpoint])
    if others:
        router_lease_ms = ROUTER_LEASE_MS

    return [
        ("mode", "router"),
        ("listen/endpoints", [_with_datagrams(endpoint)]),
        ("connect/endpoints", [_with_datagrams(other) for other in others]),
        ("connect/timeout_ms", -1),
        ("timestamping/enabled", False),  # messages have stamps of their own
        *_common(credentials, router_lease_ms),
    ]


def lease_ms(endpoints: Iterable[str]) -> int:
    """Return the silence [ms] after which the other ends close a node's links.

    Args:
        endpoints: endpoints of these links.
    """
    if any(endpoint.startswith("quic/") for endpoint in endpoints):
        return QUIC_LEASE_MS
    return LEASE_MS


def longest_round_trip_s(routers: Sequence[str]) -> float:
    """Return the longest round-trip time [s] at which a link can be opened.

    Args:
        routers: endpoints of the fleet's routers.
    """
    if len(routers) < 2:
        return LONGEST_ROUND_TRIP_S
    if any(endpoint.startswith("tls/") for endpoint in routers):
        return LONGEST_ROUND_TRIP_OF_TLS_ROUTERS_S
    return LONGEST_ROUND_TRIP_OF_ROUTERS_S


def nested(settings: Iterable[Setting]) -> dict[str, Any]:
    """Return settings as one nested object, the form of zenoh's configuration file."""
    whole: dict[str, Any] = {}
    for path, value in settings:
        *tables, last = path.split("/")
        table = whole
        for name in tables:
            table = table.setdefault(name, {})
        table[last] = value
    return whole


def _common(credentials: NodeCredentials | None, link_lease_ms: int) -> list[Setting]:
    """Return the settings that nodes and routers share."""
    drop = "transport/link/tx/queue/congestion_control/drop"
    block = "transport/link/tx/queue/congestion_control/block"
    return [
        *_security(credentials),
        ("connect/exit_on_failure", False),
        ("connect/retry", RETRY),
        ("listen/exit_on_failure", True),
        ("listen/timeout_ms", 0),
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("scouting/delay", 0),
        ("transport/link/tx/lease", link_lease_ms),
        ("transport/link/tx/keep_alive", _KEEP_ALIVES),
        ("transport/unicast/open_timeout", _OPEN_MS),
        # Messages are small, and shared memory would cost threads and memory.
        ("transport/shared_memory/enabled", False),
        # If a peer hangs, its queue becomes full. The publisher then drops the message at once,
        # because it may be the control loop, which must not wait.
        (f"{drop}/wait_before_drop", 0),
        (f"{drop}/max_wait_before_drop_fragments", 0),
        (f"{block}/wait_before_close", _CLOSE_AFTER_US),
    ]


def _with_datagrams(endpoint: str) -> str:
    """Return an endpoint of the fleet file in zenoh's form.

    Over QUIC, messages that may be lost are sent in datagrams and the others in streams
    (``mixed_rel``); other protocols have no such choice.
    """
    if endpoint.startswith("quic/"):
        return f"{endpoint}?mixed_rel=1"
    return endpoint


def _security(credentials: NodeCredentials | None) -> list[Setting]:
    """Return the settings that make both ends of each link prove their identity."""
    if credentials is None:
        return []

    tls = "transport/link/tls"
    if not credentials.certificate:
        # the node can check the others, but not prove its identity; a fleet with keys refuses it
        return [(f"{tls}/root_ca_certificate", credentials.authority)]

    return [
        (f"{tls}/root_ca_certificate", credentials.authority),
        (f"{tls}/enable_mtls", True),
        # All certificates of a fleet expire in the same second, and a fleet in flight must not lose
        # all links then. onboard/security/certificate_times.py says when links end instead.
        (f"{tls}/close_link_on_expiration", False),
        (f"{tls}/listen_certificate", credentials.certificate),
        (f"{tls}/connect_certificate", credentials.certificate),
        (f"{tls}/listen_private_key", credentials.key),
        (f"{tls}/connect_private_key", credentials.key),
        ("access_control", credentials.access),
    ]
