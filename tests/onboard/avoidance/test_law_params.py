"""How the numbers of a vehicle's law follow from its fleet file."""

from __future__ import annotations

import math
from typing import Any

import pytest
from msgspec.structs import replace

from onboard.avoidance import params as p
from onboard.avoidance.params import Capsule, law_params, still
from onboard.config.fences import Fence, FenceCircle
from onboard.config.fleet import FleetConfig
from onboard.constants import GRAVITY_M_S2
from tests.onboard.agent.rig import fleet
from tests.onboard.avoidance.law_cases import law_of

_FLEET = fleet()
_SQUARE = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0))
_ELL = ((0.0, 0.0), (4.0, 0.0), (4.0, 1.0), (1.0, 1.0), (1.0, 4.0), (0.0, 4.0))


@pytest.mark.parametrize(
    ("policy", "numbers"),
    [
        (
            "responsibility",
            {
                "half": p.RESPONSIBILITY_HALF,
                "shortfall": p.RESPONSIBILITY_SHORTFALL,
                "full": p.RESPONSIBILITY_FULL,
            },
        ),
        ("prediction", {"none": p.PREDICTION_NONE, "lag": p.PREDICTION_LAG}),
        (
            "rotation",
            {
                "never": p.ROTATION_NEVER,
                "violated": p.ROTATION_VIOLATED,
                "always": p.ROTATION_ALWAYS,
                "ahead": p.ROTATION_AHEAD,
            },
        ),
        (
            "direction",
            {
                "fixed": p.DIRECTION_FIXED,
                "pair": p.DIRECTION_PAIR,
                "crowd": p.DIRECTION_CROWD,
                "intent": p.DIRECTION_INTENT,
            },
        ),
        ("jam", {"ignore": p.JAM_IGNORE, "slow": p.JAM_SLOW}),
    ],
)
def test_each_policy_of_the_file_is_the_one_that_the_law_means(
    policy: str, numbers: dict[str, int]
) -> None:
    for name, number in numbers.items():
        assert getattr(law_of(**{policy: name}).policies, policy) == number, name


def test_each_law_of_the_file_is_the_one_that_is_flown() -> None:
    for law, number in {"off": p.OFF, "paper": p.PAPER, "covey": p.COVEY}.items():
        assert law_of(name=law).law == number, law


def test_a_fleet_flies_its_own_law_unless_another_one_is_named() -> None:
    assert law_params(_FLEET, "mav0").law == p.COVEY
    assert law_params(_FLEET, "mav0", "paper").law == p.PAPER


@pytest.mark.parametrize(
    ("config", "lead_s"),
    [
        ({}, 0.15),
        ({"prediction": "none"}, 0.0),
        ({"name": "paper"}, 0.0),
        ({"name": "off"}, 0.15),
    ],
)
def test_only_the_paper_and_a_policy_look_no_lag_ahead(
    config: dict[str, Any], lead_s: float
) -> None:
    assert law_of({"lag_s": 0.15}, **config).lead_time_s == lead_s


def test_the_limits_are_those_of_the_vehicle_and_its_fleet() -> None:
    section = replace(_FLEET.fleet, body_diameter_m=0.6, vertical_separation_m=1.5)
    law = law_params(replace(_FLEET, fleet=section), "mav0")
    assert law.spacing.vertical_separation_m == 1.5
    assert law.spacing.clearance_m == pytest.approx(0.3 + _FLEET.law.obstacle_margin_m)
    assert law_params(_FLEET, "mav0").spacing.vertical_separation_m == math.inf
    assert law.fence == pytest.approx((-3.95, 3.95, -3.95, 3.95))


def test_before_static_things_it_brakes_with_three_fifths_of_what_it_can() -> None:
    def kappa_1_s(tilt_deg: float) -> float:
        limits = {"max_tilt_rad": math.radians(tilt_deg), "max_speed_m_s": 1.0}
        return law_of(limits, kappa_1_1_s=4.0, avoid_speed_frac=1.25).gains.static_kappa_1_1_s

    braking_m_s2 = 0.6 * GRAVITY_M_S2 * math.tan(math.radians(10.0))
    assert kappa_1_s(10.0) == pytest.approx(braking_m_s2 / 1.25)
    assert kappa_1_s(45.0) == 4.0


def test_the_margin_of_the_accuracy_in_numbers() -> None:
    # a_1 = 3/s and a_0 = 2/s^2, and tau = 0.5 s: Phi = 5 / (6 (4 + 6 + 2)) s^4
    spacing = law_of(kappa_1_1_s=1.0, kappa_2_1_s=2.0, accuracy_time_s=0.5).spacing
    phi = 5.0 / 72.0
    assert spacing.margin_floor_m == 0.05
    assert spacing.sigma_position == pytest.approx(5.0 * 2.0 * math.sqrt(phi))
    assert spacing.sigma_velocity_s == pytest.approx(5.0 * 3.0 * math.sqrt(phi))

    fixed = law_of(margin="fixed").spacing
    assert (fixed.margin_floor_m, fixed.sigma_position, fixed.sigma_velocity_s) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("turn", "sign"), [("eq8", 1.0), ("eq9", -1.0)])
