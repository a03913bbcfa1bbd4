"""A motion capture that sees a neighbour where the own vehicle is."""

from __future__ import annotations

import pytest

from onboard.neighbours.own_body import OwnBody
from onboard.tuples import Xyz
from tests.onboard.agent.rig import Rig

_AWAY: Xyz = (2.0, 0.0, 1.0)


@pytest.fixture
def own_body() -> OwnBody:
    return OwnBody(body_diameter_m=0.5, separation_m=0.8, position_enu_m=(0.0, 0.0, 1.0))


@pytest.mark.parametrize("expected_enu_m", [_AWAY, None])
def test_a_pose_at_our_own_place_of_a_neighbour_that_is_elsewhere_shows_our_own_body(
    own_body: OwnBody, expected_enu_m: Xyz | None
) -> None:
    assert own_body.is_seen_in(0, (0.1, 0.0, 1.0), expected_enu_m)


def test_a_neighbour_that_came_all_the_way_is_itself(own_body: OwnBody) -> None:
    x_m = 2.0
    while x_m > 0.1:
        nearer_m = x_m - 0.1
        assert not own_body.is_seen_in(0, (nearer_m, 0.0, 1.0), (x_m, 0.0, 1.0))
        x_m = nearer_m


def test_our_own_body_is_recognized_until_it_is_farther_away_than_vehicles_come(
    own_body: OwnBody,
) -> None:
    assert own_body.is_seen_in(0, (0.0, 0.0, 1.0), _AWAY)
    # our own position drifts, and we fly past the neighbour's last position
    assert own_body.is_seen_in(0, (0.7, 0.0, 1.0), (0.7, 0.0, 1.0))

    assert not own_body.is_seen_in(0, _AWAY, _AWAY)
    assert not own_body.is_seen_in(0, (0.7, 0.0, 1.0), (0.8, 0.0, 1.0))


def test_each_neighbour_counts_for_itself(own_body: OwnBody) -> None:
    assert own_body.is_seen_in(0, (0.0, 0.0, 1.0), _AWAY)
    assert not own_body.is_seen_in(1, (0.4, 0.0, 1.0), (0.5, 0.0, 1.0))


def test_without_a_position_of_our_own_nothing_is_recognized() -> None:
    rig = Rig(has_mocap=False)
    rig.step()
    assert rig.core.neighbours._own_body.position_enu_m is None

    own_body = OwnBody(body_diameter_m=0.5, separation_m=0.8)
    assert not own_body.is_seen_in(0, (0.0, 0.0, 0.0), _AWAY)
