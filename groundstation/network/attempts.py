"""The attempts of an attack: each is one way into a fleet, and says whether it got in.

An attempt runs twice: against a copy of the fleet with keys, and against a copy without keys. On
the copy without keys it has to get in. An attempt that fails there as well is stopped by something
other than keys, and proves nothing about them.

Some attempts publish messages or give orders; they got in if these arrive at a spare vehicle
(:func:`spare_vehicle`), which does not fly. Other attempts only disturb: floods, junk, lies. They
got in if the fleet does not fly on, or if two vehicles came closer than the safety distance.
"""

from __future__ import annotations

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

from msgspec.structs import replace

from groundstation.network.denials import DENIED
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
from groundstation.network.order_attempts import ORDER_ATTEMPTS, OrderAttempt
from onboard.bus.codec import Malformed
from onboard.bus.schema import Light, Message, Order, StateMessage, Telemetry
from onboard.bus.session import BusSession
from onboard.bus.topics import TOPICS, Delivery, Topic
from onboard.security.credentials import credentials_of
from onboard.security.node_roles import NodeRole

OUTSIDERS = (NOBODY, FOREIGN, EXPIRED)  # identities without a valid key of this fleet

_UNKNOWN_NODE = "unknown-node"  # no fleet file has a node of this name
_AUTHOR = "intruder"  # author of an attempt's orders

# Topics whose messages are published; the others are queries and tokens.
_PUBLISHED = tuple(
    topic for topic, spec in TOPICS.items() if spec.delivery in (Delivery.LATEST, Delivery.RELIABLE)
)
# The message that is published under every topic. Under any topic but its own, a light counts as
# malformed, so no receiver uses it.
_PROBE = Light(vehicle=_AUTHOR, stamp_ns=0, colour=(1, 2, 3))

_ARRIVAL_S = 1.0  # a published message that is allowed arrives within this time
_EFFECT_S = 2.5  # an effect shows, or a disturbed fleet flies on, within this time
_PERIOD_S = 0.05  # period of repeated messages and packets

_FLOOD_HZ = 10_000
_FLOOD_BURST = 100  # messages between two checks of the time
_GROUND_SYSTEM_ID = 255  # MAVLink system id of a ground station
_OTHER_SYSTEM_OFFSET = 17  # added to a vehicle's system id, it gives the id of another system


@dataclass(slots=True)
class AttackContext:
    """One flying copy of the fleet, and what the attempts on it need."""

    flight: CopyFlight
    intruders: Intruders
    is_long: bool  # whether floods and bad frames last minutes instead of seconds
    # topic and name of the messages that arrived at the spare vehicle
    arrived: set[tuple[Topic, str]] = field(default_factory=set)
    # authors of the orders that arrived at the spare vehicle
    order_authors: list[str] = field(default_factory=list)

    @property
    def has_keys(self) -> bool:
        """Whether this copy has keys."""
        return self.flight.fleet.has_keys

    def telemetry(self, name: str) -> Telemetry:
        """Return the newest telemetry of a flying vehicle.

        Raises:
            NoProofError: no telemetry of it has been received.
        """
        telemetry = self.flight.client.state.vehicles[name].telemetry
        if telemetry is None:
            raise NoProofError(f"{name} is not heard")
        return telemetry

    def duration_s(self, short_s: float, long_s: float) -> float:
        """Return the duration [s] that belongs to this attack, which is short or long."""
        return long_s if self.is_long else short_s

    @contextmanager
    def joined(
        self, identity: str, node_name: str, *vehicles: str, orders: OrderAttempt | None = None
    ) -> Iterator[BusSession]:
        """Open a node of an intruder, connected to some vehicles.

        If the fleet has keys, a node of an outsider may get no connection. The attempt goes on
        nevertheless, and should fail.

        Args:
            identity: one of OUTSIDERS, a role, or a vehicle whose key was stolen.
            node_name: name of the node on the bus.
            vehicles: names of the vehicles to which it connects.
            orders: changes the signatures of its orders; None: they are signed correctly.

        Raises:
            NoProofError: a node that should get a connection has none.
        """
        with self.intruders.node(identity, node_name, *vehicles, orders=orders) as node:
            may_be_refused = self.has_keys and identity in OUTSIDERS
            if not is_connected(node) and not may_be_refused:
                raise NoProofError(f"{identity} was not connected")
            yield node

    def is_disturbed(self) -> bool:
        """Return whether the fleet does not fly on, or vehicles came too close to each other."""
        if not until(self.flight.is_flying, _EFFECT_S):
            return True
        return self.flight.separation_m < self.flight.fleet.fleet.safety_distance_m


