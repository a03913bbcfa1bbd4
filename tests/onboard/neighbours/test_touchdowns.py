"""A neighbour that is about to touch the ground is not counted on to go on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from onboard.neighbours.table import NeighbourTable
from onboard.neighbours.touchdowns import stop_at_touchdown
from onboard.types import Neighbour
from tests.groundstation.console.fake import telemetry
from tests.onboard.agent.rig import fleet
from tests.onboard.state_messages import state_message

S = 1_000_000_000
OWN_ENU_M = (1.0, 2.0, 1.0)
BLIND: dict[str, Any] = {"state": "flying", "state_age_s": 0.4}


def seen(
    position_enu_m: tuple[float, float, float],
    velocity_enu_m_s: tuple[float, float, float],
    own_enu_m: tuple[float, float, float] = OWN_ENU_M,
    age_s: float = 0.0,
    **told: Any,
) -> Neighbour:
    """Return how the law sees a neighbour that also predicts and commands its motion."""
    table = NeighbourTable(fleet(("mav0", "mav1", "mav2")), "mav0")
    table.hear(telemetry("mav1", **told), 5 * S)
    east, north, _ = velocity_enu_m_s
    message = state_message(
        stamp_ns=5 * S,
        position_enu_m=position_enu_m,
        velocity_enu_m_s=velocity_enu_m_s,
        acceleration_enu_m_s2=(0.5 * east, 0.5 * north, 0.0),
        predicted_position_enu_m=position_enu_m,
        predicted_velocity_enu_m_s=velocity_enu_m_s,
        commanded_acceleration_enu_m_s2=(0.5 * east, 0.5 * north, 0.0),
        intent_enu_m_s=velocity_enu_m_s,
    )
    table.hear(message, 5 * S)
    neighbours = table.snapshot(5 * S + round(age_s * S))
    stop_at_touchdown(neighbours.rows, own_enu_m, table)
    assert np.isfinite(neighbours.rows).all()
    (neighbour,) = neighbours
    return neighbour


@pytest.mark.parametrize("told", [BLIND, {"state": "landing"}, {"state": "failed"}])
def test_only_what_leads_away_from_us_is_removed(told: dict[str, Any]) -> None:
    neighbour = seen((2.0, 2.0, 0.4), (0.7, 0.3, -0.8), **told)
    assert neighbour.velocity_enu_m_s == pytest.approx((0.0, 0.3, -0.8))
    assert neighbour.predicted_velocity_enu_m_s == pytest.approx((0.0, 0.3, -0.8))
    assert neighbour.acceleration_enu_m_s2 == pytest.approx((0.0, 0.15, 0.0))
    assert neighbour.commanded_acceleration_enu_m_s2 == pytest.approx((0.0, 0.15, 0.0))
    assert neighbour.position_enu_m == pytest.approx((2.0, 2.0, 0.4))
    assert neighbour.intent_enu_m_s == pytest.approx((0.7, 0.3, -0.8))


@pytest.mark.parametrize(
    ("position_enu_m", "velocity_enu_m_s"),
    [
        ((2.0, 2.0, 1.2), (0.7, 0.3, -0.8)),  # high
        ((2.0, 2.0, 0.4), (0.7, 0.3, 0.5)),  # it climbs
        ((2.0, 2.0, 0.3), (0.7, 0.3, -0.1)),  # it flies low
        ((2.0, 2.0, 0.4), (-0.7, 0.3, -0.8)),  # it comes nearer
    ],
)
def test_the_motion_of_who_does_not_touch_down_or_comes_nearer_stays(
    position_enu_m: tuple[float, float, float], velocity_enu_m_s: tuple[float, float, float]
) -> None:
    assert seen(position_enu_m, velocity_enu_m_s, **BLIND).velocity_enu_m_s == velocity_enu_m_s


def test_one_that_flies_low_on_its_path_by_its_poses_goes_on_unless_it_falls_silent() -> None:
    low = ((2.0, 2.0, 0.4), (0.7, 0.3, -0.8))
    assert seen(*low, state="flying").velocity_enu_m_s == low[1]
    assert seen(*low, age_s=0.5, state="flying").velocity_enu_m_s == pytest.approx((0.0, 0.3, -0.8))


def test_one_at_our_own_place_gives_no_wrong_number() -> None:
    place = (2.0, 2.0, 0.4)
    assert seen(place, (0.7, 0.3, -0.8), own_enu_m=place, **BLIND).velocity_enu_m_s.z == -0.8
