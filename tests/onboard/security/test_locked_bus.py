"""The table of roles and topics on a bus with keys: every cell tried over real links, granted and
not granted ones.

The table is no proof of itself. So what arrives is compared with the list of denials too, and
orders are sent with signatures that are not what their ground has signed.
"""

from __future__ import annotations

import datetime
import fnmatch
import shutil
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from msgspec.structs import replace

from groundstation.keys.secured_fleet import secure_fleet
from groundstation.network.denials import DENIED
from groundstation.network.order_attempts import (
    Tamper,
    TamperedCredentials,
    as_signed,
    for_another_vehicle,
    of_another_order,
    without,
)
from onboard.bus.protocol import UntrustedOrder
from onboard.bus.schema import FaultOrder, Order, OrderReply
from onboard.bus.session import BusSession
from onboard.bus.topics import TOPICS, Delivery, Topic
from onboard.config.fleet import FleetConfig, load_fleet
from onboard.security.credentials import credentials_of
from onboard.security.node_roles import GRANTS, NodeRole
from tests.onboard.bus.sessions import started, until
from tests.onboard.state_messages import state_message

PAPER = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"
SAMPLES = [
    topic for topic, spec in TOPICS.items() if spec.delivery in (Delivery.LATEST, Delivery.RELIABLE)
]
NODES = {
    "mav1": "mav1",
    "ground": "ground-1-a",
    "viewer": "watcher-1-a",
    "mocap": "mocap",
    "sitl": "sitl",
}
Heard = set[tuple[Topic, str]]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> FleetConfig:
    """The paper's fleet with keys."""
    file = tmp_path_factory.mktemp("fleet") / "fleet.toml"
    shutil.copy(PAPER, file)
    return secure_fleet(str(file), datetime.datetime.now(datetime.UTC))


