"""Climbs and descents at the edges of what a fleet file may say: heavy vehicles, and slow ones."""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable
from typing import Any

import pytest
from msgspec.structs import replace

from groundstation.orders.result import OrderFailed
from onboard.config.fleet import FleetConfig


def _one(paper: FleetConfig, **keys: Any) -> FleetConfig:
    """The paper's room with a higher roof and one vehicle with other values."""
    vehicles = {"mav0": replace(paper.vehicles["mav0"], **keys)}
    fence = replace(paper.fleet.geofence_m, z=(0.0, 12.0))
    return replace(
        paper, fleet=replace(paper.fleet, geofence_m=fence), vehicles=vehicles, formations={}
    )


def _heights_m(flight, order: str) -> tuple[float, float]:
    """Fly an order; the least and the greatest true height until a second after it."""
    heights_m = []

    def look() -> None:
        heights_m.append(flight.state.vehicles["mav0"].truth.position_enu_m[2])
        flight.at(flight.time_s + 0.1, look)

    flight.at(flight.time_s + 0.1, look)
    assert flight.order(order)["mav0"].phase == "done"
    flight.run(1.0)
    return min(heights_m), max(heights_m)


@pytest.mark.parametrize(
    ("hover_thrust_frac", "max_acceleration_m_s2"),
    [(0.75, 2.0), pytest.param(0.8, 1.5, marks=pytest.mark.long)],
)
def test_a_heavy_vehicle_neither_overshoots_nor_falls_through_its_goal(
    lockstep, paper: FleetConfig, hover_thrust_frac: float, max_acceleration_m_s2: float
) -> None:
    fleet = _one(
        paper,
        hover_thrust_frac=hover_thrust_frac,
        max_speed_m_s=3.0,
        max_acceleration_m_s2=max_acceleration_m_s2,
    )
    with lockstep(fleet) as flight:
        flight.takeoff(1.0)
        _, highest_m = _heights_m(flight, "move mav0 0 0 8")
        lowest_m, _ = _heights_m(flight, "move mav0 0 0 0.6")
        assert highest_m < 8.1
        assert lowest_m > 0.5


@pytest.mark.parametrize("floor_m", [0.0, 0.1])
def test_a_slow_vehicle_takes_off(lockstep, paper: FleetConfig, floor_m: float) -> None:
    """It is below the height of a fallen vehicle for longer than a fallen one has to be."""
    fleet = _one(paper, max_speed_m_s=0.15 if floor_m else 0.1)
    fence = replace(fleet.fleet.geofence_m, z=(floor_m, 3.0))
    with lockstep(replace(fleet, fleet=replace(fleet.fleet, geofence_m=fence))) as flight:
        for _ in range(2):
            assert flight.takeoff(0.4)["mav0"].phase == "done"
            flight.land()


@pytest.mark.parametrize("after_s", [4.2, pytest.param(4.9, marks=pytest.mark.long)])
def test_a_landing_in_a_quick_descent_is_as_soft_as_another(
    lockstep, paper: FleetConfig, after_s: float
) -> None:
    """The landing brakes first; a single slow leg would have led far below the ground."""
    fleet = _one(paper, hover_thrust_frac=0.49, max_speed_m_s=3.0, max_acceleration_m_s2=3.0)
    high = replace(fleet.fleet, geofence_m=replace(fleet.fleet.geofence_m, z=(0.0, 16.0)))
    with lockstep(replace(fleet, fleet=high)) as flight:
        flight.takeoff(2.0)
        flight.order("move mav0 0 0 14")
        flight.start_soon(_ended(flight.fleet.go_to({"mav0": (0.0, 0.0, 1.0)})))
        flight.run(after_s)
        assert flight.state.vehicles["mav0"].truth.velocity_enu_m_s[2] < -2.0
        assert flight.land()["mav0"].phase == "done"
        assert max(one.speed_m_s for one in flight.touchdowns) < 0.6


async def _ended(move: Awaitable[object]) -> None:
    """Wait for a move that another order ends."""
    with contextlib.suppress(OrderFailed):
        await move
