"""Addresses that a person writes for the emulator."""

from __future__ import annotations

import pytest

from sitl.mavlink.endpoints import StartError, station_of


def test_the_name_of_a_ground_station_is_resolved_once() -> None:
    assert station_of("localhost:14550") == ("127.0.0.1", 14550)
    assert station_of("192.168.1.7:14551") == ("192.168.1.7", 14551)
    assert station_of(":14550") == ("127.0.0.1", 14550)


@pytest.mark.parametrize("text", ["h:\u00b2", "nowhere", "here:there", "127.0.0.1:0", "h:70000"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(StartError, match="is no address of a ground station"):
        station_of(text)


@pytest.mark.parametrize("host", ["a..b", "x" * 70])
def test_a_host_that_is_not_known_is_refused(host: str) -> None:
    with pytest.raises(StartError, match="is not known"):
        station_of(f"{host}:14550")
