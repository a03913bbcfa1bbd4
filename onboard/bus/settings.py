"""Settings of Zenoh for the nodes of the bus, and for its routers. Pure.

Endpoints are explicit, without multicast or gossip scouting: a node connects only to endpoints of
the fleet file.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from onboard.bus.credentials import Credentials
from onboard.bus.protocol import LEASE_MS
from onboard.bus.roles import access_control
from onboard.config.fleet import FleetConfig

Setting = tuple[str, Any]  # path in zenoh's configuration, value

RETRY = {"period_init_ms": 200, "period_max_ms": 500, "period_increase_factor": 1.5}
ROUTER_LEASE_MS = 500  # half of the others': without a router nobody hears anything
_ROUTER_OPEN_MS = 500  # then the next router is tried; enough for round trips up to 150 ms
_CLOSE_AFTER_US = 1_000_000  # then the connection to a peer that takes nothing is closed
# for a link: over QUIC a node that is not there refuses nothing, and silence takes this long
_OPEN_MS = 1000


def of_node(
    listen: Sequence[str], connect: Sequence[str], credentials: Credentials | None
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
        ("listen/endpoints", [_link_of(endpoint) for endpoint in listen]),
        ("connect/endpoints", [_link_of(endpoint) for endpoint in connect]),
        ("connect/timeout_ms", -1),
        *_common(credentials, LEASE_MS),
    ]


def of_client(
    routers: Sequence[str], timeout_s: float, credentials: Credentials | None
) -> list[Setting]:
    """Return the settings of a node behind routers: it is linked with the first that answers, then
    with the next one.

    Args:
        routers: endpoints, in the order in which they are tried.
        timeout_s: to find one at the start; one that is lost later is looked for for ever.
        credentials: of the node; None for a bus without keys.
    """
    return [
        ("mode", "client"),
        ("connect/endpoints", [_link_of(endpoint) for endpoint in routers]),
        ("connect/timeout_ms", round(1e3 * timeout_s)),
        *_common(credentials, LEASE_MS),
        ("transport/unicast/open_timeout", _ROUTER_OPEN_MS),
    ]


def of_router(
    endpoint: str,
    others: Sequence[str],
    fleets: Iterable[FleetConfig],
    credentials: Credentials | None,
) -> list[Setting]:
    """Return the settings of a router.

    Args:
        endpoint: where it listens.
        others: endpoints of the other routers, which it is linked with.
        fleets: whose messages it passes on.
        credentials: of the router; None for a bus without keys, where it passes on everything.
    """
    access = access_control({fleet.namespace: fleet.vehicles for fleet in fleets}, has_router=True)
    return [
        ("mode", "router"),
        ("listen/endpoints", [_link_of(endpoint)]),
        ("connect/endpoints", [_link_of(other) for other in others]),
        ("connect/timeout_ms", -1),
        ("timestamping/enabled", False),  # messages have stamps of their own
        *_common(credentials, ROUTER_LEASE_MS),
        *([] if credentials is None else [("access_control", access)]),
    ]


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


def _common(credentials: Credentials | None, lease_ms: int) -> list[Setting]:
    return [
        *_security(credentials),
        ("connect/exit_on_failure", False),
        ("connect/retry", RETRY),
        ("listen/exit_on_failure", True),
        ("listen/timeout_ms", 0),
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("scouting/delay", 0),
        ("transport/link/tx/lease", lease_ms),
        ("transport/unicast/open_timeout", _OPEN_MS),
        # messages are small, and its threads and memory are not free
        ("transport/shared_memory/enabled", False),
        # a peer that hangs fills its queue: the publisher drops at once instead of waiting in the
        # control loop
        ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", 0),
        ("transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments", 0),
        ("transport/link/tx/queue/congestion_control/block/wait_before_close", _CLOSE_AFTER_US),
    ]


def _link_of(endpoint: str) -> str:
    """Return an endpoint with what zenoh is told of it: QUIC carries what may be lost in datagrams,
    beside streams.
    """
    return f"{endpoint}?mixed_rel=1" if endpoint.startswith("quic/") else endpoint


def _security(credentials: Credentials | None) -> list[Setting]:
    """Return the settings with which both ends of each link prove who they are."""
    if credentials is None:
        return []
    tls = {
        "root_ca_certificate": credentials.authority,
        "enable_mtls": True,
        "close_link_on_expiration": True,
        **{f"{side}_certificate": credentials.certificate for side in ("listen", "connect")},
        **{f"{side}_private_key": credentials.key for side in ("listen", "connect")},
    }
    settings: list[Setting] = [(f"transport/link/tls/{name}", value) for name, value in tls.items()]
    return [*settings, ("access_control", credentials.access)]
