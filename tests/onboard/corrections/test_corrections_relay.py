"""The node of corrections: in its process, and what it says of its source."""

from __future__ import annotations

import asyncio
import copy
import random
import re
import signal
import subprocess
import sys
import threading
import tomllib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from groundstation.processes.free_ports import toml_text, with_free_ports
from onboard.bus.codec import Malformed
from onboard.bus.schema import Corrections, Message
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, fleet_from_mapping, load_fleet
from onboard.corrections.relay import corrections_relay
from onboard.corrections.relay.corrections_relay import CorrectionsRelay, FramePublisher
from onboard.corrections.relay.source_error import SourceError
from onboard.exit_status import EXIT_FAILED, EXIT_NO_ANSWER, EXIT_OK
from tests.onboard.corrections.rtcm_frames import base_frame, epoch, observations, recording

_PAPER = Path(__file__).parents[3] / "configs/fleets/paper.toml"


def fleet_file(folder: Path, **table) -> Path:
    data = tomllib.loads(_PAPER.read_text())
    for kind in data["types"].values():
        kind["mocap_required"] = False
    data = copy.deepcopy(with_free_ports(data, fleet_from_mapping(data)))
    data["corrections"] = {"source": "file", "address": "base.rtcm3", **table}
    path = folder / "fleet.toml"
    path.write_text(toml_text(data))
    return path


def relay_of(fleet: FleetConfig, *pieces: bytes | SourceError) -> tuple[CorrectionsRelay, list]:
    """A relay without a bus, whose source sends these pieces and hangs then; and what it says."""
    said: list[str] = []

    async def source() -> AsyncIterator[bytes]:
        for piece in pieces:
            if isinstance(piece, SourceError):
                raise piece
            yield piece
        await asyncio.Event().wait()

    return CorrectionsRelay(fleet, source, said.append, publishes=False), said


async def run(relay: CorrectionsRelay) -> int:
    return await relay.run(seconds=0.05, every_s=10.0, stopped=asyncio.Event())


@pytest.fixture
def fleet(tmp_path: Path) -> FleetConfig:
    return load_fleet(fleet_file(tmp_path))


async def test_a_base_is_told_with_its_place_and_its_messages(fleet: FleetConfig):
    relay, said = relay_of(fleet, base_frame(), *epoch(0))
    assert await run(relay) == EXIT_OK
    assert "base 1234 at 47.3977420, 8.5455940, 536.90 m above the ellipsoid" in said[1]
    assert "(1005 1077 1087 1097)" in said[1]


async def test_the_rate_is_that_of_the_time_since_the_last_report(fleet: FleetConfig):
    relay, said = relay_of(fleet, base_frame(), *epoch(0))
    await run(relay)  # 4 messages, and a report after 0.05 s in place of 10 s
    (rate,) = re.findall(r"([\d.]+) messages/s", said[1])
    assert 4 / 10.0 < float(rate) <= 4 / 0.05


async def test_a_source_that_sends_nothing_is_told(fleet: FleetConfig):
    relay, said = relay_of(fleet)
    assert await run(relay) == EXIT_NO_ANSWER
    assert "no frame has come yet" in said[1]


async def test_garbage_and_wrong_checksums_are_counted_and_go_nowhere(fleet: FleetConfig):
    damaged = bytearray(observations())
    damaged[100] ^= 1
    garbage = random.Random(1).randbytes(10_000)
    relay, said = relay_of(fleet, garbage, bytes(damaged), 1100 * b"\0")
    published: list[bytes] = []
    relay.publisher.publish = lambda frame, now_ns: published.append(frame)  # type: ignore[method-assign]
    assert await run(relay) == EXIT_NO_ANSWER
    assert published == []
    assert "frames with a wrong checksum" in said[2]
    assert "not passed on" in said[2]


async def test_observations_without_a_base_are_not_enough(fleet: FleetConfig):
    relay, said = relay_of(fleet, *epoch(0))
    assert await run(relay) == EXIT_FAILED
    assert "has not said where it is" in said[1]


async def test_a_frame_that_mavlink_cannot_carry_is_told(fleet: FleetConfig):
    relay, said = relay_of(fleet, base_frame(), observations(size=900))
    assert await run(relay) == EXIT_OK
    assert "A message has 906 bytes, and 720 fit" in said[2]
    assert "MSM4 instead of MSM7" in said[2]


