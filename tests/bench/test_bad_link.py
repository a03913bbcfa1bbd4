"""The link of the network benchmark: what it loses, how long it takes, and the ages of states over
it.
"""

from __future__ import annotations

import itertools
import socket
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.bench.network.bad_link import BadLink, Direction, LinkQuality
from tests.bench.network.bench import LONGEST_COST_S, main, measure, measure_links
from tests.bench.network.crossing import conditions
from tests.bench.network.hub import Hub
from tests.bench.network.partition import HALVES, Flight, fly


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
    (one, near), (two, far) = (
        socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(2)
    )
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


def test_a_hub_carries_to_the_address_and_nothing_between_the_sides_while_they_are_cut(
    tmp_path: Path,
) -> None:
    addresses = [socket.inet_aton(f"10.77.0.{number}") for number in (1, 2, 3)]
    with ExitStack() as stack:
        stack.enter_context(Hub(tmp_path / "hub", ["10.77.0.1"], ["10.77.0.2"]))
        hosts = []
        lines = []
        for address in addresses:
            host, tun = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            line = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
            tun.setblocking(False)
            line.connect(str(tmp_path / "hub"))
            socket.send_fds(line, [address], [tun.fileno()])
            tun.close()
            assert line.recv(1) == b"g"
            host.settimeout(5.0)
            hosts.append(stack.enter_context(host))
            lines.append(line)

        def received(sender: int, receiver: int) -> bytes:
            """What arrives first, of a packet to the receiver and one to it from the third host."""
            hosts[sender].send(bytes(16) + addresses[receiver] + b"x")
            hosts[2].send(bytes(16) + addresses[receiver] + b"third")
            first = hosts[receiver].recv(100)
            return (
                first[20:]
                if first[20:] == b"third"
                else first[20:] + hosts[receiver].recv(100)[20:]
            )

        assert received(0, 1) == b"xthird"
        lines[0].send(b"cut")
        while received(0, 1) != b"third":
            continue
        assert received(1, 0) == b"third"
        lines[0].send(b"heal")
        while received(0, 1) == b"third":
            continue


def _flown() -> Flight:
    first, second = HALVES
    told: dict[str, Any] = {}
    for half, others in (HALVES, HALVES[::-1]):
        lost = "" if half is first else "12:00:00,000 mav5 INFO Ground station lost: going on.\n"
        names = ", ".join(others)
        silent = f"INFO Neighbour silent ({names}): going on.\n"
        heard = f"INFO Neighbour heard again ({names}): going on.\n"
        log = silent + lost + heard
        told |= dict.fromkeys(half, conditions(log))
    done = dict.fromkeys((*first, *second), "")
    return Flight(at_s=3.0, nearest_m=0.9, ends=done, returns=done, has_landed=True, told=told)


def test_the_verdict_of_a_partition_knows_what_is_wrong() -> None:
    good = _flown()
    assert good.problems() == []
    assert "0.79 m" in replace(good, nearest_m=0.79).problems()[0]
    assert (
        "mav4: no end"
        in replace(good, ends={k: v for k, v in good.ends.items() if k != "mav4"}).problems()[0]
    )
    assert (
        "mav1 did not fly back"
        in replace(good, returns={**good.returns, "mav1": "late"}).problems()[0]
    )
    assert replace(good, has_landed=False).problems() == ["not all have landed"]
    unheard = good.told["mav5"][:-1]
    assert len(replace(good, told={**good.told, "mav5": unheard}).problems()) == 3
    hold = [
        *good.told["mav0"],
        *conditions("INFO Neighbour silent and not seen (mav3): holding.\n"),
    ]
    assert "holding" in replace(good, told={**good.told, "mav0": hold}).problems()[0]


def test_nonsense_is_refused_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--flights", "0"]) == 2
    assert "give" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.timeout(240)
def test_a_flying_fleet_that_is_cut_in_two_keeps_its_distance_and_goes_on(tmp_path: Path) -> None:
    try:
        flight = fly(2.5, 10.0, tmp_path)
    except OSError as error:
        pytest.skip(str(error))
    assert flight.problems() == []


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize("scheme", ["quic", "tls"])
def test_links_open_over_600_ms_and_an_outage_of_one_second_costs_little_more(
    scheme: str, tmp_path: Path
) -> None:
    try:
        openings, outages = measure_links([scheme], tmp_path)
    except OSError as error:
        pytest.skip(str(error))
    assert all(one.opened_s is not None for one in openings), openings
    for one in outages:
        if one.lasts_s <= 1.0:
            assert one.longest_age_s <= LONGEST_COST_S, outages


@pytest.mark.long
@pytest.mark.parametrize("link", ["5 % independent", "5 % in bursts of 3"])
def test_a_state_by_datagrams_is_young_over_a_bad_link(link: str, tmp_path: Path) -> None:
    try:
        age = measure("quic", link, 20.0, tmp_path)
    except OSError as error:
        pytest.skip(str(error))
    assert age.bound_ms is not None
    assert age.p99_ms <= age.bound_ms
