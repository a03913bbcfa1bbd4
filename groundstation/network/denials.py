"""The topics that the holder of a key must never publish on a bus with keys, listed independently.

``onboard/security/node_roles.py`` lists what a role may do; this file lists what it must not do.
Attacks and tests of the bus compare the messages that arrive with this list, so that a superfluous
right is noticed. To give a role a new right, change both files: the second change confirms the
first.
"""

from __future__ import annotations

from typing import NamedTuple

from onboard.bus.topics import Topic
from onboard.security.node_roles import NodeRole


class Denial(NamedTuple):
    """Topics that the holder of a key must not publish."""

    as_itself: frozenset[Topic]  # under its own name
    as_another: frozenset[Topic]  # under another node's name


_STATES = frozenset(
    {
        Topic.STATE,
        Topic.FAR,
        Topic.TELEMETRY,
        Topic.SLOW_TELEMETRY,
        Topic.TICK,
        Topic.PREFLIGHT,
    }
)
_POSES = frozenset({Topic.MOCAP, Topic.ALL_POSES})
_CORRECTIONS = frozenset({Topic.CORRECTIONS})  # a wrong base moves all vehicles that use it
_TRUTH = frozenset({Topic.TRUTH})
_SENTENCES = frozenset({Topic.EVENT})
_LIGHTS = frozenset({Topic.LIGHT})
_CLOCKS = frozenset({Topic.CLOCK})
_LOG_REQUESTS = frozenset({Topic.LOG_REQUEST})  # to read PX4's card is for whoever may order
_LOG_PIECES = frozenset({Topic.LOG_PIECES})
_LOGS = _LOG_REQUESTS | _LOG_PIECES

DENIED: dict[NodeRole, Denial] = {
    # a vehicle publishes its own state, and nothing that others measure
    NodeRole.VEHICLE: Denial(
        as_itself=_POSES | _CORRECTIONS | _TRUTH | _LIGHTS | _LOG_REQUESTS,
        as_another=_STATES
        | _SENTENCES
        | _POSES
        | _CORRECTIONS
        | _TRUTH
        | _LIGHTS
        | _CLOCKS
        | _LOGS,
    ),
    # a ground gives orders; it is neither a vehicle nor a motion capture
    NodeRole.GROUND: Denial(
        as_itself=_STATES | _POSES | _CORRECTIONS | _TRUTH | _LOG_PIECES,
        as_another=_STATES | _POSES | _CORRECTIONS | _TRUTH | _CLOCKS | _LOG_PIECES,
    ),
    NodeRole.VIEWER: Denial(
        as_itself=_STATES | _POSES | _CORRECTIONS | _TRUTH | _SENTENCES | _LIGHTS | _LOGS,
        as_another=_STATES
        | _POSES
        | _CORRECTIONS
        | _TRUTH
        | _SENTENCES
        | _LIGHTS
        | _CLOCKS
        | _LOGS,
    ),
    # a motion capture measures all bodies, so it may publish poses under any name
    NodeRole.MOCAP: Denial(
        as_itself=_STATES | _CORRECTIONS | _TRUTH | _SENTENCES | _LIGHTS | _LOGS,
        as_another=_STATES | _CORRECTIONS | _TRUTH | _SENTENCES | _LIGHTS | _CLOCKS | _LOGS,
    ),
    # a relay of corrections measures no body
    NodeRole.CORRECTIONS: Denial(
        as_itself=_STATES | _POSES | _TRUTH | _SENTENCES | _LIGHTS | _LOGS,
        as_another=_STATES | _POSES | _TRUTH | _SENTENCES | _LIGHTS | _CLOCKS | _LOGS,
    ),
    NodeRole.EMULATOR: Denial(
        as_itself=_STATES | _CORRECTIONS | _SENTENCES | _LIGHTS | _LOGS,
        as_another=_STATES | _CORRECTIONS | _SENTENCES | _LIGHTS | _CLOCKS | _LOGS,
    ),
}
