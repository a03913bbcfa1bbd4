"""A PX4 with several battery monitors reports each of them, also those that measure nothing."""

from __future__ import annotations

import math
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink

from onboard.px4.mavsdk_link import Px4Link

_SYSTEM = 9
_NO_CELL_MV = 65535
_NOT_KNOWN = -1
# charge [%] and voltage [mV] of a monitor to which nothing is connected
_EMPTY_PORT = (_NOT_KNOWN, _NO_CELL_MV)

Battery = tuple[float, float]
Send = Callable[..., Battery]


@pytest.fixture
def send() -> Iterator[Send]:
    """Have PX4 send one report of each monitor, and return the link's charge and voltage."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    link = Px4Link(f"udpin://127.0.0.1:{port}", _SYSTEM)
    mav = mavlink.MAVLink(None, _SYSTEM, 1)
    boot_ms = iter(range(1000, 10_000_000, 20))

    link.start()
    px4 = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send_reports(
        *reports: tuple[int, int], is_read_between: bool = False
    ) -> tuple[float, float]:
        last_ns = link.snapshot().attitude_ns
        for monitor, (charge_pct, voltage_mv) in enumerate(reports):
            voltages_mv = [voltage_mv] + [_NO_CELL_MV] * 9
            report = mav.battery_status_encode(
                monitor, 0, 0, 2500, voltages_mv, _NOT_KNOWN, _NOT_KNOWN, _NOT_KNOWN, charge_pct
            )
            px4.sendto(report.pack(mav), ("127.0.0.1", port))
            if is_read_between:
                time.sleep(0.1)
                link.snapshot()

        # an attitude after them shows that the link has received all reports
        attitude = mav.attitude_quaternion_encode(next(boot_ms), 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        px4.sendto(attitude.pack(mav), ("127.0.0.1", port))
        end_s = time.monotonic() + 10.0
        while link.snapshot().attitude_ns == last_ns:
            assert time.monotonic() < end_s
            time.sleep(0.005)
        return link.snapshot().battery(time.monotonic_ns())

    try:
        with closing(px4):
            yield send_reports
    finally:
        link.stop()


@pytest.mark.parametrize("is_read_between", [False, True], ids=["at once", "one by one"])
def test_a_port_without_a_battery_hides_no_battery(send: Send, is_read_between: bool) -> None:
    charged = (80, 16_000)

    assert send(charged, _EMPTY_PORT, is_read_between=is_read_between) == (0.8, 16.0)
    assert send(_EMPTY_PORT, charged, is_read_between=is_read_between) == (0.8, 16.0)


def test_the_weakest_of_several_batteries_counts_and_their_voltages_do_not_alternate(
    send: Send,
) -> None:
    assert send((80, 16_000), (30, 12_000)) == (0.3, 16.0)
    assert send((20, 16_000), (30, 12_000)) == (0.2, 16.0)


def test_a_battery_that_comes_off_is_not_known_any_more(send: Send) -> None:
    assert send((80, 16_000), _EMPTY_PORT) == (0.8, 16.0)

    charge_frac, voltage_v = send(_EMPTY_PORT, _EMPTY_PORT)
    assert math.isnan(charge_frac)
    assert voltage_v == 0.0
