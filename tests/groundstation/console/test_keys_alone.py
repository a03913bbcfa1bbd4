"""A whole flight by keys alone.

The fleet is simulated; its agents, client and forecasts are the real ones.
"""

from __future__ import annotations

import asyncio

import msgspec
import pytest

from groundstation.console.app import ConsoleApp
from groundstation.console.screens.preview_screen import PreviewScreen
from groundstation.fleet.state import FleetState
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.live import ForecasterHere, LiveFleet, until


def states(state: FleetState) -> set[str]:
    return {
        "silent" if view.telemetry is None else view.telemetry.state
        for view in state.vehicles.values()
    }


@pytest.mark.long
async def test_a_flight_from_start_to_finish_by_keys_alone(fleet: FleetConfig) -> None:
    # A loaded machine may answer late; that is not what is tested here.
    patient = msgspec.structs.replace(fleet.fleet, direct_command_timeout_s=10.0)
    live = LiveFleet(msgspec.structs.replace(fleet, fleet=patient))
    app = ConsoleApp(live.simulation.fleet, live.client, forecaster=ForecasterHere())
    client = live.client
    async with live.flying(), app.run_test(size=(120, 40)) as pilot:

        async def write(words: str, end: set[str]) -> None:
            await order(("colon", *words, "enter"), end)

        async def order(keys: tuple[str, ...], end: set[str]) -> None:
            """Give it, read the preview, send it, see it done."""
            await live.press(pilot, *keys)
            await until(pilot, lambda: isinstance(app.screen, PreviewScreen))
            screen = app.screen
            assert isinstance(screen, PreviewScreen)
            await until(pilot, lambda: screen.prepared.is_sendable or screen.prepared.reasons)
            assert not screen.prepared.reasons, screen.prepared.reasons
            before = app.orders.newest
            while app.screen is screen:  # it may just be computing again
                await live.press(pilot, "enter")
                await asyncio.sleep(0.05)
            await until(pilot, lambda: app.orders.newest is not before)
            handle = app.orders.newest
            assert handle is not None
            await until(pilot, lambda: handle.is_final)
            assert handle.is_done, handle.results
            await until(pilot, lambda: states(client.state) == end)

        await until(pilot, lambda: states(client.state) == {"ready"})
        await until(pilot, lambda: client.control.is_operator)
        await live.press(pilot, "w")
        await until(pilot, lambda: live.simulation.emulator.autopilots[0].tunes == 1)
        await order(("asterisk", "f2"), {"armed"})
        await write("takeoff all 1.0", {"flying"})
        await write("formation triangle 1.6 0 1.0 1.0", {"flying"})
        await write("move all 0.3 0.4 1.2", {"flying"})
        await live.press(pilot, "escape", "ctrl+o")
        await until(pilot, lambda: states(client.state) == {"holding"})
        await live.press(pilot, "ctrl+l")
        await until(pilot, lambda: states(client.state) == {"landed"})
        assert client.state.smallest_truth is not None
        assert client.state.smallest_truth.distance_m >= fleet.fleet.safety_distance_m
        await live.press(pilot, "q")
    assert app.return_value == 0
