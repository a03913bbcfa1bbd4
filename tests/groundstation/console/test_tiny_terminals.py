"""A terminal with hardly any room, a fleet of none, and back."""

from __future__ import annotations

import pytest

from groundstation.console.app import ConsoleApp
from groundstation.console.widgets.fleet_table import FleetTable
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.scenes import SteadyClient, crowd, ground_and_sky, without
from tests.groundstation.console.seeing import lines, screen, see


async def test_a_fleet_of_none_and_a_tiny_terminal_are_drawn(fleet: FleetConfig) -> None:
    empty = without(fleet, *fleet.enabled_names)
    app = ConsoleApp(empty, SteadyClient(empty))
    async with app.run_test(size=(80, 24)) as pilot:
        await see(app, pilot)
        assert any("no vehicles" in line for line in lines(app, FleetTable))
        for key in ("down", "space", "asterisk", "s", "f", "plus", "enter"):
            await pilot.press(key)
        for size in [(20, 5), (5, 2), (1, 1), (80, 24)]:
            await pilot.resize_terminal(*size)
            await see(app, pilot)
        assert any("no vehicles" in line for line in lines(app, FleetTable))


@pytest.mark.parametrize("size", [(20, 5), (20, 24), (80, 5), (30, 8)])
async def test_on_a_tiny_terminal_the_worst_alarm_and_how_to_land_all_stay(
    fleet: FleetConfig, size: tuple[int, int]
) -> None:
    client = SteadyClient(fleet)
    client.circle(1.0)
    client.hear("mav1", battery_frac=0.01)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.resize_terminal(*size)
        await see(app, pilot)
        await see(app, pilot)
        seen = screen(app)
        assert any("✖ mav1" in line or "✖ Battery" in line for line in seen)
        assert any("l LAND ALL" in line for line in seen)
        assert sum(" mav" in line[:10] for line in seen) >= 2
        await pilot.press("colon", *"hodl", "enter")
        await see(app, pilot)
        seen = screen(app)
        assert any("'hodl' is no" in line for line in seen)
        assert any(line.startswith(" : hodl") for line in seen)
        assert any("l LAND ALL" in line for line in seen)
        await pilot.press("escape")
        await pilot.press("m", "1", ",")
        await see(app, pilot)
        assert any("mark: 1,▏" in line for line in screen(app))


async def test_after_a_tiny_size_everything_is_as_before() -> None:
    client = SteadyClient(crowd(8))
    ground_and_sky(client)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        await see(app, pilot)
        before = screen(app)
        for size in [(20, 5), (80, 24)]:
            await pilot.resize_terminal(*size)
            await see(app, pilot)
        assert screen(app) == before
