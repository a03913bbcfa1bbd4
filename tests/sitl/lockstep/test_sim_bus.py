"""The simulated bus: what is promised for each kind of message, under every fault of a link."""

from __future__ import annotations

import functools
from typing import Any, cast

import pytest

from onboard.bus.schema import Event, Order, OrderReply, Truth
from onboard.bus.topics import Topic
from onboard.config.fleet import ConfigError
from sitl.lockstep.bus import SimBus
from sitl.lockstep.connections import BusSettings


class Rig:
    """Two nodes, and a clock to be turned by hand."""

    def __init__(self, settings: BusSettings | None = None, seed: int = 0) -> None:
        self.now_ns = 0
        self.bus = SimBus(settings or BusSettings(), lambda: self.now_ns, seed=seed)
        self.a = self.bus.node("a")
        self.b = self.bus.node("b")
        self.heard: list[tuple[int, str, object]] = []
        self.alive: list[tuple[str, bool]] = []
        self.a.start()
        self.b.start()
        for topic in (Topic.TRUTH, Topic.EVENT):
            self.b.subscribe(
                topic,
                "*",
                lambda topic, name, message: self.heard.append((self.now_ns, name, message)),
            )
        self.b.watch_alive(lambda node, is_alive: self.alive.append((node, is_alive)))
        self.run(0.1)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.001)):
            self.now_ns += 1_000_000
            self.bus.deliver()

    def tell(self, topic: Topic, number: int) -> None:
        zero = (0.0, 0.0, 0.0)
        message = (
            Truth(
                vehicle="v",
                stamp_ns=number,
                position_enu_m=zero,
                velocity_enu_m_s=zero,
                quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
                is_on_ground=True,
                is_collided=False,
            )
            if topic is Topic.TRUTH
            else Event(vehicle="v", stamp_ns=number, severity="info", code="x", sentence="x")
        )
        self.a.publish(topic, "v", message)

    def numbers(self) -> list[int]:
        return [message.stamp_ns for _, _, message in self.heard]  # type: ignore[attr-defined]


def test_a_message_comes_after_the_delay_and_not_before() -> None:
    rig = Rig(BusSettings(delay_s=0.010))
    rig.tell(Topic.TRUTH, 1)
    rig.run(0.009)
    assert rig.numbers() == []
    rig.run(0.001)
    assert rig.numbers() == [1]


def test_the_newest_matters_may_be_lost_and_events_never_are_and_keep_their_order() -> None:
    rig = Rig(BusSettings(loss=0.3, jitter_s=0.005, duplicate=0.1, reorder=0.1))
    for number in range(500):
        rig.tell(Topic.TRUTH, number)
        rig.run(0.005)
    rig.run(3.0)
    truth = rig.numbers()
    assert 300 < len(set(truth)) < 400
    assert truth != sorted(truth)
    assert len(truth) > len(set(truth))
    rig.heard.clear()
    for number in range(200):
        rig.tell(Topic.EVENT, number)
        rig.run(0.005)
    rig.run(5.0)
    assert rig.numbers() == list(range(200))


def test_without_reordering_jitter_keeps_the_order() -> None:
    rig = Rig(BusSettings(jitter_s=0.02))
    for number in range(300):
        rig.tell(Topic.TRUTH, number)
        rig.run(0.003)
    rig.run(1.0)
    assert rig.numbers() == list(range(300))


def test_the_same_seed_gives_the_same_chance_and_another_seed_another() -> None:
    def lost(seed: int) -> list[int]:
        rig = Rig(BusSettings(loss=0.5), seed)
        for number in range(64):
            rig.tell(Topic.TRUTH, number)
        rig.run(0.1)
        return rig.numbers()

    assert lost(1) == lost(1) != lost(2)


def test_a_cut_stops_everything_is_noticed_after_the_lease_and_heals() -> None:
    rig = Rig()
    assert rig.alive == [("a", True)]
    rig.bus.partition(["a"])
    rig.tell(Topic.TRUTH, 1)
    rig.run(0.5)
    rig.tell(Topic.EVENT, 2)
    assert rig.alive == [("a", True)]
    rig.run(0.6)
    assert rig.alive == [("a", True), ("a", False)]
    assert rig.numbers() == []
    rig.bus.heal()
    rig.run(0.5)
    assert rig.alive[-1] == ("a", True)
    rig.tell(Topic.TRUTH, 3)
    rig.run(0.1)
    assert rig.numbers() == [2, 3]  # the event waited in the sender's buffers


def test_an_event_that_waits_longer_than_the_lease_is_gone() -> None:
    rig = Rig()
    rig.bus.partition(["a"])
    rig.tell(Topic.EVENT, 1)
    rig.run(1.5)
    rig.bus.heal()
    rig.run(1.0)
    assert rig.numbers() == []


def test_a_bridging_node_is_heard_on_both_sides() -> None:
    rig = Rig()
    bridge = rig.bus.node("bridge")
    bridge.start()
    rig.bus.partition(["a"], bridging=["bridge"])
    assert rig.bus.is_cut("a", "b")
    assert not rig.bus.is_cut("bridge", "a")
    assert not rig.bus.is_cut("bridge", "b")


def test_a_node_that_ends_is_seen_to_end_at_once_and_is_not_heard_from_again() -> None:
    rig = Rig()
    rig.a.stop()
    rig.run(0.01)
    assert rig.alive[-1] == ("a", False)
    assert "a" not in rig.bus.nodes


def test_an_order_is_answered_once_and_not_after_its_time() -> None:
    for delay_s, expected in ((0.01, 1), (0.3, 0)):
        rig = Rig(BusSettings(delay_s=delay_s))
        rig.run(1.0)
        reply = OrderReply(order_id="1", vehicle="b", is_accepted=True, reason="")

        def answer(_: object, send: Any, reply: OrderReply = reply) -> None:
            send(reply)

        rig.b.serve_orders("b", answer)
        replies: list[Any] = []
        ends: list[int] = []
        rig.a.order(
            "b",
            cast(Order, None),
            timeout_s=0.5,
            on_reply=replies.append,
            on_end=functools.partial(ends.append, 1),
        )
        rig.run(2.0)
        assert len(replies) == expected
        assert ends == [1]


@pytest.mark.parametrize(
    "wrong", [{"loss": 1.2}, {"loss": -0.1}, {"delay_s": -1.0}, {"jitter_s": float("nan")}]
)
def test_impossible_settings_are_refused_in_words(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        BusSettings(**wrong)