class NoProofError(Exception):
    """An attempt could not be made, so its outcome proves nothing."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """One way in."""

    name: str
    gets_in: Callable[[AttackContext], bool]  # makes the attempt; returns whether it got in
    # Whether something other than keys stops it, so that on a copy without keys it proves nothing.
    is_stopped_without_keys: bool = False


def spare_vehicle(context: AttackContext) -> BusSession:
    """Return the open node of the spare vehicle; it notes in the context what arrives."""
    fleet = context.flight.fleet
    node = BusSession(
        namespace=fleet.namespace,
        node=SPARE,
        listen=[fleet.vehicles[SPARE].agent],
        credentials=credentials_of(fleet, SPARE),
    )
    node.start()

    def keep_message(topic: Topic, name: str, _message: Message | Malformed) -> None:
        context.arrived.add((topic, name))

    def keep_order(order: object, _reply: object) -> None:
        author = ""
        if isinstance(order, Order):
            author = order.author
        context.order_authors.append(author)

    for topic in _PUBLISHED:
        node.subscribe(topic, "*", keep_message)
    node.serve_orders(SPARE, keep_order)
    return node


def attempts(names: Sequence[str]) -> Iterator[Attempt]:
    """Yield all attempts against a fleet of these vehicles.

    The last vehicle is the one whose key was stolen. Attempts that may end a flight come last.
    """
    first = names[0]
    last = names[-1]
    yield from _attempts_with_keys(first, last)
    yield from _attempts_to_disturb(first, last)


def _attempts_with_keys(first: str, last: str) -> Iterator[Attempt]:
    """Yield the attempts that nothing but keys and roles stops."""
    for outsider in OUTSIDERS:
        yield Attempt(
            f"{outsider}: orders hold",
            partial(_gives_order, identity=outsider, node_name=_UNKNOWN_NODE, vehicle=first),
        )
        yield Attempt(
            f"{outsider}: publishes a vehicle's state", partial(_publishes_state, identity=outsider)
        )
        yield Attempt(
            f"{outsider}: publishes corrections of a false base",
            partial(_publishes_corrections, identity=outsider, node_name=_UNKNOWN_NODE),
        )
        yield Attempt(
            f"{outsider}: reads states", partial(_reads_states, identity=outsider, vehicle=first)
        )

    for role in (NodeRole.VIEWER, NodeRole.MOCAP, NodeRole.CORRECTIONS, NodeRole.EMULATOR):
        yield Attempt(
            f"a {role.value}'s key: orders hold",
            partial(_gives_order, identity=role, node_name=NODES[role], vehicle=first),
        )
    yield Attempt(
        f"{last}'s key: orders hold",
        partial(_gives_order, identity=last, node_name=last, vehicle=first),
    )

    for identity in (last, *NODES):
        yield Attempt(
            f"{identity}'s key: publishes what its role may not",
            partial(_exceeds_role, identity=identity),
        )
    yield Attempt("a recorded order, sent again", partial(_repeats_order, vehicle=first))
    for order_attempt in ORDER_ATTEMPTS:
        yield Attempt(
            order_attempt.name,
            partial(_gives_wrong_order, vehicle=first, order_attempt=order_attempt),
        )


def _attempts_to_disturb(first: str, last: str) -> Iterator[Attempt]:
    """Yield the attempts that something other than keys stops."""
    for name, gets_in in (
        (
            f"{last}'s key: {first}'s telemetry under its own name",
            partial(_reports_second_agent, identity=last, other=first),
        ),
        ("a viewer's key: 10,000 messages a second", _floods),
        (
            f"{last}'s key: frames that are no messages",
            partial(_sends_malformed, identity=last),
        ),
        ("bytes at the agents' ports", _sends_noise),
        ("a viewer that stops reading", _stops_reading),
        ("MAVLink: junk at the agent's port", partial(_sends_mavlink_junk, vehicle=first)),
        (
            "MAVLink: another system says disarmed",
            partial(_imitates_px4, vehicle=first, id_offset=_OTHER_SYSTEM_OFFSET),
        ),
        (
            "MAVLink: PX4's own id from elsewhere says disarmed",
            partial(_imitates_px4, vehicle=first, id_offset=0),
        ),
        ("MAVLink: SETUP_SIGNING in flight", partial(_sets_signing_key, vehicle=first)),
        # The forged states come last, because they may end a flight: when a vehicle claims to be
        # where another one is, the other one lands, since the two may have touched.
        (f"{last}'s key: forged states of itself", partial(_forges_positions, identity=last)),
    ):
        yield Attempt(name, gets_in, is_stopped_without_keys=True)


def _gives_order(context: AttackContext, identity: str, node_name: str, vehicle: str) -> bool:
    with context.joined(identity, node_name, vehicle) as node:
        order = order_of(node, "hold", context.telemetry(vehicle))
        return is_obeyed(node, vehicle, order)


def _gives_wrong_order(context: AttackContext, vehicle: str, order_attempt: OrderAttempt) -> bool:
    """Give an order with the ground's key, but with a wrong signature, or too late."""
    ground = NODES[NodeRole.GROUND]
    with context.joined(NodeRole.GROUND, ground, vehicle, orders=order_attempt) as node:
        telemetry = context.telemetry(vehicle)
        order = order_attempt.change(order_of(node, "hold", telemetry), telemetry)
        return is_obeyed(node, vehicle, order)


