"""A wire loses, delays, duplicates and reorders by its seed; a link behind it hangs, answers late
and restarts.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from sitl.emulator.emulator import Emulator
from sitl.faults.catalogue import parse
from sitl.faults.lossy_channel import NO_FAULTS, ChannelFaults, LossyChannel
from sitl.mavlink.codec import Decoder, MavlinkMessage
from sitl.mavlink.lossy_link import LossyLink
from sitl.mavlink.streams import ONBOARD_RATES_HZ
from tests.sitl.sitl_flying import CLIENT, emulator

STEP_S = 0.004


def through(faults: ChannelFaults, count: int = 4000, seed: int = 1) -> list[tuple[float, int]]:
    """(arrival, number) of numbers that are sent one per step."""
    channel: LossyChannel[int] = LossyChannel(seed)
    channel.faults = faults
    out = []
    for k in range(count + 1000):
        if k < count:
            channel.push(k * STEP_S, k)
        out += [(k * STEP_S, number) for number in channel.pop(k * STEP_S)]
    return out


def test_without_faults_everything_comes_out_at_once_and_in_order() -> None:
    assert through(NO_FAULTS) == [(k * STEP_S, k) for k in range(4000)]
    assert LossyChannel[int]().is_clear


def test_the_requested_share_is_lost_or_comes_twice() -> None:
    assert len(through(ChannelFaults(loss=0.3))) / 4000 == pytest.approx(0.7, abs=0.03)
    assert len(through(ChannelFaults(duplicate=0.25))) / 4000 == pytest.approx(1.25, abs=0.03)
    assert through(ChannelFaults(loss=1.0)) == []


def test_delay_and_jitter_keep_the_order() -> None:
    out = through(ChannelFaults(delay_s=0.1, jitter_s=0.05))
    late_s = np.array([arrival - number * STEP_S for arrival, number in out])
    assert late_s.min() >= 0.1 - 1e-9
    assert late_s.max() <= 0.155
    assert [number for _, number in out] == list(range(4000))


def test_reordering_lets_some_be_overtaken() -> None:
    order = [number for _, number in through(ChannelFaults(reorder=0.2, reorder_s=0.02))]
    overtaken = sum(1 for a, b in itertools.pairwise(order) if b < a)
    assert sorted(order) == list(range(4000))
    assert 400 < overtaken < 1000


def test_equal_seeds_give_equal_chance() -> None:
    faults = ChannelFaults(loss=0.1, delay_s=0.02, jitter_s=0.01, duplicate=0.1, reorder=0.1)
    assert through(faults) == through(faults)
    assert through(faults) != through(faults, seed=2)


def test_a_wire_that_is_held_gives_all_out_in_order_when_it_goes_on() -> None:
    channel: LossyChannel[int] = LossyChannel()
    channel.is_held = True
    for k in range(5):
        channel.push(k * STEP_S, k)
    assert channel.pop(10.0) == []
    channel.is_held = False
    assert channel.pop(10.0) == [0, 1, 2, 3, 4]


def test_a_wire_does_not_grow_without_end() -> None:
    channel: LossyChannel[int] = LossyChannel()
    channel.faults = ChannelFaults(delay_s=10.0)
    for k in range(30_000):
        channel.push(0.0, k)
    assert len(channel.pop(11.0)) == 10_000


class Client:
    """A companion behind a wired link."""

    def __init__(self, emu: Emulator) -> None:
        self.emulator = emu
        self.link = LossyLink(emu, 0, ONBOARD_RATES_HZ, "companion")
        self._decoder = Decoder()

    def send(self, name: str, **fields: object) -> list[MavlinkMessage]:
        return self._decode(self.link.receive(CLIENT.encode_named(name, **fields)))

    def step(self, duration_s: float) -> list[MavlinkMessage]:
        out: list[MavlinkMessage] = []
        for _ in range(round(duration_s / STEP_S)):
            self.emulator.step()
            out += self._decode(self.link.poll())
        return out

    def _decode(self, datagrams: list[bytes]) -> list[MavlinkMessage]:
        return [message for datagram in datagrams for message in self._decoder.decode(datagram)]


def names(messages: list[MavlinkMessage]) -> set[str]:
    return {message.name for message in messages}


def test_a_lossy_link_loses_that_share_of_the_stream_in_that_direction_only() -> None:
    emu = emulator()
    client = Client(emu)
    client.step(2.0)
    full = len(client.step(2.0))
    emu.inject(parse("v0 link_loss share=0.5 direction=out"))
    assert len(client.step(2.0)) / full == pytest.approx(0.5, abs=0.08)
    emu = emulator()
    client = Client(emu)
    emu.inject(parse("v0 link_loss direction=in"))
    client.step(2.0)
    assert (
        client.send(
            "PARAM_REQUEST_READ", param_id=b"COM_OF_LOSS_T", param_index=-1, target_system=1
        )
        == []
    )
    assert "ATTITUDE" in names(client.step(1.0))
    assert "PARAM_VALUE" not in names(client.step(1.0))


def test_a_slow_link_answers_after_both_delays() -> None:
    emu = emulator()
    client = Client(emu)
    emu.inject(parse("v0 link_delay delay_s=0.1"))
    client.step(2.0)
    assert (
        client.send(
            "PARAM_REQUEST_READ", param_id=b"COM_OF_LOSS_T", param_index=-1, target_system=1
        )
        == []
    )
    assert "PARAM_VALUE" not in names(client.step(0.19))
    assert "PARAM_VALUE" in names(client.step(0.04))


def test_a_hung_autopilot_is_silent_and_then_answers_the_requests_that_came_meanwhile() -> None:
    emu = emulator()
    client = Client(emu)
    client.step(5.0)
    emu.inject(parse("v0 autopilot_hang duration=2"))
    client.step(0.1)
    assert (
        client.send(
            "PARAM_REQUEST_READ", param_id=b"COM_OF_LOSS_T", param_index=-1, target_system=1
        )
        == []
    )
    assert client.step(1.8) == []
    after = client.step(0.5)
    assert {"PARAM_VALUE", "ATTITUDE"} <= names(after)
    stamps = [message.fields["time_boot_ms"] for message in after if message.name == "ATTITUDE"]
    assert stamps[0] < 5200


def test_a_restart_begins_the_stream_anew_with_its_default_rates_and_clock() -> None:
    emu = emulator()
    client = Client(emu)
    client.step(5.0)
    client.send(
        "COMMAND_LONG", command=511, param1=30.0, param2=-1.0, target_system=1, target_component=1
    )
    assert "ATTITUDE" not in names(client.step(1.0))
    emu.inject(parse("v0 autopilot_reboot"))
    again = client.step(2.0)
    stamps = [message.fields["time_boot_ms"] for message in again if message.name == "ATTITUDE"]
    assert 1300 < stamps[0] < 1500  # as PX4 v1.16 sends its first ATTITUDE
    assert client.link.boot == 1
