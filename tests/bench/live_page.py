"""``make bench-page``: serve the live page of eight vehicles that circle, to look at it or to take
its picture.

The vehicles are telemetry only, without agents or physics: what is tried here is the page. With
Chromium installed, ``--picture FILE`` writes a picture of it, and ``--measure`` says how many
pictures a second it draws and how soon after a key.
"""

from __future__ import annotations

import argparse
import asyncio
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from groundstation.client.client import FleetClient
from groundstation.web.live_feed import LiveFeed
from groundstation.web.page_server import PageServer
from onboard.config.fleet import FleetConfig, load_fleet
from tests.bench.browser import browser_at
from tests.groundstation.conftest import FakeBus
from tests.sitl.square_fleets import square_fleet

EIGHT = Path(__file__).parents[2] / "configs/fleets/eight.toml"
_PERIOD_S = 0.1  # as agents send telemetry
_TURN_RAD_S = 0.3
_SETTLE_S = 4.0  # until the page shows something

# Turns the view at every picture for some seconds, and returns how many pictures that made.
_TURNED_PICTURES = """
new Promise((done) => {
  const canvas = document.getElementById("scene");
  const box = canvas.getBoundingClientRect();
  const pointer = (kind, x) => canvas.dispatchEvent(new PointerEvent(kind, {
    bubbles: true, pointerId: 1, isPrimary: true, buttons: 1,
    clientX: box.left + x, clientY: box.top + 200,
  }));
  canvas.setPointerCapture = () => {};
  let pictures = 0;
  const begin_ms = performance.now();
  pointer("pointerdown", 100);
  const turn = (now_ms) => {
    pictures += 1;
    pointer("pointermove", 100 + (pictures % 200));
    if (now_ms - begin_ms < SECONDS * 1000) requestAnimationFrame(turn);
    else {
      pointer("pointerup", 100);
      done(pictures / ((now_ms - begin_ms) / 1000));
    }
  };
  requestAnimationFrame(turn);
})
"""
# Notes, for each key that is pressed, how long after it the next picture is on the screen.
_NOTE_KEYS = """
globalThis.keyTimes_ms = [];
document.addEventListener("keydown", (event) => {
  const pressed_ms = event.timeStamp;
  requestAnimationFrame(() => setTimeout(
    () => keyTimes_ms.push(performance.now() - pressed_ms)));
}, true);
[...document.querySelectorAll("button.name")][0].focus();
"""
_MEASURED_S = 8.0
_KEYS = 40
_ENTER = 13


def tell(bus: Any, fleet: FleetConfig, time_s: float) -> None:
    """Let all vehicles tell where they are on their circle."""
    names = fleet.enabled_names
    count = len(names)
    radius_m = max(2.0, 0.25 * count)
    for index, name in enumerate(names):
        angle = 2.0 * math.pi * index / count + _TURN_RAD_S * time_s
        x = radius_m * math.cos(angle)
        y = radius_m * math.sin(angle)
        is_avoiding = index == 2
        bus.tell(
            name,
            state="flying",
            is_armed=True,
            is_airborne=True,
            position_enu_m=(x, y, 1.0 + 0.2 * math.sin(time_s + index)),
            velocity_enu_m_s=(-_TURN_RAD_S * y, _TURN_RAD_S * x, 0.0),
            goal_position_enu_m=(-x, -y, 1.2),
            yaw_deg=math.degrees(angle),
            battery_frac=0.9 - 0.07 * (index % 9),
            order_kind="move",
            order_phase="flying",
            avoids=names[(index + 1) % count] if is_avoiding else "",
            conditions=("separation will be lost",) if is_avoiding else (),
            nearest_vehicle=names[(index + 1) % count],
            nearest_distance_m=1.4,
        )


async def serve(
    fleet: FleetConfig, duration_s: float, picture: Path | None, size: str, *, measures: bool
) -> None:
    """Serve the page for a time, or until its picture is taken or it has been measured."""
    bus: Any = FakeBus(fleet, has_truth=True)
    client = FleetClient(fleet, author="ada", bus=bus)
    feed = LiveFeed(fleet, client, can_order=True)
    server = PageServer(title=f"Covey: {fleet.fleet.name}", feed=feed)
    address = await server.start("127.0.0.1", 0)
    print(f"open {address}", flush=True)
    await feed.start()

    loop = asyncio.get_running_loop()
    begin_s = loop.time()
    looking: asyncio.Task[None] | None = None
    try:
        while loop.time() - begin_s < duration_s:
            time_s = loop.time() - begin_s
            tell(bus, fleet, time_s)
            await asyncio.sleep(_PERIOD_S)
            if looking is None and time_s > _SETTLE_S:
                if measures:
                    count = len(fleet.enabled_names)
                    looking = asyncio.create_task(measure(address, count, size))
                elif picture is not None:
                    looking = asyncio.create_task(photograph(address, picture, size))
            if looking is not None and looking.done():
                looking.result()
                return
    finally:
        await server.stop()
        await feed.stop()


async def photograph(address: str, picture: Path, size: str) -> None:
    """Write a picture of a page, as Chromium draws it."""
    async with browser_at(address, size) as browser:
        if browser is None:
            print("There is no chromium here: no picture.")
            return
        await asyncio.sleep(_SETTLE_S)
        await browser.picture(picture)


async def measure(address: str, count: int, size: str) -> None:
    """Print pictures a second while the view is turned, and times from a key to its picture."""
    async with browser_at(address, size) as browser:
        if browser is None:
            print("There is no chromium here: nothing is measured.")
            return
        await asyncio.sleep(_SETTLE_S)
        turned = _TURNED_PICTURES.replace("SECONDS", f"{_MEASURED_S:g}")
        pictures_1_s = await browser.evaluate(turned)

        await browser.evaluate(_NOTE_KEYS)
        for _ in range(_KEYS):
            await browser.press("Enter", _ENTER)
            await asyncio.sleep(0.1)
        times_ms = sorted(await browser.evaluate("keyTimes_ms"))
        if not times_ms:
            print("No key has come to the page: nothing is measured.")
            return
        median_ms = times_ms[len(times_ms) // 2]
        print(
            f"{count} vehicles, window {size}, Chromium drawing in software: "
            f"{pictures_1_s:.0f} pictures a second while the view is turned; "
            f"key to picture {median_ms:.0f} ms (median of {len(times_ms)}), "
            f"slowest {times_ms[-1]:.0f} ms",
            flush=True,
        )


def main(argv: Sequence[str] | None = None) -> int:
    """Serve the page."""
    parser = argparse.ArgumentParser(
        prog="make bench-page",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="how long it is served")
    parser.add_argument("--vehicles", type=int, default=8, help="other than 8: in a square")
    parser.add_argument("--picture", type=Path, help="file of a picture")
    parser.add_argument("--measure", action="store_true", help="pictures a second, key to picture")
    parser.add_argument("--size", default="1400,900", help="of the picture: WIDTH,HEIGHT")
    options = parser.parse_args(argv)

    fleet = load_fleet(EIGHT) if options.vehicles == 8 else square_fleet(options.vehicles)
    asyncio.run(
        serve(fleet, options.seconds, options.picture, options.size, measures=options.measure)
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