def _publishes_state(context: AttackContext, identity: str) -> bool:
    with context.joined(identity, _UNKNOWN_NODE, SPARE) as node:
        return bool(_arrivals(context, node, [(Topic.STATE, "attacked")]))


def _publishes_corrections(context: AttackContext, identity: str, node_name: str) -> bool:
    """Publish corrections of a false base, which would move all vehicles that accept them."""
    with context.joined(identity, node_name, SPARE) as node:
        return bool(_arrivals(context, node, [(Topic.CORRECTIONS, "attacked")]))


def _arrivals(
    context: AttackContext, node: BusSession, keys: Sequence[tuple[Topic, str]]
) -> set[tuple[Topic, str]]:
    """Publish on some keys for a while; return those that arrived at the spare vehicle."""
    context.arrived.difference_update(keys)

    end_s = time.monotonic() + _ARRIVAL_S
    while time.monotonic() < end_s:
        for topic, name in keys:
            node.publish(topic, name, _PROBE)
        time.sleep(_PERIOD_S)
    return context.arrived.intersection(keys)


def _reads_states(context: AttackContext, identity: str, vehicle: str) -> bool:
    senders: list[str] = []

    def keep(_topic: Topic, name: str, _message: Message | Malformed) -> None:
        senders.append(name)

    with context.joined(identity, _UNKNOWN_NODE, vehicle) as node:
        node.subscribe(Topic.STATE, "*", keep)
        return until(lambda: bool(senders), 2.0 * _ARRIVAL_S)


