"""PX4's logs through an agent: whole although pieces are lost, and never of an armed vehicle."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from groundstation.px4 import log_fetch, log_transfer
from groundstation.px4.agent_log_link import AgentLogLink
from groundstation.px4.log_fetch import listed
from groundstation.px4.log_transfer import ArmedInBetween
from onboard.agent.log_relay import LogRelay
from onboard.bus.protocol import Bus
from onboard.bus.topics import Topic
from onboard.config.fleet import Vehicle, load_fleet
from onboard.px4.mavsdk_link import Px4Link
from onboard.px4.packets import Packet, cut, packed
from sitl.mavlink.log_transfer import FileServer
from sitl.px4.flight_log import FlightLogs
from tests.groundstation.conftest import telemetry
from tests.groundstation.px4.test_log_fetch import SENDER, card

TICK_NS = 20_000_000
FILE_TRANSFER = 110
IDS_BYTES = 3  # network, system and component, before the payload of file transfer


class AgentOfOne:
    """An agent's relay between a ground and the emulator's server of files, without sockets.

    Args:
        vehicle: the vehicle of the agent.
        logs: the logs on its card.
        loses: numbers of pieces that are lost on the bus.
    """

    def __init__(self, vehicle: Vehicle, logs: FlightLogs, loses: Callable[[int], bool]) -> None:
        self.system_id = vehicle.system_id
        self.on_log_answer: Any = None
        self.is_disarmed = True
        self._name = vehicle.name
        self._files = FileServer(logs)
        self._loses = loses
        self._receivers: dict[Topic, Any] = {}
        self._count = 0
        self._now_ns = 0
        self.relay = LogRelay(vehicle.name, cast(Px4Link, self), cast(Bus, self))
        self.relay.start()

    # -- as the bus ---

    def collect(self, topic: Topic, _name: str, on_message: Any, *, most: int) -> None:
        self._receivers[topic] = on_message

    def subscribe(self, topic: Topic, _name: str, on_message: Any) -> None:
        self._receivers[topic] = on_message

    def publish(self, topic: Topic, name: str, message: Any) -> None:
        if topic is Topic.LOG_PIECES:
            self._count += 1
            if self._loses(self._count):
                return
        self._receivers[topic](topic, name, message)
        if topic is Topic.LOG_REQUEST:
            self.tick()

    def tell(self, **changes: Any) -> None:
        message = telemetry(self._name, **changes)
        self._receivers[Topic.TELEMETRY](Topic.TELEMETRY, self._name, message)

    def tick(self) -> None:
        """Let the agent tick until PX4 has nothing more to send."""
        for _ in range(40):
            self._now_ns += TICK_NS
            self.relay.step(is_disarmed=self.is_disarmed, now_ns=self._now_ns)
            for payload, _ in self._files.due(0.0):
                self._answer(payload)

    # -- as the link to PX4 ---

    def request_log(self, number: int, payload: bytes) -> None:
        assert number == FILE_TRANSFER
        padded = payload.ljust(254, b"\0")
        answer = self._files.answer(padded[IDS_BYTES:], SENDER, 0.0)
        if answer is not None:
            self._answer(answer)

    def _answer(self, payload: bytes) -> None:
        ids = bytes((0, *SENDER))
        (packet,) = cut(packed(FILE_TRANSFER, ids + payload, 0, self.system_id, 1))
        assert isinstance(packet, Packet)
        self.on_log_answer(packet)


@pytest.fixture
def vehicle() -> Vehicle:
    return load_fleet("paper").vehicles["mav0"]


@pytest.mark.parametrize("every", [0, 5])
def test_a_log_comes_whole_though_every_fifth_message_is_lost(
    vehicle: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, every: int
) -> None:
    # all answers are there when a request returns, so what is missing is lost
    monkeypatch.setattr(log_transfer, "_ANSWER_S", 0.02)
    monkeypatch.setattr(log_transfer, "_SILENT_S", 0.02)
    logs = card(60_000)
    agent = AgentOfOne(vehicle, logs, lambda number: every > 0 and number % every == 0)
    link = AgentLogLink(vehicle, cast(Bus, agent))
    agent.tell()

    (log,) = listed(link, 1)
    target = tmp_path / "a.ulg"
    log_fetch._fetched(link, log, target, "mav0", lambda *_: None)

    assert target.read_bytes() == bytes(logs.files[0].writer.content)


def test_a_fetch_ends_when_the_agent_reports_an_armed_vehicle(vehicle: Vehicle) -> None:
    agent = AgentOfOne(vehicle, card(100), lambda number: False)
    link = AgentLogLink(vehicle, cast(Bus, agent))
    agent.tell()
    assert len(listed(link, 1)) == 1

    agent.tell(is_armed=True)
    with pytest.raises(ArmedInBetween):
        listed(link, 1)