async def test_a_base_elsewhere_than_surveyed_is_told(tmp_path: Path):
    fleet = load_fleet(fleet_file(tmp_path, base_deg=[47.397742, 8.545]))
    relay, said = relay_of(fleet, base_frame(), *epoch(0))
    assert await run(relay) == EXIT_FAILED
    assert "The base is not where it was surveyed, by 44.7 m" in said[2]


async def test_a_source_that_refuses_is_told_once(
    fleet: FleetConfig, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(corrections_relay, "_REFUSED_PAUSE_S", 0.001)
    relay, said = relay_of(
        fleet, SourceError("The caster wants another password.", is_refusal=True)
    )
    assert await run(relay) == EXIT_NO_ANSWER
    told = [line for line in said if "another password" in line]
    assert told == ["  ! The caster wants another password. It is tried again."]


async def test_a_source_that_breaks_off_is_opened_again(
    fleet: FleetConfig, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(corrections_relay, "_FIRST_PAUSE_S", 0.0)
    half = observations()[:100]
    relay, _ = relay_of(fleet, half, base_frame()[:3], SourceError("It has ended the stream."))
    opened = 0
    first = relay._open_source

    def open_source() -> AsyncIterator[bytes]:
        nonlocal opened
        opened += 1
        if opened == 1:
            return first()
        return relay_of(fleet, base_frame(), *epoch(0))[0]._open_source()

    relay._open_source = open_source
    # what was begun before the break is not continued behind it
    assert await run(relay) == EXIT_OK
    assert opened == 2


class _Bus:
    node = "corrections"

    def __init__(self) -> None:
        self.sent: list[Corrections] = []

    def publish(self, topic: Topic, name: str, message: Corrections) -> None:
        assert (topic, name) == (Topic.CORRECTIONS, "base")
        self.sent.append(message)


def test_more_than_the_radio_should_carry_is_not_passed_on():
    bus = _Bus()
    publisher = FramePublisher(bus)  # type: ignore[arg-type]
    frame = observations(size=594)
    for number in range(100):  # 60 kB within a second
        publisher.publish(frame, 10_000_000 * number)
    assert len(bus.sent) == 10 + 9
    assert publisher.dropped == 100 - len(bus.sent)

    publisher.publish(frame, 3_000_000_000)
    assert [message.sequence for message in bus.sent] == list(range(1, 21))


@pytest.mark.realtime
def test_the_command_publishes_each_frame_once_on_the_bus(tmp_path: Path):
    path = fleet_file(tmp_path)
    (tmp_path / "base.rtcm3").write_bytes(recording(3))
    fleet = load_fleet(path)
    heard: list[bytes] = []
    enough = threading.Event()

    def hear(_topic: Topic, _name: str, message: Message | Malformed) -> None:
        assert isinstance(message, Corrections)
        heard.append(message.frame)
        if len(heard) >= 7:
            enough.set()

    agent = BusSession(
        namespace=fleet.namespace, node="mav0", listen=[fleet.vehicles["mav0"].agent]
    )
    agent.start()
    agent.subscribe(Topic.CORRECTIONS, "*", hear)
    words = [sys.executable, "-m", "groundstation", "corrections", "--fleet", str(path)]
    process = subprocess.Popen(
        [*words, "--every-s", "0.5"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        assert enough.wait(20.0)
    finally:
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=20.0)
        agent.stop()

    assert process.returncode == EXIT_OK, output
    assert "base 1234 at" in output
    # the node began before this end was there: from some moment on nothing is missing or double
    frames = [base_frame(), *epoch(0), *epoch(1), *epoch(2)]
    first = frames.index(heard[0])
    assert heard == [frames[(first + number) % len(frames)] for number in range(len(heard))]


@pytest.mark.realtime
def test_a_recording_that_is_not_there_ends_the_command_in_a_sentence(tmp_path: Path):
    path = fleet_file(tmp_path, address="missing.rtcm3")
    words = [sys.executable, "-m", "groundstation", "corrections", "--fleet", str(path)]
    done = subprocess.run(
        [*words, "--check", "--seconds", "20"], capture_output=True, text=True, timeout=60.0
    )
    assert done.returncode == 2
    assert "there is no such recording of RTCM" in done.stderr
