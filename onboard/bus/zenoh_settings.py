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

# Of a node or router with several routers to choose from: half of LEASE_MS. Without its router a
# node hears nobody, so it changes over soon.
ROUTER_LEASE_MS = 500

# Over QUIC a link that was closed is opened anew at once; when that first packet is lost, too, the
# next one follows a second later. So a link is closed a little after an outage of a second is over,
# not at its very end: as often as keep-alives come, that is between 0.99 s and 1.10 s of silence.
QUIC_LEASE_MS = 1100
_KEEP_ALIVES = 10  # of a silent link, in one lease

# Time to open a link: QUIC needs three round trips, TLS four. Over QUIC a node that is not there
# refuses nothing, so an attempt to reach it, and the end of a node that makes one, take this long.
_OPEN_MS = 3000

# The same where there are several routers: the next one is tried after it.
_ROUTER_OPEN_MS = 500

# Round trips over which links open, with half of the time to spare over QUIC.
LONGEST_ROUND_TRIP_S = 0.6
LONGEST_ROUND_TRIP_OF_ROUTERS_S = 0.15

# A connection to a peer that takes nothing for so long is closed.
_CLOSE_AFTER_US = 1_000_000


def of_node(
    listen: Sequence[str], connect: Sequence[str], credentials: NodeCredentials | None
) -> list[Setting]:
    """Return the settings of a node that is linked with the others directly.

    Args:
        listen: endpoints to listen at.
        connect: endpoints of the others; retried for ever, so that the order of starting does not
            matter.
        credentials: of the node; None for a bus without keys.
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

    It is linked with the first router that answers; when that one is lost, with the next. A single
    router is given more time, since there is nobody else to try.

    Args:
        routers: endpoints, in the order in which they are tried.
        timeout_s: to find one at the start; one that is lost later is looked for for ever.
        credentials: of the node; None for a bus without keys.
    """
    open_ms = _OPEN_MS
    if len(routers) > 1:
        open_ms = _ROUTER_OPEN_MS

    return [
        ("mode", "client"),
        ("connect/endpoints", [_with_datagrams(endpoint) for endpoint in routers]),
        ("connect/timeout_ms", round(1e3 * timeout_s)),
        *_common(credentials, lease_ms(routers)),
        ("transport/unicast/open_timeout", open_ms),
    ]


def of_router(
    endpoint: str, others: Sequence[str], credentials: NodeCredentials | None
) -> list[Setting]:
    """Return the settings of a router.

    Args:
        endpoint: where it listens.
        others: endpoints of the other routers, which it is linked with.
        credentials: of the router; None for a bus without keys, where it passes on everything.
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
    """Return the silence after which a node's links are closed by the others [ms].

    Args:
        endpoints: of the links.
    """
    if any(endpoint.startswith("quic/") for endpoint in endpoints):
        return QUIC_LEASE_MS
    return LEASE_MS


def longest_round_trip_s(routers: Sequence[str]) -> float:
    """Return the longest way there and back over which links open [s].

    Args:
        routers: endpoints of the fleet's routers.
    """
    if len(routers) > 1:
        return LONGEST_ROUND_TRIP_OF_ROUTERS_S
    return LONGEST_ROUND_TRIP_S


def nested(settings: Iterable[Setting]) -> dict[str, Any]:
    """Return settings as one object, as a configuration file of zenoh holds them."""
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
        # Messages are small, and the threads and the memory of shared memory are not free.
        ("transport/shared_memory/enabled", False),
        # A peer that hangs fills its queue. The publisher then drops at once, because it may be the
        # control loop, which must not wait.
        (f"{drop}/wait_before_drop", 0),
        (f"{drop}/max_wait_before_drop_fragments", 0),
        (f"{block}/wait_before_close", _CLOSE_AFTER_US),
    ]


def _with_datagrams(endpoint: str) -> str:
    """Return an endpoint as zenoh needs it.

    QUIC carries what may be lost in datagrams, beside its streams; other protocols have no such
    choice.
    """
    if endpoint.startswith("quic/"):
        return f"{endpoint}?mixed_rel=1"
    return endpoint


def _security(credentials: NodeCredentials | None) -> list[Setting]:
    """Return the settings with which both ends of each link prove who they are."""
    if credentials is None:
        return []

    tls = "transport/link/tls"
    if not credentials.certificate:
        # it knows whom it talks to, and cannot prove who it is: no fleet with keys lets it in
        return [(f"{tls}/root_ca_certificate", credentials.authority)]

    return [
        (f"{tls}/root_ca_certificate", credentials.authority),
        (f"{tls}/enable_mtls", True),
        # The certificates of a fleet end in one second: it must not lose all links in flight.
        # onboard/security/certificate_times.py says who ends the links, and when.
        (f"{tls}/close_link_on_expiration", False),
        (f"{tls}/listen_certificate", credentials.certificate),
        (f"{tls}/connect_certificate", credentials.certificate),
        (f"{tls}/listen_private_key", credentials.key),
        (f"{tls}/connect_private_key", credentials.key),
        ("access_control", credentials.access),
    ]
