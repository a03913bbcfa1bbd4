"""One operator at a time: rules, two grounds of a simulated fleet, and two real Zenoh sessions."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from groundstation.client.client import FleetClient
from groundstation.fleet.operator_control import SILENCE_S
from groundstation.missions.api import Fleet, NotReady
from onboard.bus.control_token import ControlToken, ControlTokens, next_term, parse_control_token
from onboard.bus.schema import Order, OrderReply, Telemetry
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from sitl.lockstep.flight import Lockstep


def order(kind: Any, node: str = "ground-1") -> Order:
    return Order(order_id="1", author="x", kind=kind, stamp_ns=0, deadline_ns=0, node=node)


def test_a_token_reads_back_and_strange_names_are_no_tokens() -> None:
    token = ControlToken("operator", 3, "ground-7-ab", "alice")
    assert parse_control_token(str(token)) == token
    assert "/" not in str(ControlToken("asks", 1, "ground-1", "a/b*$?#.c"))
    for name in (
        "ground-1",
        "operator",
        "operator.x.n.a",
        "operator.1..a",
        "operator.1.n.a.b",
        "king.1.n.a",
        "",
    ):
        assert parse_control_token(name) is None


def test_who_operates_goes_on_until_it_leaves_or_somebody_claims_a_later_term() -> None:
    roles = ControlTokens()
    roles.see("operator.1.ground-5.bob", True)
    roles.see("operator.1.ground-1.alice", True)
    assert roles.holder == ControlToken("operator", 1, "ground-5", "bob")
    roles.see("operator.2.ground-9.carol", True)
    assert roles.holder is not None
    assert roles.holder.author == "carol"
    roles.see("operator.2.ground-9.carol", False)
    assert roles.holder.author == "alice"
    roles.see("operator.1.ground-1.alice", False)
    roles.see("operator.1.ground-5.bob", False)
    assert roles.operator == ""


def test_false_claims_neither_take_control_nor_keep_it_for_ever() -> None:
    roles = ControlTokens()
    roles.see("operator.1.ground-1.alice", True)
    for name in (
        "operator.999999.x.y",
        "operator.999.x.y",
        "operator.3.x.y",
        "operator.1.a.y",
        "operator.0.a.y",
    ):
        roles.see(name, True)
    for number in range(100):  # they fill the memory
        roles.see(f"asks.1.x{number}.y", True)
    assert roles.holder == ControlToken("operator", 1, "ground-1", "alice")
    roles.see("operator.2.ground-2.bob", True)  # after a request that alice has left unanswered
    assert roles.holder == ControlToken("operator", 2, "ground-2", "bob")

    roles = ControlTokens()
    roles.see("operator.999.x.y", True)  # it was free
    assert roles.holder is not None
    roles.see(f"operator.{next_term(roles.holder.term)}.ground-2.bob", True)
    assert roles.holder == ControlToken("operator", 1, "ground-2", "bob")
    assert roles.holder.beats(ControlToken("operator", 999, "x", "y"))


@pytest.mark.parametrize("kind", ["arm", "takeoff", "move", "disarm", "locate"])
def test_an_agent_takes_orders_of_the_operator_only_while_there_is_one(kind: str) -> None:
    roles = ControlTokens()
    assert roles.refusal(order(kind, "ground-2")) is None
    roles.see("operator.1.ground-1.alice", True)
    assert roles.refusal(order(kind)) is None
    assert "alice operates" in (roles.refusal(order(kind, "ground-2")) or "")
    assert "alice operates" in (roles.refusal(order(kind, "")) or "")


@pytest.mark.parametrize("kind", ["land", "hold", "kill"])
def test_what_makes_things_safer_is_taken_from_everybody(kind: str) -> None:
    roles = ControlTokens()
    roles.see("operator.1.ground-1.alice", True)
    assert roles.refusal(order(kind, "ground-2")) is None


class Pair:
    """A simulated fleet with two grounds; alice came first."""

    def __init__(self, fleet: FleetConfig) -> None:
        self.flight = Lockstep(fleet)
        self.alice = self.flight.client
        self.flight.ready()
        self.flight.run(1.0)
        self.bob = self.ground("ground-2", "bob")

    def ground(self, node: str, author: str, *, operates: bool = True) -> FleetClient:
        client = FleetClient(
            self.flight.config,
            author=author,
            operates=operates,
            bus=self.flight.simulation.bus.node(node),
            clock_ns=lambda: self.flight.simulation.now_ns,
        )
        self.flight.wait_for(client.start())
        self.flight.run(1.5)
        return client

    def told(self, client: FleetClient) -> list[str]:
        return [
            logged.event.sentence
            for logged in client.state.events
            if logged.event.code == "operator"
        ]


@pytest.fixture
def pair(fleet: FleetConfig) -> Pair:
    return Pair(fleet)


def test_the_second_ground_watches_and_only_makes_things_safer(pair: Pair) -> None:
    assert pair.alice.control.is_operator
    assert not pair.bob.control.is_operator
    assert pair.bob.control.holder is not None
    refused = pair.flight.wait_for(pair.bob.order("takeoff all 1.0", 5.0))
    assert all(one.phase == "refused" and "operates" in one.sentence for one in refused.values())
    assert all(one.is_done for one in pair.flight.takeoff().values())
    landed = pair.flight.wait_for(pair.bob.order("land all", 40.0))
    assert all(one.is_done for one in landed.values())


def test_agents_refuse_a_second_ground_that_does_not_ask_itself(pair: Pair) -> None:
    pair.bob.control.refusal = lambda kind: None  # type: ignore[method-assign]
    refused = pair.flight.wait_for(pair.bob.order("takeoff all 1.0", 5.0))
    assert all(
        one.phase == "refused" and "operates this fleet" in one.sentence for one in refused.values()
    )


def test_a_mission_of_a_second_ground_does_not_begin(pair: Pair) -> None:
    with pytest.raises(NotReady, match="operates this fleet"):
        pair.flight.wait_for(Fleet(pair.bob).ready(5.0))


def test_control_is_asked_for_and_given(pair: Pair) -> None:
    assert "Asking" in pair.bob.control.take()
    pair.flight.run(1.0)
    assert pair.alice.control.requester is not None
    assert pair.alice.control.requester.author == "bob"
    assert "bob" in pair.alice.control.hand_over()
    pair.flight.run(1.0)
    assert pair.bob.control.is_operator
    assert not pair.alice.control.is_operator
    assert all(
        one.is_done
        for one in pair.flight.wait_for(pair.bob.order("takeoff all 1.0", 40.0)).values()
    )


def test_an_operator_who_keeps_control_says_so_and_may_be_asked_again(pair: Pair) -> None:
    for _ in range(2):
        pair.bob.control.take()
        pair.flight.run(0.5)
        assert "keep control" in pair.alice.control.keep()
        pair.flight.run(0.5)
        assert not pair.bob.control.is_waiting
        assert pair.alice.control.is_operator
        assert pair.alice.control.requester is None
    assert sum("keeps control" in sentence for sentence in pair.told(pair.bob)) == 2


@pytest.mark.long
def test_control_is_taken_by_force_only_after_silence(pair: Pair) -> None:
    assert "Ask" in pair.bob.control.take("force")
    pair.bob.control.take()
    pair.flight.run(2.0)
    assert "Wait until" in pair.bob.control.take("force")
    pair.flight.run(SILENCE_S)
    assert "You take control" in pair.bob.control.take("force")
    pair.flight.run(1.0)
    assert pair.bob.control.is_operator
    assert not pair.alice.control.is_operator
    assert any(
        sentence.startswith("bob (") and "operates" in sentence
        for sentence in pair.told(pair.alice)
    )


def test_a_crash_of_the_operator_frees_control_and_nobody_takes_it_unasked(pair: Pair) -> None:
    pair.flight.wait_for(pair.alice.stop())
    pair.flight.run(3.0)
    assert pair.bob.control.holder is None
    assert not pair.bob.control.is_operator
    assert "nobody operates" in (pair.bob.control.refusal("move") or "")
    pair.bob.control.take()
    pair.flight.run(1.0)
    assert pair.bob.control.is_operator


def test_a_ground_that_takes_free_control_while_it_asks_asks_no_more(pair: Pair) -> None:
    pair.bob.control.take()
    assert pair.bob.control.is_waiting
    pair.bob.control.holder = None  # alice has just gone, and bob's request is not yet granted
    assert pair.bob.control.take() == "You take control."
    assert not pair.bob.control.is_waiting


def test_who_only_watches_does_not_take_control_of_a_free_fleet(pair: Pair) -> None:
    pair.flight.wait_for(pair.alice.stop())
    carol = pair.ground("ground-3", "carol", operates=False)
    pair.flight.run(2.0)
    assert not carol.control.is_operator
    assert carol.control.refusal("land") is None


@pytest.mark.long
def test_two_grounds_that_start_together_agree_on_one(fleet: FleetConfig) -> None:
    pair = Pair(fleet)
    pair.flight.wait_for(pair.alice.stop())
    pair.flight.run(2.0)
    clients = []
    for name in ("ground-5", "ground-6", "ground-7"):
        client = FleetClient(
            fleet, author=name, bus=pair.flight.simulation.bus.node(name),
            clock_ns=lambda: pair.flight.simulation.now_ns,
        )  # fmt: skip
        pair.flight.wait_for(client.start())
        clients.append(client)
    pair.flight.run(4.0)
    assert sum(client.control.is_operator for client in clients) == 1


# -- real sessions ---------------------------------------------------------------------------------


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


async def until(condition: Callable[[], object], timeout_s: float = 15.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "not in time"
        await asyncio.sleep(0.02)


async def test_two_consoles_over_zenoh_share_one_token_and_a_crash_frees_it(
    fleet: FleetConfig, make_telemetry: Callable[..., Telemetry]
) -> None:
    names = fleet.enabled_names[:2]
    vehicles = {
        name: msgspec.structs.replace(fleet.vehicles[name], agent=free_endpoint()) for name in names
    }
    few = msgspec.structs.replace(fleet, vehicles=vehicles, formations={}, path="two")
    agents = []
    for name in names:
        session = BusSession(namespace=few.namespace, node=name, listen=[vehicles[name].agent])
        roles = ControlTokens()
        session.start()
        session.watch_alive(roles.see)

        def answer(
            asked: object,
            reply: Callable[[OrderReply], None],
            roles: ControlTokens = roles,
            name: str = name,
        ) -> None:
            assert isinstance(asked, Order)
            reason = roles.refusal(asked) or ""
            answer = OrderReply(
                order_id=asked.order_id, vehicle=name, is_accepted=not reason, reason=reason
            )
            loop.call_soon_threadsafe(reply, answer)

        session.serve_orders(name, answer)
        agents.append((name, session, roles))
    loop = asyncio.get_running_loop()

    async def beat() -> None:
        sequence = 1
        while True:
            sequence += 1
            for name, session, roles in agents:
                message = make_telemetry(
                    name,
                    sequence=sequence,
                    operator=roles.operator,
                    roles=roles.others,
                    config_hash=few.config_hash,
                )
                session.publish(Topic.TELEMETRY, name, message)
            await asyncio.sleep(0.05)

    beating = asyncio.create_task(beat())
    alice = FleetClient(few, author="alice")
    bob = FleetClient(few, author="bob")
    try:
        await alice.start()
        await until(lambda: alice.control.is_operator and alice.control.holder is not None)
        await bob.start()
        await until(lambda: bob.control.holder is not None)
        assert not bob.control.is_operator
        assert (await alice.submit("arm all")).planned.orders
        assert not (await bob.submit("arm all")).planned.orders
        bob.control.take()
        await until(lambda: alice.control.requester is not None)
        alice.control.hand_over()
        await until(lambda: bob.control.is_operator)
        await until(lambda: alice.control.holder is not None)
        handle = await bob.submit("arm all")
        await until(lambda: all(one.phase == "accepted" for one in handle.results.values()))
        await bob.stop()  # as a process that dies: its connections close
        await until(lambda: alice.control.holder is None)
        alice.control.take()
        await until(lambda: alice.control.is_operator and alice.control.holder is not None)
    finally:
        beating.cancel()
        await alice.stop()
        await bob.stop()
        for _, session, _ in agents:
            session.stop()
