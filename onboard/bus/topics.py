"""The whole bus in one table: topic -> message, rate, greatest age, delivery and direction.

A key is ``covey/<fleet>/<topic>/<name>``; ``name`` is a vehicle, a mocap body or a node. A sample
older than ``stale_after_s`` is stale. In flight, agents use other limits for states and poses:
onboard/neighbours/table.py and onboard/safety/limits.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from onboard.bus import schema


class Topic(str, Enum):
    """Part of a key before the name; the values are part of the format of the bus."""

    STATE = "state"  # of a vehicle, for vehicles near it
    FAR = "far"  # the same message, for vehicles far away
    TELEMETRY = "telemetry"  # of a vehicle, for people
    SLOW_TELEMETRY = "brief"  # the same message, for the other vehicles
    TICK = "tick"  # every intermediate value of the pipeline
    EVENT = "event"  # sentences, and ends of orders
    PREFLIGHT = "preflight"  # go or no-go of a vehicle
    ORDER = "order"
    MOCAP = "mocap"  # pose of one body
    ALL_POSES = "poses"  # poses of all bodies
    CORRECTIONS = "corrections"  # RTK, of the fleet's base
    CLOCK = "clock"
    TRUTH = "truth"  # of the emulator
    LOG_REQUEST = "logask"  # for PX4's own logs
    LOG_PIECES = "logs"  # of PX4's own logs
    LIGHT = "light"  # colour of a vehicle in a show
    ALIVE = "alive"  # which nodes there are
    SIM = "sim"  # faults for the emulator


class Delivery(Enum):
    """Transport of a message."""

    LATEST = "latest"  # only the newest matters: dropped under congestion
    # Every message matters: the sender blocks, and no message is dropped while the link holds. What
    # breaks with the link, and has to be known, is sent again: onboard/agent/missed_events.py.
    RELIABLE = "reliable"
    QUERY = "query"  # order and reply
    TOKEN = "token"  # liveliness


@dataclass(frozen=True, slots=True)
class TopicSpec:
    """One row of the table."""

    message: type[schema.Message] | None  # None for a liveliness token
    rate_hz: float  # 0: sent on events only
    stale_after_s: float  # greatest age at which a sample may be used
    delivery: Delivery
    from_to: str  # who sends it to whom, in words


TOPICS: dict[Topic, TopicSpec] = {
    Topic.STATE: TopicSpec(
        message=schema.StateMessage,
        rate_hz=50.0,
        stale_after_s=0.3,
        delivery=Delivery.LATEST,
        from_to="agent -> agents in range",
    ),
    Topic.FAR: TopicSpec(
        message=schema.StateMessage,
        rate_hz=5.0,
        stale_after_s=0.75,
        delivery=Delivery.LATEST,
        from_to="agent -> agents out of reach",
    ),
    Topic.TELEMETRY: TopicSpec(
        message=schema.Telemetry,
        rate_hz=10.0,
        stale_after_s=1.0,
        delivery=Delivery.LATEST,
        from_to="agent -> ground",
    ),
    Topic.SLOW_TELEMETRY: TopicSpec(
        message=schema.Telemetry,
        rate_hz=2.0,
        stale_after_s=1.5,
        delivery=Delivery.LATEST,
        from_to="agent -> agents, changes at once",
    ),
    Topic.TICK: TopicSpec(
        message=schema.TickBatch,
        rate_hz=5.0,
        stale_after_s=1.0,
        delivery=Delivery.LATEST,
        from_to="agent -> recorder",
    ),
    Topic.EVENT: TopicSpec(
        message=schema.Event,
        rate_hz=0.0,
        stale_after_s=float("inf"),
        delivery=Delivery.RELIABLE,
        from_to="agent -> ground, recorder",
    ),
    Topic.PREFLIGHT: TopicSpec(
        message=schema.PreflightReport,
        rate_hz=1.0,
        stale_after_s=3.0,
        delivery=Delivery.LATEST,
        from_to="agent on the ground -> ground",
    ),
    Topic.ORDER: TopicSpec(
        message=schema.Order,
        rate_hz=0.0,
        stale_after_s=5.0,
        delivery=Delivery.QUERY,
        from_to="ground -> agent, answered",
    ),
    Topic.MOCAP: TopicSpec(
        message=schema.MocapPose,
        rate_hz=50.0,
        stale_after_s=0.2,
        delivery=Delivery.LATEST,
        from_to="mocap relay -> agents",
    ),
    Topic.ALL_POSES: TopicSpec(
        message=schema.MocapPoses,
        rate_hz=4.0,
        stale_after_s=1.0,
        delivery=Delivery.LATEST,
        from_to="mocap relay -> agents, all bodies",
    ),
    Topic.CORRECTIONS: TopicSpec(
        message=schema.Corrections,
        rate_hz=0.0,
        stale_after_s=2.0,
        delivery=Delivery.LATEST,
        from_to="node of corrections -> agents, one RTCM frame each",
    ),
    Topic.CLOCK: TopicSpec(
        message=schema.ClockMessage,
        rate_hz=2.0,
        stale_after_s=60.0,
        delivery=Delivery.LATEST,
        from_to="agents, ground, relays <-> each other",
    ),
    Topic.TRUTH: TopicSpec(
        message=schema.Truth,
        rate_hz=50.0,
        stale_after_s=1.0,
        delivery=Delivery.LATEST,
        from_to="emulator -> recorder, never an agent",
    ),
    Topic.LOG_REQUEST: TopicSpec(
        message=schema.LogRequest,
        rate_hz=0.0,
        stale_after_s=2.0,
        delivery=Delivery.LATEST,
        from_to="ground -> agent of a disarmed vehicle",
    ),
    Topic.LOG_PIECES: TopicSpec(
        message=schema.LogPieces,
        rate_hz=0.0,
        stale_after_s=2.0,
        delivery=Delivery.LATEST,
        from_to="agent of a disarmed vehicle -> ground, behind all others",
    ),
    Topic.LIGHT: TopicSpec(
        message=schema.Light,
        rate_hz=5.0,
        stale_after_s=1.0,
        delivery=Delivery.LATEST,
        from_to="ground -> its own console and record",
    ),
    Topic.SIM: TopicSpec(
        message=schema.FaultOrder,
        rate_hz=0.0,
        stale_after_s=5.0,
        delivery=Delivery.QUERY,
        from_to="ground -> emulator, answered; never an agent",
    ),
    Topic.ALIVE: TopicSpec(
        message=None,
        rate_hz=0.0,
        stale_after_s=1.0,
        delivery=Delivery.TOKEN,
        from_to="all -> all",
    ),
}


def key(namespace: str, topic: Topic, name: str) -> str:
    """Make a full key expression.

    Args:
        namespace: ``covey/<fleet name>``.
        topic: row of the table.
        name: vehicle, mocap body or node; ``*`` to subscribe to all.
    Returns:
        the key expression.
    """
    return f"{namespace}/{topic.value}/{name}"


def topic_and_name(namespace: str, key_expression: str) -> tuple[Topic, str] | None:
    """Split a key into topic and name; the inverse of :func:`key`.

    Args:
        namespace: ``covey/<fleet name>``.
        key_expression: key of a sample.
    Returns:
        topic and name; None for a key that is not in the table.
    """
    prefix = f"{namespace}/"
    if not key_expression.startswith(prefix):
        return None

    topic, _, name = key_expression.removeprefix(prefix).partition("/")
    if not name or "/" in name:
        return None
    try:
        return Topic(topic), name
    except ValueError:
        return None
