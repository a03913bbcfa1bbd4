"""The order of an emergency key leaves while the console is busy, and leaves once."""

from __future__ import annotations

import threading
import time

import pytest
from textual import events
from textual.drivers.headless_driver import HeadlessDriver
from textual.drivers.linux_driver import LinuxDriver

from groundstation.console.app import ConsoleApp
from groundstation.console.priority_keys import with_hooks
from groundstation.console.screens.preview_screen import PreviewScreen
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.fake import FakeClient
from tests.groundstation.console.rig import Oracle
from tests.groundstation.console.scenes import crowd


def typed(app: ConsoleApp, key: str) -> None:
    """A key as the thread that reads the terminal brings it, while this, the loop's own thread,
    does not get on.
    """
    assert app.get_driver_class().__name__ == f"Hooked{LinuxDriver.__name__}"
    driver = with_hooks(HeadlessDriver, app.terminal)(app)
    reader = threading.Thread(target=driver.process_message, args=(events.Key(key, None),))
    reader.start()
    reader.join(5.0)
    assert not reader.is_alive()


@pytest.mark.parametrize(
    ("key", "order"), [("ctrl+l", "land"), ("f9", "land"), ("ctrl+o", "hold"), ("f8", "hold")]
)
async def test_an_emergency_order_does_not_wait_for_the_loop_and_is_sent_once(
    fleet: FleetConfig, key: str, order: str
) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client, forecaster=Oracle())
    async with app.run_test(size=(120, 40)) as pilot:
        client.circle(0.0)
        await pilot.press("f2")
        await pilot.pause()
        assert isinstance(app.screen, PreviewScreen)
        typed(app, key)
        assert client.ordered == [f"{order} mav0,mav1,mav2"]  # nothing was awaited since the key
        end_s = time.monotonic() + 10.0
        while isinstance(app.screen, PreviewScreen) and time.monotonic() < end_s:
            await pilot.pause(0.05)
        assert not isinstance(app.screen, PreviewScreen)
        assert client.ordered == [f"{order} mav0,mav1,mav2"]
        assert app.panels.events.sentences.count(f"{order} all") == 1
        typed(app, key)
        await pilot.pause(0.2)
        assert len(client.ordered) == 2
        assert app.panels.events.sentences.count(f"{order} all") == 2


async def test_other_keys_wait_for_their_turn(fleet: FleetConfig) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        client.circle(0.0)
        typed(app, "f12")
        typed(app, "l")
        assert client.ordered == []
        await pilot.pause(0.2)
        assert client.ordered == []


async def test_a_large_fleet_is_landed_as_promptly_and_once() -> None:
    client = FakeClient(crowd(30))
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        typed(app, "ctrl+l")
        assert len(client.ordered) == 1
        await pilot.pause(0.2)
        assert len(client.ordered) == 1
