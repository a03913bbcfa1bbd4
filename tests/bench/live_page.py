"""``make bench-page``: serve the live page of eight vehicles that circle, to look at it or to take
its picture.

The vehicles are telemetry only, without agents or physics: what is tried here is the page. With
Chromium installed, ``--picture FILE`` writes a picture of it.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from groundstation.client.client import FleetClient
from groundstation.web.live_feed import LiveFeed
from groundstation.web.page_server import PageServer
from onboard.config.fleet import FleetConfig, load_fleet
from tests.groundstation.conftest import FakeBus
from tests.sitl.square_fleets import square_fleet

EIGHT = Path(__file__).parents[2] / "configs/fleets/eight.toml"
_PERIOD_S = 0.05
_TURN_RAD_S = 0.3
_SETTLE_S = 4.0  # until the page shows something
_BROWSER_OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--timeout=9000",
)


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


async def serve(fleet: FleetConfig, duration_s: float, picture: Path | None, size: str) -> None:
    """Serve the page for a time, or until its picture is taken."""
    bus: Any = FakeBus(fleet, has_truth=True)
    client = FleetClient(fleet, author="ada", bus=bus)
    feed = LiveFeed(fleet, client, can_order=True)
    server = PageServer(title=f"Covey: {fleet.fleet.name}", feed=feed)
    address = await server.start("127.0.0.1", 0)
    print(f"open {address}", flush=True)
    await feed.start()

    loop = asyncio.get_running_loop()
    begin_s = loop.time()
    photographing: asyncio.Task[None] | None = None
    try:
        while loop.time() - begin_s < duration_s:
            time_s = loop.time() - begin_s
            tell(bus, fleet, time_s)
            await asyncio.sleep(_PERIOD_S)
            if picture is not None and photographing is None and time_s > _SETTLE_S:
                photographing = asyncio.create_task(photograph(address, picture, size))
            if photographing is not None and photographing.done():
                return
    finally:
        await server.stop()
        await feed.stop()


async def photograph(address: str, picture: Path, size: str) -> None:
    """Write a picture of a page, as Chromium draws it."""
    browser = shutil.which("chromium")
    if browser is None:
        print("There is no chromium here: no picture.")
        return
    with tempfile.TemporaryDirectory(prefix="covey-page-") as profile:
        process = await asyncio.create_subprocess_exec(
            browser,
            *_BROWSER_OPTIONS,
            f"--user-data-dir={profile}",
            f"--window-size={size}",
            f"--screenshot={picture}",
            address,
            stderr=asyncio.subprocess.DEVNULL,
        )
        await process.wait()


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
    parser.add_argument("--size", default="1400,900", help="of the picture: WIDTH,HEIGHT")
    options = parser.parse_args(argv)

    fleet = load_fleet(EIGHT) if options.vehicles == 8 else square_fleet(options.vehicles)
    asyncio.run(serve(fleet, options.seconds, options.picture, options.size))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
