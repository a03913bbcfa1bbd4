"""Whatever arrives at a link: no exception, no hang, no memory; the flight goes on in noise."""

from __future__ import annotations

import itertools
import math
import random
import resource
import socket
import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from sitl.mavlink.endpoints import Endpoint
from tests.clients.running import Running
from tests.sitl.conformance.fuzz import HOSTILE, NOISE, Source, datagrams, frame
from tests.sitl.conformance.virtual import GROUND, LISTENER, Address, Wires

_FEW = 20_000
_MANY = 1_000_000
_PER_STEP = 40
_FUZZER: Address = ("127.0.0.1", 50000)
_RING = 256
_PAGE_BYTES = resource.getpagesize()
_LARGEST_GROWTH_BYTES = 12e6


def _resident_bytes(process: int | str = "self") -> int:
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * _PAGE_BYTES


def _command(number: int, *numbers: float) -> bytes:
    message = common.MAVLink_command_long_message(
        1, 1, number, 0, *[*numbers, *[0.0] * (7 - len(numbers))]
    )
    return bytes(message.pack(common.MAVLink(None, srcSystem=245, srcComponent=190)))


def _run(wires: Wires, duration_s: float) -> None:
    end_s = wires.emulator.time_s + duration_s
    while wires.emulator.time_s < end_s:
        wires.step()


def _hovering() -> Wires:
    wires = Wires()
    _run(wires, 6.0)
    for command in (_command(22, *[math.nan] * 7), _command(400, 1.0)):
        wires.onboard.deliver(command, LISTENER)
    wires.ground.deliver(frame(0, bytes(4) + bytes((6, 8, 0, 4, 3)), 0), GROUND)
    _run(wires, 12.0)
    assert wires.emulator.autopilots[0].mode.name == "LOITER"
    return wires


def _pelt(wires: Wires, endpoint: Endpoint, sources: tuple[Source, ...], count: int) -> float:
    """Throw datagrams, let time pass in between; by how much memory grew over the second half."""
    half_bytes = 0
    for place, datagram in enumerate(datagrams(count, sources, seed=count)):
        endpoint.receive(datagram, _FUZZER)
        if place % _PER_STEP == 0:
            wires.step()
        if place == count // 2:
            half_bytes = _resident_bytes()
    return _resident_bytes() - half_bytes


_COUNTS = [_FEW, pytest.param(_MANY, marks=[pytest.mark.long, pytest.mark.timeout(1200)])]


@pytest.mark.parametrize("link", ["onboard", "ground"])
@pytest.mark.parametrize("count", _COUNTS)
def test_noise_on_a_link_changes_nothing_in_a_flight(link: str, count: int) -> None:
    wires = _hovering()
    twin = _hovering()
    grown_bytes = _pelt(wires, getattr(wires, link).endpoint, NOISE, count)
    while twin.emulator.time_s < wires.emulator.time_s:
        twin.step()
    autopilot = wires.emulator.autopilots[0]
    undisturbed = twin.emulator.autopilots[0]
    assert (autopilot.mode.name, autopilot.is_armed) == (
        undisturbed.mode.name,
        undisturbed.is_armed,
    )
    assert dict(autopilot.params.values) == dict(undisturbed.params.values)
    # To the last bit: nothing was drawn, delayed or nudged because of it.
    here, there = (each.emulator.world.vehicles.states.position_ned_m[0] for each in (wires, twin))
    assert here.tolist() == there.tolist()
    assert grown_bytes < _LARGEST_GROWTH_BYTES


@pytest.mark.parametrize("link", ["onboard", "ground"])
@pytest.mark.parametrize("count", _COUNTS)
def test_well_formed_nonsense_raises_nothing_and_the_link_answers_after_it(
    link: str, count: int
) -> None:
    wires = _hovering()
    grown_bytes = _pelt(wires, getattr(wires, link).endpoint, HOSTILE, count)
    _run(wires, 3.0)
    states = wires.emulator.world.vehicles.states
    assert all(math.isfinite(value) for value in states.position_ned_m[0])
    assert all(math.isfinite(value) for value in states.velocity_ned_m_s[0])
    answers: list[bytes] = []

    def outgoing(datagram: bytes) -> tuple[bytes]:
        answers.append(datagram)
        return (datagram,)

    wires.outgoing = outgoing
    port = wires.port(getattr(wires, link), LISTENER if link == "onboard" else GROUND)
    getattr(wires, link).endpoint.peer = LISTENER if link == "onboard" else GROUND
    port.send(_command(31999))
    port.receive(0.1)
    assert any(answer[7] == 77 for answer in answers)
    assert grown_bytes < _LARGEST_GROWTH_BYTES


@pytest.mark.parametrize("count", [_FEW, pytest.param(100_000, marks=pytest.mark.long)])
def test_a_second_sender_that_floods_the_socket_does_not_disturb_the_client(
    emulator: Running, count: int
) -> None:
    target = ("127.0.0.1", emulator.companion + 40)
    heartbeat = frame(0, bytes(4) + bytes((18, 8, 0, 4, 3)), 0, system_id=1)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as another_sender,
    ):
        client.bind(("127.0.0.1", emulator.companion))
        client.settimeout(20.0)
        client.recv(4096)
        client.sendto(heartbeat, target)
        time.sleep(0.3)
        client.setblocking(False)
        before_bytes = 0
        stamps = []
        for place, datagram in enumerate(datagrams(count, NOISE, seed=7)):
            another_sender.sendto(datagram, target)
            if place % 20 == 0:
                time.sleep(0.002)
                stamps += _attitude_stamps(client)
            if place == count // 2:
                before_bytes = _resident_bytes(emulator.process.pid)
        time.sleep(0.5)
        stamps += _attitude_stamps(client)
    assert emulator.process.poll() is None
    gaps_ms = [after - before for before, after in itertools.pairwise(stamps)]
    assert len(stamps) > 30
    assert sorted(gaps_ms)[len(gaps_ms) // 2] <= 16
    assert _resident_bytes(emulator.process.pid) - before_bytes < _LARGEST_GROWTH_BYTES


def _attitude_stamps(client: socket.socket) -> list[int]:
    stamps: list[int] = []
    while True:
        try:
            datagram = client.recv(4096)
        except BlockingIOError:
            return stamps
        if datagram[7:10] == b"\x1e\0\0":
            stamps.append(int.from_bytes(datagram[10:14], "little"))


def test_the_fuzzer_makes_every_kind_and_the_same_again() -> None:
    once = list(datagrams(500, NOISE + HOSTILE, 3))
    twice = list(datagrams(500, NOISE + HOSTILE, 3))
    assert once == twice
    assert {datagram[:1] for datagram in once} >= {b"\xfd", b"\xfe"}
    mav = common.MAVLink(None)
    r = random.Random(1)
    for source in HOSTILE[2:8]:
        assert mav.decode(bytearray(source(r, 0))).get_type() != "BAD_DATA"
