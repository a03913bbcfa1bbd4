"""The settings of links: how long one may take to open, and how long it may be silent."""

from __future__ import annotations

from typing import Any

import pytest

from onboard.bus import zenoh_settings
from onboard.bus.zenoh_settings import of_client, of_node, of_router

QUIC = "quic/127.0.0.1:7460"
TCP = "tcp/127.0.0.1:7460"


def _open_ms(found: list[zenoh_settings.Setting]) -> Any:
    return dict(found)["transport/unicast/open_timeout"]


def _lease_ms(found: list[zenoh_settings.Setting]) -> Any:
    return dict(found)["transport/link/tx/lease"]


def test_a_link_has_time_for_four_of_the_longest_round_trips() -> None:
    longest_ms = 4e3 * zenoh_settings.LONGEST_ROUND_TRIP_S
    assert _open_ms(of_node([QUIC], [], None)) > longest_ms
    assert _open_ms(of_client([QUIC], 1.0, None)) > longest_ms


@pytest.mark.parametrize(("scheme", "round_trips"), [("quic", 3), ("tls", 4)])
def test_a_router_beside_others_has_time_for_the_longest_round_trips(
    scheme: str, round_trips: int
) -> None:
    two = [f"{scheme}/127.0.0.1:7460", f"{scheme}/127.0.0.1:7461"]
    longest_ms = 1e3 * round_trips * zenoh_settings.longest_round_trip_s(two)
    assert _open_ms(of_client(two, 1.0, None)) > longest_ms


def test_the_next_of_several_routers_is_tried_soon() -> None:
    two = [QUIC, "quic/127.0.0.1:7461"]
    assert _open_ms(of_client(two, 1.0, None)) == 500
    assert zenoh_settings.longest_round_trip_s(two) < zenoh_settings.longest_round_trip_s(two[:1])


def test_a_quic_link_is_closed_a_little_after_an_outage_of_a_second() -> None:
    assert _lease_ms(of_node([QUIC], [], None)) == 1100
    assert _lease_ms(of_node([], [QUIC], None)) == 1100
    assert _lease_ms(of_node([TCP], [TCP], None)) == 1000


def test_a_router_beside_others_is_missed_sooner_than_a_single_one() -> None:
    assert _lease_ms(of_router(QUIC, [TCP], None)) == 500
    assert _lease_ms(of_router(QUIC, [], None)) == 1100
