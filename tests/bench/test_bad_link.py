"""The link of the network benchmark: what it loses, how long it takes, and the ages of states over it."""

from __future__ import annotations

import itertools
import socket
from pathlib import Path

import pytest

from tests.bench.network.bad_link import BadLink, Direction, LinkQuality
from tests.bench.network.bench import measure


@pytest.mark.parametrize("burst", [1.0, 3.0])
def test_a_direction_loses_its_share_in_bursts_of_their_mean_length(burst: float) -> None:
    direction = Direction(LinkQuality(delay_s=0.0, loss=0.05, burst=burst), seed=4)
    passed = []
    for number in range(100_000):
        direction.push(float(number), b"x")
        passed.append(bool(direction.pop(float(number))))
    runs = [len(list(run)) for has_passed, run in itertools.groupby(passed) if not has_passed]
    assert passed.count(False) == pytest.approx(5000, rel=0.1)
    assert sum(runs) / len(runs) == pytest.approx(max(burst, 1.0 / 0.95), rel=0.06)


def test_packets_are_late_doubled_overtaken_and_cut() -> None:
    direction = Direction(LinkQuality(delay_s=0.02, duplicate=1.0), seed=4)
    direction.push(1.0, b"x")
    assert direction.pop(1.019) == []
    assert direction.pop(1.021) == [b"x", b"x"]
    direction = Direction(LinkQuality(delay_s=0.02, reorder=0.5), seed=4)
    sent = [bytes([number]) for number in range(50)]
    for number, packet in enumerate(sent):
        direction.push(0.005 * number, packet)
    received = direction.pop(9.0)
    assert sorted(received) == sent != received
    direction.is_cut = True
    direction.push(9.0, b"x")
    assert direction.pop(10.0) == []


def test_a_link_carries_packets_both_ways() -> None:
    (one, near), (two, far) = (socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(2))
    with one, near, two, far:
        one.settimeout(5.0)
        two.settimeout(5.0)
        link = BadLink(near.fileno(), far.fileno(), LinkQuality(delay_s=0.001))
        link.start()
        one.send(b"there")
        assert two.recv(100) == b"there"
        two.send(b"back")
        assert one.recv(100) == b"back"
        link.stop()


@pytest.mark.long
@pytest.mark.parametrize("link", ["5 % independent", "5 % in bursts of 3"])
def test_a_state_by_datagrams_is_young_over_a_bad_link(link: str, tmp_path: Path) -> None:
    try:
        age = measure("quic", link, 20.0, tmp_path)
    except OSError as error:
        pytest.skip(str(error))
    assert age.bound_ms is not None
    assert age.p99_ms <= age.bound_ms
