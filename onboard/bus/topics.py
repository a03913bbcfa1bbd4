"""The whole bus in one table: topic -> message, rate, stale-after, delivery and direction.

A key is ``covey/<fleet>/<topic>/<name>``; ``name`` is a vehicle, a mocap body or a node. A sample
older than ``stale_after_s`` is stale, for every receiver.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from onboard.bus import schema


class Topic(str, Enum):
    """Second last part of a key; the values are part of the format of the bus."""

    STATE = "state"
    FAR = "far"
    TELEMETRY = "telemetry"
    SLOW_TELEMETRY = "brief"
    TICK = "tick"
    EVENT = "event"
    PREFLIGHT = "preflight"
    ORDER = "order"
    MOCAP = "mocap"
    ALL_POSES = "poses"
    CLOCK = "clock"
    TRUTH = "truth"
    LIGHT = "light"
    ALIVE = "alive"
    SIM = "sim"


class Delivery(Enum):
    """Transport of a message."""

    LATEST = "latest"  # only the newest matters: dropped under congestion, real-time priority
    RELIABLE = "reliable"  # every one matters: the sender blocks rather than drops
    QUERY = "query"  # order and reply
    TOKEN = "token"  # liveliness


@dataclass(frozen=True, slots=True)
class TopicSpec:
    """One row of the table."""

    message: type[schema.Message] | None  # None for a liveliness token
    rate_hz: float  # 0: on event
    stale_after_s: float
    delivery: Delivery
    from_to: str


TOPICS: dict[Topic, TopicSpec] = {
    Topic.STATE: TopicSpec(
        schema.StateMessage, 50.0, 0.3, Delivery.LATEST, "agent -> agents in range"
    ),
    Topic.FAR: TopicSpec(
        schema.StateMessage, 5.0, 0.75, Delivery.LATEST, "agent -> agents out of reach"
    ),
    Topic.TELEMETRY: TopicSpec(schema.Telemetry, 10.0, 1.0, Delivery.LATEST, "agent -> ground"),
    Topic.SLOW_TELEMETRY: TopicSpec(
        schema.Telemetry, 2.0, 1.5, Delivery.LATEST, "agent -> agents, changes at once"
    ),
    Topic.TICK: TopicSpec(schema.TickBatch, 5.0, 1.0, Delivery.LATEST, "agent -> recorder"),
    Topic.EVENT: TopicSpec(
        schema.Event, 0.0, float("inf"), Delivery.RELIABLE, "agent -> ground, recorder"
    ),
    Topic.PREFLIGHT: TopicSpec(
        schema.PreflightReport, 1.0, 3.0, Delivery.LATEST, "agent on the ground -> ground"
    ),
    Topic.ORDER: TopicSpec(schema.Order, 0.0, 5.0, Delivery.QUERY, "ground -> agent, answered"),
    Topic.MOCAP: TopicSpec(schema.MocapPose, 50.0, 0.2, Delivery.LATEST, "mocap relay -> agents"),
    Topic.ALL_POSES: TopicSpec(
        schema.MocapPoses, 4.0, 1.0, Delivery.LATEST, "mocap relay -> agents, all bodies"
    ),
    Topic.CLOCK: TopicSpec(
        schema.ClockMessage, 2.0, 60.0, Delivery.LATEST, "agents, ground, relay <-> each other"
    ),
    Topic.TRUTH: TopicSpec(
        schema.Truth, 50.0, 1.0, Delivery.LATEST, "emulator -> recorder, never an agent"
    ),
    Topic.LIGHT: TopicSpec(
        schema.Light, 5.0, 1.0, Delivery.LATEST, "ground -> its own console and record"
    ),
    Topic.SIM: TopicSpec(
        schema.FaultOrder, 0.0, 5.0, Delivery.QUERY, "ground -> emulator, answered; never an agent"
    ),
    Topic.ALIVE: TopicSpec(None, 0.0, 1.0, Delivery.TOKEN, "all -> all"),
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
    """Take a key apart; the inverse of :func:`key`.

    Args:
        namespace: ``covey/<fleet name>``.
        key_expression: of a sample.
    Returns:
        topic and name; None for a key that is not in the table.
    """
    prefix = namespace + "/"
    if not key_expression.startswith(prefix):
        return None
    topic, _, name = key_expression[len(prefix) :].partition("/")
    try:
        return (Topic(topic), name) if name and "/" not in name else None
    except ValueError:
        return None