def _exceeds_role(context: AttackContext, identity: str) -> bool:
    """Publish every topic, under its own name and another one, and give an order.

    It got in if anything arrives that the holder of the key must not publish.
    """
    role = NodeRole.VEHICLE
    if identity in set(NodeRole):
        role = NodeRole(identity)
    own_name = NODES.get(role, identity)
    names = (own_name, "attacked")

    with context.joined(identity, own_name, SPARE) as node:
        keys = [(topic, name) for topic in _PUBLISHED for name in names]
        arrived = _arrivals(context, node, keys)
        # The spare vehicle answers no order, but notes the author of each one.
        is_obeyed(node, SPARE, order_of(node, "land"), _ARRIVAL_S)

    if context.has_keys and not arrived:
        raise NoProofError(f"nothing of what {identity} may publish arrived")

    has_ordered = _AUTHOR in context.order_authors and role is not NodeRole.GROUND
    context.order_authors.clear()

    denied = DENIED[role]
    denied_as_itself = {(topic, own_name) for topic in denied.as_itself}
    denied_as_another = {(topic, "attacked") for topic in denied.as_another}
    has_published = bool(arrived & (denied_as_itself | denied_as_another))
    return has_published or has_ordered


def _reports_second_agent(context: AttackContext, identity: str, other: str) -> bool:
    """Publish, under its own name, telemetry of a second agent of another vehicle.

    It got in if any vehicle then believes that the other one has two agents.

    Args:
        context: the context of the attack.
        identity: name of the last vehicle, whose key was stolen.
        other: name of the other vehicle.
    """
    lie = replace(context.telemetry(other), boot_id=1)
    with context.joined(identity, identity, *context.flight.names[:-1]) as node:

        def is_believed() -> bool:
            node.publish(Topic.SLOW_TELEMETRY, identity, lie)
            return any(other in context.telemetry(name).doubles for name in context.flight.names)

        return until(is_believed, _EFFECT_S)


def _repeats_order(context: AttackContext, vehicle: str) -> bool:
    """Send a valid order of a ground twice; it got in if it is accepted the second time, too."""
    with context.joined(NodeRole.GROUND, NODES[NodeRole.GROUND], vehicle) as node:
        order = order_of(node, "hold", context.telemetry(vehicle))
        if not is_obeyed(node, vehicle, order):
            raise NoProofError("the order was not accepted the first time")
        return is_obeyed(node, vehicle, order)


def _floods(context: AttackContext) -> bool:
    """Send a topic that a viewer may publish, ten thousand times a second."""
    name = NODES[NodeRole.VIEWER]
    with context.joined(NodeRole.VIEWER, name, *context.flight.names) as node:
        _send_often(node, Topic.CLOCK, name, context.duration_s(2.0, 10.0))
    return context.is_disturbed()


def _sends_malformed(context: AttackContext, identity: str) -> bool:
    """Publish lights under the topic of telemetry, where they count as malformed.

    It got in if the fleet is disturbed, or if no vehicle counts the malformed messages.
    """
    with context.joined(identity, identity, *context.flight.names[:-1]) as node:
        _send_often(node, Topic.SLOW_TELEMETRY, identity, context.duration_s(2.0, 100.0))

    is_counted = any(context.telemetry(name).malformed_messages for name in context.flight.names)
    return context.is_disturbed() or not is_counted


def _send_often(node: BusSession, topic: Topic, name: str, duration_s: float) -> None:
    """Publish the probe :data:`_FLOOD_HZ` times a second.

    Raises:
        NoProofError: this computer is too slow for that.
    """
    sent = 0
    begin_s = time.monotonic()
    elapsed_s = 0.0
    while elapsed_s < duration_s:
        if sent < _FLOOD_HZ * elapsed_s:
            for _ in range(_FLOOD_BURST):
                node.publish(topic, name, _PROBE)
            sent += _FLOOD_BURST
        else:
            time.sleep(0.001)
        elapsed_s = time.monotonic() - begin_s

    if sent < 0.5 * _FLOOD_HZ * duration_s:
        raise NoProofError(f"this computer sent {sent / duration_s:.0f} messages a second only")


def _sends_noise(context: AttackContext) -> bool:
    """Send random bytes to the ports at which agents listen, by datagrams and over connections."""
    rng = random.Random(1)
    for name in context.flight.names:
        address = _address(context.flight.fleet.vehicles[name].agent)
        for _ in range(200):
            _send_datagram(address, rng.randbytes(rng.randrange(1, 1400)))
            try:
                with socket.create_connection(address, 0.2) as stream:
                    stream.sendall(rng.randbytes(300))
            except OSError:
                # an agent with keys accepts no plain TCP connection
                continue
    return context.is_disturbed()


