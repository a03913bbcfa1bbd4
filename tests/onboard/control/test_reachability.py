"""Goals without a route are refused with the reason, and the climb after which there is one."""

from __future__ import annotations

from pathlib import Path

import msgspec

from onboard.avoidance.params import law_params, still
from onboard.config.fences import Fence
from onboard.config.fleet import load_fleet
from onboard.control.reachability import no_way
from onboard.control.router import Surroundings, surroundings

PAPER = Path(__file__).resolve().parents[3] / "configs/fleets/paper.toml"


def around_a_low_fence() -> Surroundings:
    """A square to stay out of, up to a height of 2 m."""
    corners = [[-1.5, -1.5], [1.5, -1.5], [1.5, 1.5], [-1.5, 1.5]]
    low = {"name": "low", "keep": "out", "polygon_enu_m": corners, "height_m": [0.0, 2.0]}
    fences = msgspec.convert([low | {"buffer_m": 0.3}], tuple[Fence, ...])
    fleet = msgspec.structs.replace(load_fleet(PAPER), fences=fences)
    return surroundings(still(fleet), law_params(fleet, "mav0"))


def test_a_goal_above_a_fence_is_refused_from_below_with_the_climb_that_leads_there() -> None:
    around = around_a_low_fence()
    assert no_way(around, "mav0", (2.5, 0.0, 1.0), (0.0, 0.0, 2.6)) == (
        "cannot be reached from (2.50, 0.00, 1.00): a fence is in the way up to a lower height; "
        "after a climb to 2.60 m it can"
    )
    assert no_way(around, "mav0", (2.5, 0.0, 1.0), (2.5, 0.0, 2.6)) == ""
    assert no_way(around, "mav0", (2.5, 0.0, 2.6), (0.0, 0.0, 2.6)) == ""


def test_where_no_climb_helps_none_is_named() -> None:
    words = no_way(around_a_low_fence(), "mav0", (2.5, 0.0, 1.0), (0.0, 0.0, 1.8))
    assert words.startswith("cannot be reached from (2.50, 0.00): no way around the obstacles")
