"""A neighbour that is about to touch the ground is not counted on to go on."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.arrays import Array
from onboard.neighbours.state_arrays import NeighbourSnapshot, empty
from onboard.neighbours.touchdowns import stop_at_touchdown
from onboard.types import Neighbour

OWN_ENU_M = (1.0, 2.0, 1.0)
FLOOR_M = 0.2


def rows_of(position_enu_m: tuple[float, ...], velocity_enu_m_s: tuple[float, ...]) -> Array:
    """Return a neighbour that also commands and predicts its velocity's direction."""
    rows = empty(np.zeros(1, dtype=bool), 0.25).numbers
    east, north, up = velocity_enu_m_s
    horizontal = (0.5 * east, 0.5 * north, 0.0)
    vectors = (
        position_enu_m,
        velocity_enu_m_s,
        horizontal,
        position_enu_m,
        (east, north, up),
        horizontal,
        velocity_enu_m_s,
    )
    rows[0, :21] = [number for vector in vectors for number in vector]
    return rows


def after(rows: Array) -> Neighbour:
    stop_at_touchdown(rows, OWN_ENU_M, FLOOR_M)
    (neighbour,) = NeighbourSnapshot(rows)
    return neighbour


def test_only_what_leads_away_from_us_is_taken_off() -> None:
    neighbour = after(rows_of((2.0, 2.0, 0.6), (0.7, 0.3, -0.8)))
    assert neighbour.velocity_enu_m_s == pytest.approx((0.0, 0.3, -0.8))
    assert neighbour.predicted_velocity_enu_m_s == pytest.approx((0.0, 0.3, -0.8))
    assert neighbour.acceleration_enu_m_s2 == pytest.approx((0.0, 0.15, 0.0))
    assert neighbour.commanded_acceleration_enu_m_s2 == pytest.approx((0.0, 0.15, 0.0))
    assert neighbour.position_enu_m == pytest.approx((2.0, 2.0, 0.6))
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
def test_the_motion_of_others_stays(
    position_enu_m: tuple[float, ...], velocity_enu_m_s: tuple[float, ...]
) -> None:
    neighbour = after(rows_of(position_enu_m, velocity_enu_m_s))
    assert neighbour.velocity_enu_m_s == velocity_enu_m_s


def test_one_at_our_own_place_gives_no_wrong_number() -> None:
    rows = rows_of((1.0, 2.0, 0.3), (0.7, 0.3, -0.8))
    stop_at_touchdown(rows, OWN_ENU_M, FLOOR_M)
    assert np.isfinite(rows).all()
    stop_at_touchdown(rows[:0], OWN_ENU_M, FLOOR_M)
