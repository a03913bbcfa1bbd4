"""Paths of a formation that moves, and the formation in which they end."""

from __future__ import annotations

import math

import numpy as np
import pytest

from groundstation.formations.frame import FormationStart, FramePoint, frame_paths
from groundstation.orders.held_formation import held_slots
from onboard.config.fleet import FleetConfig
from onboard.control.path import point_at
from tests.groundstation.formations.test_formations import fleet_with


@pytest.fixture(scope="module")
def fleet() -> FleetConfig:
    """A fleet whose second formation names its vehicles in another order than the first."""
    slots = {f"mav{index}": [1.6 * (index % 4), 2.0 * (index // 4), 0.0] for index in range(12)}
    return fleet_with(ring={"shape": "circle"}, rows=dict(reversed(slots.items())))


@pytest.mark.parametrize("leader", [None, "mav3"])
@pytest.mark.parametrize("is_nearest", [True, False])
@pytest.mark.parametrize(
    "points",
    [
        [FramePoint(turn_deg=250.0, duration_s=60.0)],
        [FramePoint(spacing_m=2.5, duration_s=30.0), FramePoint(turn_deg=10.0, duration_s=30.0)],
        [
            FramePoint(name="rows", turn_deg=30.0, duration_s=60.0),
            FramePoint(position_enu_m=(1.0, 0.0, 2.0), duration_s=30.0),
        ],
    ],
)
def test_paths_end_in_the_formation_that_the_next_move_keeps(
    fleet: FleetConfig, points: list[FramePoint], *, is_nearest: bool, leader: str | None
) -> None:
    start = FormationStart(
        name="ring", position_enu_m=(0.0, 0.0, 2.0), rotation_deg=20.0, leader=leader
    )
    starts = {name: vehicle.start_enu_m for name, vehicle in fleet.vehicles.items()}
    paths = frame_paths(fleet, start, points, starts if is_nearest else None)

    slots = held_slots(fleet, paths.end)
    offsets = [
        np.subtract(point_at(path, math.inf).position_enu_m, slots[name])
        for name, path in paths.items()
    ]
    assert np.ptp(offsets, axis=0) == pytest.approx(0.0, abs=1e-5), "one position of the formation"
