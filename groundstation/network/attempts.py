"""The tries of covey check attack: each is one way in, and says whether it got in.

A try runs twice: against a copy of the fleet with keys, and against one without any, where it has
to get in. Otherwise that it was stopped would prove nothing.
"""

from __future__ import annotations

import fnmatch
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from msgspec.structs import replace

from groundstation.network.fleet_copy import SPARE, CopyFlight
from groundstation.network.intruder import (
    EXPIRED,
    FOREIGN,
    NOBODY,
    NODES,
    Intruders,
    is_connected,
    is_obeyed,
    order_of,
    until,
)
from groundstation.network.mavlink_frames import (
    HEARTBEAT,
    SETUP_SIGNING,
    disarmed,
    packet,
    signing_key,
)
from onboard.bus.codec import Malformed
from onboard.bus.schema import Light, Message, Order, StateMessage, Telemetry
from onboard.bus.session import BusSession
from onboard.bus.topics import TOPICS, Delivery, Topic
from onboard.security.credentials import credentials_of
from onboard.security.node_roles import GRANTS, NodeRole

OUTSIDERS = (NOBODY, FOREIGN, EXPIRED)
_SAMPLES = tuple(
    topic for topic, spec in TOPICS.items() if spec.delivery in (Delivery.LATEST, Delivery.RELIABLE)
)
# no message of any other topic: counted, never used
_PROBE = Light(vehicle="intruder", stamp_ns=0, colour=(1, 2, 3))
_ARRIVAL_S, _EFFECT_S = 1.0, 2.5
_FLOOD_HZ, _BURST = 10_000, 100


@dataclass(slots=True)
class AttackContext:
    """One flying copy of the fleet, and what its tries need."""

    flight: CopyFlight
    intruders: Intruders
    is_long: bool
    arrived: set[tuple[Topic, str]] = field(default_factory=set)  # at the spare vehicle
    # authors of those that arrived at the spare vehicle
    orders: list[str] = field(default_factory=list)

    @property
    def has_keys(self) -> bool:
        """Whether this copy has keys."""
        return self.flight.fleet.has_keys

    def telemetry(self, name: str) -> Telemetry:
        """Return the newest telemetry of a vehicle that flies."""
        last = self.flight.client.state.vehicles[name].telemetry
        if last is None:
            raise NoProofError(f"{name} is not heard")
        return last

    @contextmanager
    def joined(self, who: str, node_name: str, *vehicles: str) -> Iterator[BusSession]:
        """Open an intruder's node that is connected; from outside one only tries, where there are
        keys.
        """
        with self.intruders.node(who, node_name, *vehicles) as node:
            is_in = is_connected(node)
            if not is_in and not (self.has_keys and who in OUTSIDERS):
                raise NoProofError(f"{who} was not connected")
            yield node

    def is_disturbed(self) -> bool:
        """Whether the fleet does not fly on, or came too close."""
        limit_m = self.flight.fleet.fleet.safety_distance_m
        return not until(self.flight.is_flying, _EFFECT_S) or self.flight.separation_m < limit_m


