"""The way of PX4's own logs through its agent: only on the ground, and behind everything else."""

from __future__ import annotations

from typing import Any, cast

import pytest

from onboard.agent.log_relay import LogRelay
from onboard.bus.codec import Malformed
from onboard.bus.protocol import Bus
from onboard.bus.schema import LogPieces, LogRequest
from onboard.bus.topics import Topic
from onboard.px4.mavsdk_link import Px4Link
from onboard.px4.packets import Packet, cut, packed
from tests.onboard.px4.test_log_requests import READ, SYSTEM_ID, WRITE, file_transfer

SECOND_NS = 1_000_000_000


class Px4:
    """The part of a link to PX4 that the relay uses: keeps what it is asked."""

    system_id = SYSTEM_ID

    def __init__(self) -> None:
        self.requests: list[int] = []
        self.on_log_answer: Any = None

    def request_log(self, number: int, _payload: bytes) -> None:
        self.requests.append(number)

    def answer(self, count: int = 1) -> None:
        for index in range(count):
            data = packed(110, bytes((0, 255, 190, index & 0xFF, 1)), 0, SYSTEM_ID, 1)
            (packet,) = cut(data)
            assert isinstance(packet, Packet)
            self.on_log_answer(packet)


class GroundBus:
    """The part of a bus that the relay uses."""

    def __init__(self) -> None:
        self.pieces: list[bytes] = []
        self._on_request: Any = None

    def collect(self, topic: Topic, name: str, on_message: Any, *, most: int) -> None:
        assert (topic, name) == (Topic.LOG_REQUEST, "mav0")
        assert most > 0
        self._on_request = on_message

    def publish(self, topic: Topic, name: str, message: LogPieces) -> None:
        assert (topic, name) == (Topic.LOG_PIECES, "mav0")
        self.pieces += message.packets

    def request(self, packet: bytes) -> None:
        self._on_request(Topic.LOG_REQUEST, "mav0", LogRequest(packet=packet))

    def garbage(self) -> None:
        self._on_request(Topic.LOG_REQUEST, "mav0", Malformed("no request", 3))


class Scene:
    """A relay between a PX4 and a ground."""

    def __init__(self) -> None:
        self.px4 = Px4()
        self.bus = GroundBus()
        self.relay = LogRelay("mav0", cast(Px4Link, self.px4), cast(Bus, self.bus))
        self.relay.start()
        self.now_ns = SECOND_NS

    def tick(self, *, is_disarmed: bool = True, after_s: float = 0.02) -> None:
        self.now_ns += round(after_s * SECOND_NS)
        self.relay.step(is_disarmed=is_disarmed, now_ns=self.now_ns)


@pytest.fixture
def scene() -> Scene:
    return Scene()


def test_a_request_goes_to_px4_and_its_answer_to_the_ground(scene: Scene) -> None:
    scene.bus.request(file_transfer(READ).data)
    scene.tick()
    assert scene.px4.requests == [110]

    scene.px4.answer()
    scene.tick()
    assert len(scene.bus.pieces) == 1


def test_nothing_is_passed_on_while_the_vehicle_is_armed(scene: Scene) -> None:
    scene.bus.request(file_transfer(READ).data)
    scene.tick(is_disarmed=False)
    scene.tick()
    assert scene.px4.requests == []

    scene.bus.request(file_transfer(READ).data)
    scene.tick()
    scene.px4.answer()
    scene.tick(is_disarmed=False)
    scene.px4.answer()
    scene.tick()
    assert scene.bus.pieces == []


def test_a_request_that_writes_and_garbage_stay_here(scene: Scene) -> None:
    scene.bus.request(file_transfer(WRITE, "/log/a.ulg").data)
    scene.bus.request(b"\xfd garbage")
    scene.bus.request(b"")
    scene.bus.garbage()
    scene.tick()
    assert scene.px4.requests == []


def test_answers_that_nobody_has_requested_lately_stay_here(scene: Scene) -> None:
    scene.px4.answer()
    scene.tick()
    assert scene.bus.pieces == []

    scene.bus.request(file_transfer(READ).data)
    scene.tick()
    scene.tick(after_s=6.0)
    scene.px4.answer()
    scene.tick()
    assert scene.bus.pieces == []


def test_a_tick_sends_a_bounded_number_of_pieces(scene: Scene) -> None:
    scene.bus.request(file_transfer(READ).data)
    scene.tick()
    scene.px4.answer(100)

    scene.tick()
    assert len(scene.bus.pieces) == 60
    scene.tick()
    assert len(scene.bus.pieces) == 100


def test_of_more_pieces_than_fit_the_oldest_are_lost(scene: Scene) -> None:
    scene.bus.request(file_transfer(READ).data)
    scene.tick()
    scene.px4.answer(5000)
    for _ in range(100):
        scene.tick()
    assert len(scene.bus.pieces) == 4000
