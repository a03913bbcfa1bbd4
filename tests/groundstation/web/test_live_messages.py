"""What the server says of the fleet's state to a page."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from groundstation.fleet.state import Separation
from groundstation.web.live_messages import state_message
from tests.groundstation.console.scenes import SteadyClient, crowd

PLACE = (1.0, 2.0, 1.5)


def said(client: SteadyClient) -> dict[str, Any]:
    """The state as the server says it to pages."""
    return state_message(
        client.state, client.fleet, alarms=(), control=None, now_ns=client.now_ns()
    )


def test_the_smallest_distance_is_that_of_telemetry_where_ground_truth_has_none_as_small() -> None:
    client = SteadyClient(crowd(3, side_m=8.0))
    client.state = msgspec.structs.replace(
        client.state,
        smallest=Separation("v000", "v001", 0.31, 1),
        smallest_truth=Separation("v001", "v002", 2.5, 1, is_truth=True),
    )
    smallest = said(client)["smallest"]
    assert (smallest["distance_m"], smallest["is_truth"]) == (0.31, False)


def test_a_vehicle_that_the_fleet_file_disables_is_told_once_it_is_heard() -> None:
    fleet = crowd(2, side_m=8.0)
    disabled = msgspec.structs.replace(fleet.vehicles["v000"], enabled=False)
    vehicles = {**fleet.vehicles, "v000": disabled}
    client = SteadyClient(msgspec.structs.replace(fleet, vehicles=vehicles))
    assert [one["name"] for one in said(client)["vehicles"]] == ["v001"]

    client.hear("v000", position_enu_m=PLACE)
    told = {one["name"]: one.get("position_enu_m") for one in said(client)["vehicles"]}
    assert told == {"v001": None, "v000": pytest.approx(PLACE)}


def test_a_vehicle_that_is_silent_or_has_no_position_is_told_where_it_was_last() -> None:
    client = SteadyClient(crowd(2, side_m=8.0))
    never, _ = said(client)["vehicles"]
    assert never["last_enu_m"] is None

    client.hear("v000", position_enu_m=PLACE)
    client.hear("v000", position_enu_m=(9.0, 9.0, 9.0), is_position_valid=False)
    without_position, _ = said(client)["vehicles"]
    assert without_position["position_enu_m"] is None
    assert without_position["last_enu_m"] == PLACE

    client.clock_ns += 60 * 10**9
    silent, _ = said(client)["vehicles"]
    assert not silent["is_fresh"]
    assert silent["last_enu_m"] == PLACE