def test_the_paper_turns_as_its_equation_says(turn: str, sign: float) -> None:
    assert law_of(paper_turn=turn).paper.turn_sign == sign


# -- edges -----------------------------------------------------------------------------------------


def _with(*fences: Fence) -> FleetConfig:
    law = replace(_FLEET.law, fence_margin_m=0.1)
    return replace(_FLEET, law=law, fences=fences)


def _fence(keep: str, corners: tuple[tuple[float, float], ...]) -> Fence:
    height_m = (0.5, 2.0) if keep == "out" else None
    return Fence(name=keep, keep=keep, polygon_enu_m=corners, buffer_m=0.2, height_m=height_m)  # type: ignore[arg-type]


def test_a_fleet_has_the_edges_of_all_its_areas_with_the_distances_to_keep() -> None:
    edges = still(_with(_fence("in", _ELL), _fence("out", _SQUARE)))
    assert [edge.area for edge in edges] == [1] * 6 + [2] * 4
    for edge in edges:
        assert edge.keep_m == pytest.approx(0.3)
        assert edge.radius_m == 0.0

    # each edge ends where the next one begins, all around
    for area in (edges[:6], edges[6:]):
        assert [edge.end_enu_m for edge in area] == [
            edge.begin_enu_m for edge in (*area[1:], area[0])
        ]
    assert (edges[0].low_m, edges[0].high_m) == (-math.inf, math.inf)
    assert (edges[6].low_m, edges[6].high_m) == pytest.approx((0.2, 2.3))


def test_only_a_corner_that_points_inwards_and_an_area_to_stay_out_of_are_turned_about() -> None:
    def corners(edges: tuple[Capsule, ...]) -> list[tuple[float, ...]]:
        return [tuple(edge.begin_enu_m) for edge in edges if edge.is_begin_inwards]

    ell = still(_with(_fence("in", _ELL)))
    assert corners(ell) == [(1.0, 1.0)]
    assert [tuple(edge.end_enu_m) for edge in ell if edge.is_end_inwards] == [(1.0, 1.0)]
    turned = [edge for edge in ell if edge.is_turned_about]
    assert [tuple(edge.begin_enu_m) for edge in turned] == [(4.0, 1.0), (1.0, 1.0)]

    square = still(_with(_fence("in", _SQUARE)))
    assert corners(square) == []
    assert not any(edge.is_turned_about for edge in square)

    house = still(_with(_fence("out", _SQUARE)))
    assert len(corners(house)) == 4
    assert all(edge.is_turned_about for edge in house)


def test_a_corner_points_inwards_by_the_two_edges_beside_it() -> None:
    # a ridge that rises into the field, with a flat top of three corners
    ridge = ((-1.0, -3.0), (-1.0, 0.0), (0.0, 0.0), (1.0, 0.2), (1.2, -3.0))
    field = (*ridge, (4.0, -3.0), (4.0, 4.0), (-4.0, 4.0), (-4.0, -3.0))
    edges = still(_with(_fence("in", field)))
    inwards = [tuple(edge.begin_enu_m) for edge in edges if edge.is_begin_inwards]
    assert inwards == [(-1.0, 0.0), (1.0, 0.2)]


def test_a_corner_on_a_straight_side_points_nowhere() -> None:
    with_middle = ((0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0))
    edges = still(_with(_fence("in", with_middle)))
    assert not any(edge.is_begin_inwards or edge.is_turned_about for edge in edges)
    # a bend that is hardly one is a corner
    bent = ((0.0, 0.0), (0.2, 0.0), (0.4, 0.2), (0.4, 2.0), (0.0, 2.0))
    assert not any(edge.is_begin_inwards for edge in still(_with(_fence("in", bent))))


@pytest.mark.parametrize("keep", ["in", "out"])
def test_a_circle_is_one_edge_that_is_turned_about_from_outside(keep: str) -> None:
    circle = FenceCircle(center_enu_m=(1.0, -1.0), radius_m=2.0)
    fence = Fence(name="a", keep=keep, circle=circle)  # type: ignore[arg-type]
    (edge,) = still(_with(fence))
    assert edge.begin_enu_m == edge.end_enu_m == (1.0, -1.0)
    assert (edge.radius_m, edge.area, edge.is_turned_about) == (2.0, 1, keep == "out")