@pytest.fixture
def fleet(made: FleetConfig) -> FleetConfig:
    """The same on a free port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    agent = replace(made.vehicles["mav0"], agent=f"quic/127.0.0.1:{port}")
    return replace(made, vehicles={**made.vehicles, "mav0": agent})


@contextmanager
def _node(
    fleet: FleetConfig, holder: str, *, listens: bool = False, has_keys: bool = True
) -> Iterator[BusSession]:
    endpoint = fleet.vehicles["mav0"].agent
    session = BusSession(
        namespace=fleet.namespace,
        node=NODES.get(holder, holder),
        listen=[endpoint] if listens else [],
        connect=[] if listens else [endpoint],
        credentials=credentials_of(fleet, holder) if has_keys else None,
    )
    with started(session):
        yield session


def _names(holder: str) -> list[str]:
    return [NODES[holder], "mav0", "mav2", "other"]


def _role(holder: str) -> NodeRole:
    return NodeRole(holder) if holder in set(NodeRole) else NodeRole.VEHICLE


def _arrives(holder: str, topic: Topic, name: str, reader: str) -> bool:
    patterns = GRANTS[_role(holder)].publishes.get(topic, ())
    is_granted = any(
        fnmatch.fnmatch(name, one.format(own=holder).replace("$*", "*")) for one in patterns
    )
    return is_granted and topic in GRANTS[_role(reader)].reads


def _denied(holder: str) -> Heard:
    """What the holder of a key must never be able to say, whatever the table of roles grants."""
    denied = DENIED[_role(holder)]
    own = {(topic, NODES[holder]) for topic in denied.as_itself}
    others = {
        (topic, name)
        for topic in denied.as_another
        for name in _names(holder)
        if name != NODES[holder]
    }
    return own | others


@pytest.mark.parametrize("holder", NODES)
def test_what_each_holder_of_a_key_may_publish_read_and_order(
    fleet: FleetConfig, holder: str
) -> None:
    heard: Heard = set()
    read: set[Topic] = set()
    alive: set[str] = set()
    ordered: list[str] = []

    def answer(order: object, reply: Callable[[OrderReply], None]) -> None:
        assert isinstance(order, Order)
        ordered.append(order.author)
        reply(OrderReply(order_id=order.order_id, vehicle="mav0", is_accepted=True, reason=""))

    with _node(fleet, "mav0", listens=True) as agent, _node(fleet, holder) as node:
        for topic in SAMPLES:
            agent.subscribe(topic, "*", lambda topic, name, _: heard.add((topic, name)))
            node.subscribe(
                topic, "*", lambda topic, name, _: read.add(topic) if name == "mav0" else None
            )
        agent.serve_orders("mav0", answer)
        agent.watch_alive(lambda name, is_alive: alive.add(name) if is_alive else None)
        for token in ("operator.1.x.y", "mav2"):
            node.claim(token)
        assert until(lambda: NODES[holder] in alive)
        granted = {
            (topic, name)
            for topic in SAMPLES
            for name in _names(holder)
            if _arrives(holder, topic, name, "mav0")
        }
        readable = {topic for topic in SAMPLES if _arrives("mav0", topic, "mav0", holder)}
        message = state_message()

        def tell() -> bool:
            for topic in SAMPLES:
                agent.publish(topic, "mav0", message)
                for name in _names(holder):
                    node.publish(topic, name, message)
            return heard >= granted and read >= readable

        # Until both ends of a link have declared what they read, zenoh sends everything over it.
        # Who may read what shows after that; what may be said is judged from the first message on.
        heard_at_first: Heard = set()
        for _ in range(2):
            assert until(tell), (granted - heard, readable - read)
            heard_at_first |= heard
            heard.clear()
            read.clear()

        assert until(tell), (granted - heard, readable - read)
        for _ in range(5):
            tell()
            time.sleep(0.02)
        ended: list[bool] = []
        order = Order(
            order_id="o1", author=holder, kind="land", stamp_ns=time.monotonic_ns(), deadline_ns=0
        )
        node.order(
            "mav0", order, timeout_s=1.0, on_reply=lambda _: None, on_end=lambda: ended.append(True)
        )
        assert until(lambda: bool(ended))
        assert heard == granted
        assert not (heard | heard_at_first) & _denied(holder)
        assert read == readable
        assert bool(ordered) is (holder == "ground")
        assert ("operator.1.x.y" in alive) is (holder == "ground")
        assert "mav2" not in alive


@pytest.mark.parametrize(
    ("tamper", "signer", "is_taken"),
    [
        pytest.param(as_signed, "ground", True, id="as its ground has signed it"),
        pytest.param(without, "ground", False, id="without a signature"),
        pytest.param(of_another_order, "ground", False, id="one byte changed"),
        pytest.param(for_another_vehicle, "ground", False, id="signed for another vehicle"),
        pytest.param(as_signed, "viewer", False, id="signed by a viewer"),
        pytest.param(as_signed, "mocap", False, id="signed by the motion capture"),
        pytest.param(as_signed, "mav1", False, id="signed by a vehicle"),
    ],
)
def test_an_order_of_the_grounds_own_link_is_taken_only_as_the_ground_has_signed_it(
    fleet: FleetConfig, tamper: Tamper, signer: str, is_taken: bool
) -> None:
    ordered: list[object] = []

    def answer(order: object, reply: Callable[[OrderReply], None]) -> None:
        ordered.append(order)
        assert isinstance(order, Order | UntrustedOrder)
        reply(OrderReply(order_id="o1", vehicle="mav0", is_accepted=False, reason=""))

    own = credentials_of(fleet, "ground")
    other = credentials_of(fleet, signer)
    assert own is not None
    assert other is not None
    forged = TamperedCredentials(
        own=own,
        signer=other,
        tamper=tamper,
    )
    ground = BusSession(
        namespace=fleet.namespace,
        node=NODES["ground"],
        connect=[fleet.vehicles["mav0"].agent],
        credentials=forged,
    )
    order = Order(order_id="o1", author="ground", kind="hold", stamp_ns=1, deadline_ns=0)

    with _node(fleet, "mav0", listens=True) as agent, started(ground):
        agent.serve_orders("mav0", answer)

        def arrives() -> bool:
            ground.order("mav0", order, timeout_s=1.0, on_reply=lambda _: None, on_end=lambda: None)
            return bool(ordered)

        assert until(arrives)

    assert all(isinstance(one, Order) is is_taken for one in ordered)


def test_nobody_without_a_key_of_this_authority_is_heard_or_hears(
    fleet: FleetConfig, tmp_path: Path
) -> None:
    foreign = tmp_path / "fleet.toml"
    shutil.copy(fleet.path, foreign)
    # the same fleet, an authority of its own
    secure_fleet(str(foreign), datetime.datetime.now(datetime.UTC))
    heard: Heard = set()
    read: Heard = set()
    with _node(fleet, "mav0", listens=True) as agent, _node(fleet, "mav1") as admitted:
        agent.subscribe(Topic.STATE, "*", lambda topic, name, _: heard.add((topic, name)))
        own = replace(load_fleet(foreign), vehicles=fleet.vehicles)
        with (
            _node(own, "mav2") as foreign_node,
            _node(fleet, "ground", has_keys=False) as nobody,
        ):
            for outsider in (foreign_node, nobody):
                outsider.subscribe(Topic.STATE, "*", lambda topic, name, _: read.add((topic, name)))

            def tell() -> bool:
                for node, name in (
                    (agent, "mav0"),
                    (admitted, "mav1"),
                    (foreign_node, "mav2"),
                    (nobody, "mav2"),
                ):
                    node.publish(Topic.STATE, name, state_message())
                return (Topic.STATE, "mav1") in heard

            assert until(tell)  # who has a key gets in
            for _ in range(50):
                tell()
                time.sleep(0.02)
    assert heard == {(Topic.STATE, "mav1")}
    assert read == set()


def test_what_fits_into_no_datagram_arrives(fleet: FleetConfig) -> None:
    heard: set[Topic] = set()
    large = replace(state_message(), vehicle="x" * 10_000)
    topics = [
        topic
        for topic in SAMPLES
        if topic in GRANTS[NodeRole.VEHICLE].publishes and topic in GRANTS[NodeRole.VIEWER].reads
    ]
    whole = set(topics) - {Topic.STATE, Topic.FAR}  # these are always small
    with _node(fleet, "mav0", listens=True) as agent, _node(fleet, "viewer") as viewer:
        for topic in whole:
            viewer.subscribe(topic, "*", lambda topic, *_: heard.add(topic))

        def tell() -> bool:
            for topic in whole:
                agent.publish(topic, "mav0", large)
            return heard == whole

        assert until(tell), whole - heard


def test_faults_are_the_emulators_to_answer_and_the_grounds_to_ask() -> None:
    assert [role for role in NodeRole if Topic.SIM in GRANTS[role].asks] == [NodeRole.GROUND]
    assert [role for role in NodeRole if Topic.SIM in GRANTS[role].answers] == [NodeRole.EMULATOR]
    assert TOPICS[Topic.SIM].message is FaultOrder
