"""Goals without a route are refused with the reason, and what leads there all the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from onboard.avoidance.params import law_params, still
from onboard.config.fences import Fence
from onboard.config.fleet import load_fleet
from onboard.config.obstacles import Circle, Obstacle
from onboard.control.reachability import route_refusal
from onboard.control.router import Surroundings, surroundings

PAPER = Path(__file__).resolve().parents[3] / "configs/fleets/paper.toml"


SQUARE = {"polygon_enu_m": [[-1.5, -1.5], [1.5, -1.5], [1.5, 1.5], [-1.5, 1.5]]}
CIRCLE = {"circle": {"center_enu_m": [0.0, 0.0], "radius_m": 1.5}}


def around_a_low_fence(
    outline: dict[str, Any] = SQUARE,
    *,
    height_m: tuple[float, float] = (0.0, 2.0),
    obstacles: tuple[Obstacle, ...] = (),
) -> Surroundings:
    """A place to stay out of, up to a height of 2 m."""
    low = {"name": "low", "keep": "out", "height_m": height_m, "buffer_m": 0.3, **outline}
    fences = msgspec.convert([low], tuple[Fence, ...])
    fleet = msgspec.structs.replace(load_fleet(PAPER), fences=fences, obstacles=obstacles)
    return surroundings(still(fleet), law_params(fleet, "mav0"))


def test_a_goal_above_a_fence_is_refused_from_below_with_the_climb_that_leads_there() -> None:
    around = around_a_low_fence()
    assert route_refusal(around, "mav0", (2.5, 0.0, 1.0), (0.0, 0.0, 2.6)) == (
        "cannot be reached from (2.50, 0.00, 1.00): a fence that ends below the goal is "
        "in the way; first climb to 2.60 m"
    )
    assert route_refusal(around, "mav0", (2.5, 0.0, 1.0), (2.5, 0.0, 2.6)) == ""
    assert route_refusal(around, "mav0", (2.5, 0.0, 2.6), (0.0, 0.0, 2.6)) == ""


def test_a_goal_below_a_fence_is_refused_from_its_height_with_the_descent_that_leads_there() -> (
    None
):
    bridge = around_a_low_fence(height_m=(2.0, 4.0))
    assert route_refusal(bridge, "mav0", (2.6, 0.0, 3.0), (0.0, 0.0, 1.0)) == (
        "cannot be reached from (2.60, 0.00, 3.00): a fence that begins above the goal is "
        "in the way; first descend to 1.00 m"
    )
    assert route_refusal(bridge, "mav0", (2.6, 0.0, 3.0), (2.6, 0.0, 1.0)) == ""
    assert route_refusal(bridge, "mav0", (2.6, 0.0, 1.0), (0.0, 0.0, 1.0)) == ""


def test_where_no_climb_helps_none_is_named() -> None:
    words = route_refusal(around_a_low_fence(), "mav0", (2.5, 0.0, 1.0), (0.0, 0.0, 1.8))
    assert words.startswith("cannot be reached from (2.50, 0.00): no way around the obstacles")


@pytest.mark.parametrize("outline", [SQUARE, CIRCLE], ids=["square", "circle"])
def test_nobody_sinks_from_above_a_fence_to_a_goal_beside_it(outline: dict[str, Any]) -> None:
    around = around_a_low_fence(outline)
    assert route_refusal(around, "mav0", (0.0, 0.0, 3.0), (2.6, 0.0, 0.5)) == (
        "cannot be reached from (0.00, 0.00, 3.00): a fence is below; first fly at 3.00 m "
        "to a point beside it"
    )
    assert route_refusal(around, "mav0", (0.0, 0.0, 3.0), (2.6, 0.0, 3.0)) == ""
    assert route_refusal(around, "mav0", (2.6, 0.0, 3.0), (2.6, 0.0, 0.5)) == ""


@pytest.mark.parametrize("outline", [SQUARE, CIRCLE], ids=["square", "circle"])
@pytest.mark.parametrize("goal_m", [(0.0, 0.0, 2.9), (2.6, 0.0, 2.9)], ids=["above", "beside"])
def test_nobody_climbs_from_below_a_fence_beyond_it(
    outline: dict[str, Any], goal_m: tuple[float, float, float]
) -> None:
    around = around_a_low_fence(outline, height_m=(1.5, 2.2))

    assert route_refusal(around, "mav0", (0.0, 0.0, 0.8), goal_m) == (
        "cannot be reached from (0.00, 0.00, 0.80): a fence is above this point; first fly "
        "out from below it"
    )
    assert route_refusal(around, "mav0", (0.0, 0.0, 0.8), (2.6, 0.0, 0.8)) == ""
    assert route_refusal(around, "mav0", (0.0, 0.0, 0.5), (0.0, 0.0, 1.1)) == ""
    assert route_refusal(around, "mav0", (2.6, 0.0, 0.8), (2.6, 0.0, 2.9)) == ""


def test_where_no_flight_beside_the_fence_helps_the_true_reason_is_named() -> None:
    """An obstacle stands beside the goal."""
    pillar = Obstacle(name="pillar", circle=Circle(center_enu_m=(3.0, 0.0), radius_m=0.3))
    around = around_a_low_fence(obstacles=(pillar,))
    words = route_refusal(around, "mav0", (0.0, 0.0, 3.0), (2.7, 0.0, 0.5))
    assert "too near to an obstacle" in words