def _stops_reading(context: AttackContext) -> bool:
    """Let a viewer's process subscribe to all topics, and stop the process as Ctrl-Z does."""
    module = "groundstation.network.stopped_reader"
    command = [sys.executable, "-m", module, context.flight.fleet.path]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as reader:
        assert reader.stdout is not None
        try:
            if not reader.stdout.readline():
                raise NoProofError("the reader heard nothing")
            os.kill(reader.pid, signal.SIGSTOP)
            time.sleep(context.duration_s(3.0, 10.0))
            return context.is_disturbed()
        finally:
            reader.kill()  # a stopped process does not end by itself


def _forges_positions(context: AttackContext, identity: str) -> bool:
    """Publish false positions with a vehicle's own key while its true agent runs, too."""
    newest: StateMessage | None = None

    def keep(_topic: Topic, _name: str, message: Message | Malformed) -> None:
        nonlocal newest
        if isinstance(message, StateMessage):
            newest = message

    others = context.flight.names[:-1]
    with context.joined(NodeRole.VIEWER, NODES[NodeRole.VIEWER], identity) as listener:
        listener.subscribe(Topic.STATE, identity, keep)
        with context.joined(identity, identity, *others) as node:
            end_s = time.monotonic() + context.duration_s(4.0, 20.0)
            while time.monotonic() < end_s:
                if newest is not None:
                    node.publish(Topic.STATE, identity, _beside(newest))
                time.sleep(0.01)

    if newest is None:
        raise NoProofError(f"no state of {identity} was heard, so none was forged")
    return context.flight.separation_m < context.flight.fleet.fleet.safety_distance_m


def _beside(state: StateMessage) -> StateMessage:
    """Return a newer state whose position is a metre further east."""
    x_m, y_m, z_m = state.position_enu_m
    return replace(
        state,
        position_enu_m=(x_m + 1.0, y_m, z_m),
        stamp_ns=state.stamp_ns + 1,
    )


def _sends_mavlink_junk(context: AttackContext, vehicle: str) -> bool:
    rng = random.Random(2)
    address = _address(context.flight.fleet.vehicles[vehicle].autopilot)
    count = 20_000 if context.is_long else 2000
    for _ in range(count):
        _send_datagram(address, rng.randbytes(rng.randrange(1, 280)))
    return context.is_disturbed()


def _imitates_px4(context: AttackContext, vehicle: str, id_offset: int) -> bool:
    """Send heartbeats of a disarmed vehicle to its agent for some seconds.

    Args:
        context: the context of the attack.
        vehicle: name of the vehicle whose PX4 is imitated.
        id_offset: number that is added to the vehicle's system id.
    """
    target = context.flight.fleet.vehicles[vehicle]
    address = _address(target.autopilot)
    for sequence in range(60):
        data = packet(HEARTBEAT, disarmed(), target.system_id + id_offset, sequence)
        _send_datagram(address, data)
        time.sleep(_PERIOD_S)
    return context.is_disturbed()


def _sets_signing_key(context: AttackContext, vehicle: str) -> bool:
    """Set the intruder's signing key in PX4; it got in if the agent then loses the vehicle."""
    target = context.flight.fleet.vehicles[vehicle]
    if target.direct is None:
        raise NoProofError(f"no ground link leads to the PX4 of {vehicle}")

    address = _address(target.direct)
    payload = signing_key(target.system_id)
    for sequence in range(20):
        data = packet(SETUP_SIGNING, payload, _GROUND_SYSTEM_ID, sequence)
        _send_datagram(address, data)
        time.sleep(_PERIOD_S)
    return context.is_disturbed()


def _address(endpoint: str) -> tuple[str, int]:
    """Return host and port of an endpoint such as ``udpin://HOST:PORT``."""
    _, _, host_and_port = endpoint.rpartition("/")
    host, _, port = host_and_port.rpartition(":")
    return host, int(port)


def _send_datagram(address: tuple[str, int], data: bytes) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(data, address)
