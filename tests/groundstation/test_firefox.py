"""The report and the live page in Firefox: they play, and nothing of them fails.

A headless Firefox has no WebGL2, so this is the scene as it is drawn without it, too.
"""

from __future__ import annotations

import asyncio
import contextlib
import shutil
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from groundstation.client.client import FleetClient
from groundstation.report.flight_page import write_page
from groundstation.web.live_feed import LiveFeed
from groundstation.web.page_server import PageServer
from onboard.config.fleet import FleetConfig
from tests.bench.firefox import Firefox, firefox_at
from tests.bench.live_page import tell
from tests.groundstation.conftest import FakeBus
from tests.groundstation.report.made_up import rows, story, write

HAS_FIREFOX = shutil.which("firefox") or shutil.which("firefox-esr")

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not HAS_FIREFOX, reason="there is no Firefox on this computer"),
]

WINDOWS_PX = ((1400, 900), (820, 1180), (360, 740))  # a desktop, a tablet, a phone
WAIT_S = 30.0
LOOK_S = 0.1  # from one look at the page to the next

# Whether anything is drawn on one of the two canvases of the scene.
IS_DRAWN = """
[...document.querySelectorAll(".scene canvas")].some((canvas) => {
  const copy = document.createElement("canvas");
  copy.width = canvas.width;
  copy.height = canvas.height;
  const context = copy.getContext("2d");
  context.drawImage(canvas, 0, 0);
  const { data } = context.getImageData(0, 0, copy.width, copy.height);
  return data.some((value, index) => index % 4 === 3 && value > 0);
})
"""
# How much wider than its window the page is, in pixels.
OVERHANG_PX = "document.documentElement.scrollWidth - document.documentElement.clientWidth"


async def until(browser: Firefox, script: str) -> None:
    """Wait until an expression of the page is true."""
    for _ in range(round(WAIT_S / LOOK_S)):
        if await browser.evaluate(script):
            return
        await asyncio.sleep(LOOK_S)
    pytest.fail(f"never true in Firefox: {script}")


async def assert_fits(browser: Firefox) -> None:
    """Assert that the page has its scene and no bar to scroll it sideways in each window."""
    for width_px, height_px in WINDOWS_PX:
        await browser.resize(width_px, height_px)
        await until(browser, IS_DRAWN)
        assert await browser.evaluate(OVERHANG_PX) <= 0, width_px


async def test_a_report_plays_in_firefox(tmp_path: Path) -> None:
    page = write_page(write(tmp_path / "flight", [*rows(), *story("mav0")])).path

    async with firefox_at(f"{page.as_uri()}#t=5.5&pair=mav1-mav0") as browser:
        assert browser is not None
        await until(browser, "document.querySelector('.time-text') !== null")
        shown = await browser.evaluate("document.body.textContent")
        assert "Age of what each knew of the other" in shown
        assert "0:05.5" in shown

        await browser.evaluate("document.querySelector('button.play').click()")
        await until(browser, "!document.querySelector('.clock').textContent.includes('0:05.5')")

        await assert_fits(browser)
        assert browser.errors == []


@contextlib.asynccontextmanager
async def served(fleet: FleetConfig) -> AsyncIterator[str]:
    """Serve the live page of a fleet that circles, and yield its address."""
    bus: Any = FakeBus(fleet, has_truth=True)
    client = FleetClient(fleet, author="ada", operates=True, bus=bus)
    feed = LiveFeed(fleet, client, can_order=True)
    server = PageServer(title="Covey", feed=feed)

    async def keep_telling() -> None:
        loop = asyncio.get_running_loop()
        while True:
            tell(bus, fleet, loop.time())
            await asyncio.sleep(0.05)

    address = await server.start("127.0.0.1", 0)
    await feed.start()
    telling = asyncio.create_task(keep_telling())
    try:
        yield address
    finally:
        telling.cancel()
        await server.stop()
        await feed.stop()


async def test_the_live_page_follows_a_fleet_in_firefox(fleet: FleetConfig) -> None:
    async with served(fleet) as address, firefox_at(address) as browser:
        assert browser is not None
        await until(browser, "document.getElementById('vehicles').textContent.includes('mav0')")
        assert await browser.evaluate("document.getElementById('land_all').offsetWidth") > 0

        await assert_fits(browser)
        assert browser.errors == []
