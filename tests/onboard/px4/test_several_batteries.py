"""A PX4 with several battery monitors reports each of them, also those that measure nothing."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator

import pytest

from tests.onboard.px4.wire import wired

_NO_CELL_MV = 65535
_NOT_KNOWN = -1
# charge [%] and voltage [mV] of a monitor to which nothing is connected
_EMPTY_PORT = (_NOT_KNOWN, _NO_CELL_MV)

Battery = tuple[float, float]
Send = Callable[..., Battery]


@pytest.fixture
def send() -> Iterator[Send]:
    """Have PX4 send one report of each monitor, and return the link's charge and voltage."""
    boot_ms = iter(range(1000, 10_000_000, 20))
    with wired() as wire:

        def send_reports(
            *reports: tuple[int, int], is_read_between: bool = False
        ) -> tuple[float, float]:
            for monitor, (charge_pct, voltage_mv) in enumerate(reports):
                voltages_mv = [voltage_mv] + [_NO_CELL_MV] * 9
                report = wire.mav.battery_status_encode(
                    monitor, 0, 0, 2500, voltages_mv, _NOT_KNOWN, _NOT_KNOWN, _NOT_KNOWN, charge_pct
                )
                wire.send(report)
                if is_read_between:
                    time.sleep(0.1)
                    wire.link.snapshot()
            return wire.attitude(next(boot_ms)).battery(time.monotonic_ns())

        yield send_reports


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