class NoProofError(Exception):
    """A try could not be made, so that whether it got in says nothing."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """One way in."""

    name: str
    gets_in: Callable[[AttackContext], bool]
    is_stopped_without_keys: bool = False  # by something else than keys: it proves nothing of them


def spare_vehicle(context: AttackContext) -> BusSession:
    """Return the node of the vehicle that nobody flies, opened: it keeps what arrives."""
    fleet = context.flight.fleet
    credentials = credentials_of(fleet, SPARE)
    endpoint = fleet.vehicles[SPARE].agent
    node = BusSession(
        namespace=fleet.namespace, node=SPARE, listen=[endpoint], credentials=credentials
    )
    node.start()

    def keep(topic: Topic, name: str, _message: Message | Malformed) -> None:
        context.arrived.add((topic, name))

    def take(order: object, _reply: object) -> None:
        context.orders.append(order.author if isinstance(order, Order) else "")

    for topic in _SAMPLES:
        node.subscribe(topic, "*", keep)
    node.serve_orders(SPARE, take)
    return node


def attempts(names: Sequence[str]) -> Iterator[Attempt]:
    """Yield all tries against a fleet of these vehicles; those that may end a flight come last."""
    first, last = names[0], names[-1]
    for who in OUTSIDERS:
        yield Attempt(
            f"{who}: orders hold", partial(_orders, who=who, node_name="stranger", vehicle=first)
        )
        yield Attempt(f"{who}: publishes a vehicle's state", partial(_publishes, who=who))
        yield Attempt(f"{who}: reads states", partial(_reads, who=who, vehicle=first))
    for role in (NodeRole.VIEWER, NodeRole.MOCAP, NodeRole.EMULATOR):
        name = f"a {role.value}'s key: orders hold"
        yield Attempt(name, partial(_orders, who=role, node_name=NODES[role], vehicle=first))
    yield Attempt(
        f"{last}'s key: orders hold", partial(_orders, who=last, node_name=last, vehicle=first)
    )
    for who in (last, *NODES):
        yield Attempt(f"{who}'s key: publishes what its role may not", partial(_table, who=who))
    yield Attempt("a recorded order, sent again", partial(_replays, vehicle=first))
    for name, gets_in in (
        (
            f"{last}'s key: {first}'s telemetry under its own name",
            partial(_other_inside, who=last, other=first),
        ),
        ("a viewer's key: 10,000 messages a second", _floods),
        (f"{last}'s key: frames that are no messages", partial(_malformed, who=last)),
        ("bytes at the agents' ports", _noise),
        ("a viewer that stops reading", _stops_reading),
        ("MAVLink: junk at the agent's port", partial(_junk, vehicle=first)),
        ("MAVLink: another system says disarmed", partial(_plays_px4, vehicle=first, other=17)),
        (
            "MAVLink: PX4's own id from elsewhere says disarmed",
            partial(_plays_px4, vehicle=first, other=0),
        ),
        ("MAVLink: SETUP_SIGNING in flight", partial(_signing, vehicle=first)),
        # the last: whoever finds a liar where it is itself lands, since the two may have touched
        (f"{last}'s key: forged states of itself", partial(_lies, who=last)),
    ):
        yield Attempt(name, gets_in, is_stopped_without_keys=True)


def _orders(context: AttackContext, who: str, node_name: str, vehicle: str) -> bool:
    with context.joined(who, node_name, vehicle) as node:
        return is_obeyed(node, vehicle, order_of(node, "hold", context.telemetry(vehicle)))


def _publishes(context: AttackContext, who: str) -> bool:
    with context.joined(who, "stranger", SPARE) as node:
        return bool(_told(context, node, [(Topic.STATE, "attacked")]))


def _told(
    context: AttackContext, node: BusSession, keys: Sequence[tuple[Topic, str]]
) -> set[tuple[Topic, str]]:
    """Publish on some keys for a while; return those that arrived at the spare vehicle."""
    context.arrived.difference_update(keys)
    end_s = time.monotonic() + _ARRIVAL_S
    while time.monotonic() < end_s:
        for topic, name in keys:
            node.publish(topic, name, _PROBE)
        time.sleep(0.05)
    return context.arrived.intersection(keys)


def _reads(context: AttackContext, who: str, vehicle: str) -> bool:
    heard: list[str] = []
    with context.joined(who, "stranger", vehicle) as node:
        node.subscribe(Topic.STATE, "*", lambda _topic, name, _message: heard.append(name))
        return until(lambda: bool(heard), 2.0 * _ARRIVAL_S)


def _table(context: AttackContext, who: str) -> bool:
    """Attempt every topic under the own name and others' names; only what the table of roles grants may
    arrive.
    """
    role = NodeRole(who) if who in set(NodeRole) else NodeRole.VEHICLE
    own = NODES.get(role, who)
    grant = GRANTS[role]
    with context.joined(who, own, SPARE) as node:
        arrived = _told(
            context, node, [(topic, name) for topic in _SAMPLES for name in (own, "attacked")]
        )
        is_obeyed(node, SPARE, order_of(node, "land"), _ARRIVAL_S)
    granted = {
        (topic, name)
        for topic, patterns in grant.publishes.items()
        for pattern in patterns
        for name in (own, "attacked")
        if fnmatch.fnmatch(name, pattern.format(own=who).replace("$*", "*"))
    }
    may_order = bool(grant.asks.get(Topic.ORDER))
    if context.has_keys and not arrived:
        raise NoProofError(f"nothing of what {who} may publish arrived")
    authors, context.orders = context.orders, []
    return bool(arrived - granted) or ("intruder" in authors and not may_order)


def _other_inside(context: AttackContext, who: str, other: str) -> bool:
    """Publish, under the own name, telemetry of another vehicle's second agent; whether anybody
    believes it.
    """
    lie = replace(context.telemetry(other), boot_id=1)
    with context.joined(who, who, *context.flight.names[:-1]) as node:

        def is_believed() -> bool:
            node.publish(Topic.SLOW_TELEMETRY, who, lie)
            return any(other in context.telemetry(name).doubles for name in context.flight.names)

        return until(is_believed, _EFFECT_S)


def _replays(context: AttackContext, vehicle: str) -> bool:
    """Have a ground order something, and send the same order again; whether it is accepted again."""
    with context.joined(NodeRole.GROUND, NODES[NodeRole.GROUND], vehicle) as node:
        order = order_of(node, "hold", context.telemetry(vehicle))
        if not is_obeyed(node, vehicle, order):
            raise NoProofError("the order was not accepted the first time")
        return is_obeyed(node, vehicle, order)


def _floods(context: AttackContext) -> bool:
    """Send what a viewer may send, ten thousand times a second."""
    with context.joined(NodeRole.VIEWER, NODES[NodeRole.VIEWER], *context.flight.names) as node:
        _send_often(node, Topic.CLOCK, NODES[NodeRole.VIEWER], 10.0 if context.is_long else 2.0)
    return context.is_disturbed()


def _malformed(context: AttackContext, who: str) -> bool:
    with context.joined(who, who, *context.flight.names[:-1]) as node:
        _send_often(node, Topic.SLOW_TELEMETRY, who, 100.0 if context.is_long else 2.0)
    counted = any(context.telemetry(name).malformed_messages for name in context.flight.names)
    return context.is_disturbed() or not counted


def _send_often(node: BusSession, topic: Topic, name: str, seconds: float) -> None:
    begin_s, sent = time.monotonic(), 0
    while (now_s := time.monotonic() - begin_s) < seconds:
        if sent < _FLOOD_HZ * now_s:
            for _ in range(_BURST):
                node.publish(topic, name, _PROBE)
            sent += _BURST
        else:
            time.sleep(0.001)
    if sent < 0.5 * _FLOOD_HZ * seconds:
        raise NoProofError(f"this computer sent {sent / seconds:.0f} messages a second only")


def _noise(context: AttackContext) -> bool:
    """Send random bytes to the ports at which agents listen, by datagrams and over connections."""
    chance = random.Random(1)
    for name in context.flight.names:
        address = _address(context.flight.fleet.vehicles[name].agent)
        for _ in range(200):
            _datagram(address, chance.randbytes(chance.randrange(1, 1400)))
            try:
                with socket.create_connection(address, 0.2) as stream:
                    stream.sendall(chance.randbytes(300))
            except OSError:
                continue  # nobody listens for streams where there are keys
    return context.is_disturbed()


def _stops_reading(context: AttackContext) -> bool:
    """Let a process of a viewer subscribe to everything, and stop it as Ctrl-Z does."""
    words = [
        sys.executable,
        "-m",
        "groundstation.network.stopped_reader",
        context.flight.fleet.path,
    ]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as reader:
        assert reader.stdout is not None
        is_reading = bool(reader.stdout.readline())
        os.kill(reader.pid, signal.SIGSTOP)
        time.sleep(10.0 if context.is_long else 3.0)
        is_disturbed = context.is_disturbed()
        reader.kill()
    if not is_reading:
        raise NoProofError("the reader heard nothing")
    return is_disturbed


def _lies(context: AttackContext, who: str) -> bool:
    """Tell the others that a vehicle is somewhere else, with its own key, beside its own agent."""
    newest: list[StateMessage] = []

    def keep(_topic: Topic, _name: str, message: Message | Malformed) -> None:
        if isinstance(message, StateMessage):
            newest[:] = [message]

    with context.joined(NodeRole.VIEWER, NODES[NodeRole.VIEWER], who) as ear:
        ear.subscribe(Topic.STATE, who, keep)
        with context.joined(who, who, *context.flight.names[:-1]) as node:
            end_s = time.monotonic() + (20.0 if context.is_long else 4.0)
            while time.monotonic() < end_s:
                if newest:
                    x, y, z = newest[0].position_enu_m
                    beside: Any = {
                        "position_enu_m": (x + 1.0, y, z),
                        "stamp_ns": newest[0].stamp_ns + 1,
                    }
                    node.publish(Topic.STATE, who, replace(newest[0], **beside))
                time.sleep(0.01)
    return context.flight.separation_m < context.flight.fleet.fleet.safety_distance_m


def _junk(context: AttackContext, vehicle: str) -> bool:
    chance, address = random.Random(2), _address(context.flight.fleet.vehicles[vehicle].autopilot)
    for _ in range(20_000 if context.is_long else 2000):
        _datagram(address, chance.randbytes(chance.randrange(1, 280)))
    return context.is_disturbed()


def _plays_px4(context: AttackContext, vehicle: str, other: int) -> bool:
    """Say for some seconds that the vehicle is disarmed; ``other`` is added to its system id."""
    own = context.flight.fleet.vehicles[vehicle]
    for sequence in range(60):
        _datagram(
            _address(own.autopilot), packet(HEARTBEAT, disarmed(), own.system_id + other, sequence)
        )
        time.sleep(0.05)
    return context.is_disturbed()


def _signing(context: AttackContext, vehicle: str) -> bool:
    """Give PX4 a key of ours; whether the vehicle is then lost to its agent."""
    own = context.flight.fleet.vehicles[vehicle]
    if own.direct is not None:
        for sequence in range(20):
            _datagram(
                _address(own.direct),
                packet(SETUP_SIGNING, signing_key(own.system_id), 255, sequence),
            )
            time.sleep(0.05)
    return context.is_disturbed()


def _address(endpoint: str) -> tuple[str, int]:
    host, _, port = endpoint.rpartition("/")[2].rpartition(":")
    return host, int(port)


def _datagram(address: tuple[str, int], data: bytes) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(data, address)
