"""Who may say what on a bus with keys: one table of role and topic. Pure.

A node's role follows from the common name of its certificate: a vehicle's name, or one of the names
below. Each node checks what comes in over each of its links. What is not granted there is dropped
before it is read (``access_control.py`` writes the table as zenoh's rules). A link whose
certificate is of another certificate authority is not opened at all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from onboard.bus.topics import TOPICS, Delivery, Topic


class NodeRole(StrEnum):
    """Kind of node; except for vehicles the value is the common name of the certificate."""

    VEHICLE = "vehicle"
    GROUND = "ground"  # orders, and reads all
    VIEWER = "viewer"  # reads all
    MOCAP = "mocap"  # publishes poses
    CORRECTIONS = "corrections"  # publishes corrections of RTK
    EMULATOR = "sitl"  # publishes poses and ground truth of what it emulates


# Roles that one certificate each is made for, whatever the fleet's vehicles are.
NODES: tuple[NodeRole, ...] = tuple(role for role in NodeRole if role is not NodeRole.VEHICLE)

# Common name of a router. It has no role: it passes on what the others say, each within its own.
ROUTER = "router"


@dataclass(frozen=True, slots=True)
class Grant:
    """What one role may do.

    Names: ``{own}`` is the vehicle's own, ``*`` any, ``x$*`` any that begins with x.
    """

    publishes: Mapping[Topic, tuple[str, ...]]  # topic -> names under which it may publish
    answers: Mapping[Topic, tuple[str, ...]]  # topic of queries -> names that it answers for
    asks: Mapping[Topic, tuple[str, ...]]  # topic of queries -> names that it may query
    tokens: tuple[str, ...]  # first words of its names in ``alive``
    reads: frozenset[Topic]


_OWN = ("{own}",)
_ANY = ("*",)

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
        # its report says which fix the vehicles have
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
