"""The questions and notices about orders, as they were looked at and found good."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import pytest
from textual.pilot import Pilot

from groundstation.orders.forecast import Forecast
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.rig import Rig
from tests.groundstation.console.test_snapshots import SIZES, Compare, pytestmark, steady

__all__ = ["pytestmark", "steady"]

GOALS = {"mav0": (0.0, 2.12, 1.0), "mav1": (-0.8, 0.74, 1.0), "mav2": (0.8, 0.74, 1.0)}
STARTS = {"mav0": (-1.5, 0.0, 1.0), "mav1": (0.0, 0.0, 1.0), "mav2": (1.5, 0.0, 1.0)}


def forecast(closest_m: float) -> Forecast:
    paths = {name: [STARTS[name], STARTS[name], GOALS[name]] for name in GOALS}
    paths["mav0"][1] = (0.0, 0.6, 1.0)  # a detour
    return Forecast(
        paths_enu_m=paths,
        closest_m=closest_m,
        pair=("mav0", "mav1"),
        closest_s=2.7,
        now_m=1.5,
        duration_s=7.2,
    )


def after(rig: Rig, *keys: str) -> Callable[[Pilot[int]], Awaitable[None]]:
    async def before(pilot: Pilot[int]) -> None:
        rig.hover()
        rig.app.refresh_fleet()
        await pilot.press(*keys)
        await pilot.pause(0.2)
        rig.app.refresh_fleet()
        await pilot.pause(0.2)

    return before


@pytest.mark.parametrize(("closest_m", "size"), [(0.89, SIZES[0]), (0.41, SIZES[1])])
def test_an_order_lies_before_the_operator(
    snap_compare: Compare, fleet: FleetConfig, size: tuple[int, int], closest_m: float
) -> None:
    rig = Rig(fleet, forecast(closest_m))
    keys = ("colon", *"formation triangle 1.6 0 1.2 1.0", "enter")
    assert snap_compare(rig.app, terminal_size=size, run_before=after(rig, *keys))


def test_notices_stay_above_the_order_line(snap_compare: Compare, fleet: FleetConfig) -> None:
    rig = Rig(fleet)
    rig.client.tokens.roles.see("operator.1.ground-9.alice", True)
    assert snap_compare(
        rig.app, terminal_size=SIZES[0], run_before=after(rig, "f12", "f12", "ctrl+o")
    )
