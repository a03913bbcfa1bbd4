"""The whole bus in one table: topic -> message, rate, stale-after, delivery and direction.

A key is ``covey/<fleet>/<topic>/<name>``; ``name`` is a vehicle, a mocap body or a node. Liveness follows from this
table: a sample older than ``stale_after_s`` is not a fresh one, for anybody.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from onboard.bus import schema


class Topic(str, Enum):
    """Second last part of a key."""

    STATE = "state"
    FAR = "far"
    TELEMETRY = "telemetry"
    BRIEF = "brief"
    TICK = "tick"
    EVENT = "event"
    PREFLIGHT = "preflight"
    ORDER = "order"
    MOCAP = "mocap"
    CLOCK = "clock"
    TRUTH = "truth"
    ALIVE = "alive"
    SIM = "sim"


class Delivery(Enum):
    """How a message travels: the newest matters, every one matters, or it is asked and answered."""

    LATEST = "latest"  # dropped under congestion, real-time priority
    RELIABLE = "reliable"  # blocks rather than drops
    QUERY = "query"  # order and reply
    TOKEN = "token"  # liveliness


@dataclass(frozen=True, slots=True)
class TopicSpec:
    """One row of the table; ``rate_hz`` 0 means on event."""

    message: type[schema.Message] | None
    rate_hz: float
    stale_after_s: float
    delivery: Delivery
    from_to: str


TOPICS: dict[Topic, TopicSpec] = {
    Topic.STATE: TopicSpec(schema.StateMessage, 50.0, 0.3, Delivery.LATEST, "agent -> agents in range"),
    Topic.FAR: TopicSpec(schema.StateMessage, 5.0, 0.75, Delivery.LATEST, "agent -> agents out of reach"),
    Topic.TELEMETRY: TopicSpec(schema.Telemetry, 10.0, 1.0, Delivery.LATEST, "agent -> ground"),
    Topic.BRIEF: TopicSpec(schema.Telemetry, 2.0, 1.5, Delivery.LATEST, "agent -> agents: telemetry, news at once"),
    Topic.TICK: TopicSpec(schema.TickBatch, 5.0, 1.0, Delivery.LATEST, "agent -> recorder"),
    Topic.EVENT: TopicSpec(schema.Event, 0.0, float("inf"), Delivery.RELIABLE, "agent -> ground, recorder"),
    Topic.PREFLIGHT: TopicSpec(schema.PreflightReport, 1.0, 3.0, Delivery.LATEST, "agent on the ground -> ground"),
    Topic.ORDER: TopicSpec(schema.Order, 0.0, 5.0, Delivery.QUERY, "ground -> agent, answered"),
    Topic.MOCAP: TopicSpec(schema.MocapPose, 50.0, 0.2, Delivery.LATEST, "mocap relay -> agents"),
    Topic.CLOCK: TopicSpec(schema.ClockMessage, 2.0, 60.0, Delivery.LATEST, "agents, ground, relay <-> each other"),
    Topic.TRUTH: TopicSpec(schema.Truth, 50.0, 1.0, Delivery.LATEST, "emulator -> recorder, never an agent"),
    Topic.SIM: TopicSpec(schema.FaultOrder, 0.0, 5.0, Delivery.QUERY, "ground -> emulator, answered; never an agent"),
    Topic.ALIVE: TopicSpec(None, 0.0, 1.0, Delivery.TOKEN, "all -> all"),
}


def key(namespace: str, topic: Topic, name: str) -> str:
    """Full key expression; ``name`` may be ``*`` to subscribe to all."""
    return f"{namespace}/{topic.value}/{name}"


def topic_and_name(namespace: str, key_expression: str) -> tuple[Topic, str] | None:
    """Inverse of :func:`key`; None for a key that is not in the table."""
    prefix = namespace + "/"
    if not key_expression.startswith(prefix):
        return None
    topic, _, name = key_expression[len(prefix) :].partition("/")
    try:
        return (Topic(topic), name) if name and "/" not in name else None
    except ValueError:
        return None
