"""Vehicles that are out of service: orders to all, missions and preflight go on without them."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from groundstation.client.preflight_page import as_text, page_of
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions.api import Fleet
from groundstation.missions.runner import MissionRun
from onboard.config.fleet import FleetConfig

OFF = {"disabled_by": "olga", "not_ready": ("mav1 is disabled by olga.",), "state": "waiting"}


@pytest.fixture
async def serviced(bus: Any, client: Any) -> Any:
    """A client that has heard that mav1 is out of service."""
    bus.tell("mav1", **OFF)
    assert await client.wait_for(lambda state: state.vehicles["mav1"].is_disabled, 5.0)
    return client


def ordered(bus: Any, kind: str) -> list[str]:
    return [name for name, order in bus.orders if order.kind == kind]


async def test_an_order_to_all_leaves_it_out_and_one_that_names_it_does_not(
    serviced: Any,
) -> None:
    assert set(serviced.plan("takeoff all 1.0").orders) == {"mav0", "mav2"}
    assert set(serviced.plan("takeoff mav1 1.0").orders) == {"mav1"}
    assert set(serviced.plan("land all").orders) == {"mav0", "mav1", "mav2"}
    assert set(serviced.plan("enable mav1").orders) == {"mav1"}


async def test_a_mission_flies_without_it_and_passes(
    fleet: FleetConfig, serviced: Any, bus: Any
) -> None:
    steps = [{"do": "takeoff", "height_m": 1.0}, {"do": "land"}]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="t.toml", fleet=fleet)
    lines: list[str] = []
    verdict = await asyncio.wait_for(MissionRun(mission, serviced, say=lines.append).run(), 20.0)
    assert verdict.passed, verdict.summary
    assert verdict.exit_status == 0
    assert ordered(bus, "takeoff") == ["mav0", "mav2"]
    assert "The mission goes on without mav1." in lines


async def test_preflight_says_that_it_is_left_out_and_lets_the_others_go(
    fleet: FleetConfig, serviced: Any
) -> None:
    page = page_of(serviced.state.vehicles["mav1"], fleet, serviced.now_ns())
    assert page.is_go
    text = " ".join(as_text([page]).split())
    assert "mav1 is disabled by olga: flights go on without it." in text
    assert "enable mav1" in text


async def test_scripts_disable_and_enable(client: Any, bus: Any) -> None:
    flown = Fleet(client)
    await flown.disable("mav1")
    assert flown.names == ("mav0", "mav2")
    await flown.enable("mav1")
    assert flown.names == ("mav0", "mav1", "mav2")
    assert ordered(bus, "disable") == ordered(bus, "enable") == ["mav1"]
