"""The rights of each role on a bus with keys: one table of role and topic. Pure.

A node's role follows from the common name of its certificate: a vehicle's name, or one of the names
below. Each node checks the messages that arrive over its links, and drops those that the table does
not grant (``access_control.py`` writes the table as zenoh's rules). A node does not open a link to
a node with a certificate from another certificate authority.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from onboard.bus.topics import TOPICS, Delivery, Topic


class NodeRole(StrEnum):
    """Kind of node. Except for VEHICLE, the value is the common name of the certificate."""

    VEHICLE = "vehicle"
    GROUND = "ground"  # sends orders, and reads everything
    VIEWER = "viewer"  # reads everything
    MOCAP = "mocap"  # publishes poses
    CORRECTIONS = "corrections"  # publishes corrections for RTK
    EMULATOR = "sitl"  # publishes poses and true motion of the vehicles that it emulates


# roles that have exactly one certificate in every fleet
NODES: tuple[NodeRole, ...] = tuple(role for role in NodeRole if role is not NodeRole.VEHICLE)

# Common name of a router. A router has no role, because it only forwards messages of other nodes.
ROUTER = "router"


@dataclass(frozen=True, slots=True)
class Grant:
    """Rights of one role.

    In a name, ``{own}`` stands for the vehicle's own name, ``*`` for any name, and ``x$*`` for any
    name that starts with x.
    """

    publishes: Mapping[Topic, tuple[str, ...]]  # topic -> names under which the role may publish
    answers: Mapping[Topic, tuple[str, ...]]  # topic -> names under which it may answer queries
    asks: Mapping[Topic, tuple[str, ...]]  # topic -> names to which it may send queries
    tokens: tuple[str, ...]  # names of the liveliness tokens that it may declare
    reads: frozenset[Topic]  # topics that it may subscribe to


_OWN = ("{own}",)
_ANY = ("*",)

# all topics that a node can subscribe to
_SAMPLES = frozenset(topic for topic, spec in TOPICS.items() if spec.delivery is not Delivery.QUERY)

GRANTS: dict[NodeRole, Grant] = {
    NodeRole.VEHICLE: Grant(
        publishes={
            Topic.STATE: _OWN,
            Topic.FAR: _OWN,
            Topic.TELEMETRY: _OWN,
            Topic.SLOW_TELEMETRY: _OWN,
            Topic.TICK: _OWN,
            Topic.EVENT: _OWN,
            Topic.PREFLIGHT: _OWN,
            Topic.LOG_PIECES: _OWN,
            Topic.CLOCK: _OWN,
        },
        answers={Topic.ORDER: _OWN},
        asks={},
        tokens=_OWN,
        reads=frozenset(
            (
                Topic.STATE,
                Topic.FAR,
                Topic.SLOW_TELEMETRY,
                Topic.MOCAP,
                Topic.ALL_POSES,
                Topic.CORRECTIONS,
                Topic.LOG_REQUEST,
                Topic.CLOCK,
                Topic.ALIVE,
            )
        ),
    ),
    NodeRole.GROUND: Grant(
        publishes={
            Topic.EVENT: _ANY,
            Topic.LIGHT: _ANY,
            Topic.LOG_REQUEST: _ANY,
            Topic.CLOCK: ("ground$*", "watcher$*"),
        },
        answers={},
        asks={Topic.ORDER: _ANY, Topic.SIM: _ANY},
        # the last three show who operates the fleet, see onboard/bus/control_token.py
        tokens=("ground$*", "watcher$*", "recorder$*", "operator.$*", "asks.$*", "keeps.$*"),
        reads=_SAMPLES,
    ),
    NodeRole.VIEWER: Grant(
        publishes={Topic.CLOCK: ("watcher$*",)},
        answers={},
        asks={},
        tokens=("watcher$*",),
        reads=_SAMPLES,
    ),
    NodeRole.MOCAP: Grant(
        publishes={Topic.MOCAP: _ANY, Topic.ALL_POSES: _ANY, Topic.CLOCK: ("mocap$*",)},
        answers={},
        asks={},
        tokens=("mocap$*",),
        # covey mocap --check reads ticks
        reads=frozenset((Topic.MOCAP, Topic.TICK, Topic.CLOCK, Topic.ALIVE)),
    ),
    NodeRole.CORRECTIONS: Grant(
        publishes={Topic.CORRECTIONS: _ANY, Topic.CLOCK: ("corrections$*",)},
        answers={},
        asks={},
        tokens=("corrections$*",),
        # its report contains the vehicles' fixes, which are in their telemetry
        reads=frozenset((Topic.SLOW_TELEMETRY, Topic.CLOCK, Topic.ALIVE)),
    ),
    NodeRole.EMULATOR: Grant(
        publishes={
            Topic.MOCAP: _ANY,
            Topic.ALL_POSES: _ANY,
            Topic.TRUTH: _ANY,
            Topic.CLOCK: ("sitl$*",),
        },
        answers={Topic.SIM: _ANY},
        asks={},
        tokens=("sitl$*",),
        reads=frozenset((Topic.CLOCK, Topic.ALIVE)),
    ),
}
