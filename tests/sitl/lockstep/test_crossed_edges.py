"""The judge of a campaign knows polygons and circles, by a form of its own."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from onboard.config.areas import nearest
from onboard.config.flight_space import flight_space_of
from sitl.lockstep.campaign.breaking import order_outside
from sitl.lockstep.campaign.broken_flight import injection_of
from sitl.lockstep.campaign.crossed_edges import beyond_m
from sitl.lockstep.campaign.judge import Judge
from tests.sitl.lockstep.test_fences import field


def test_the_judges_edges_are_those_that_the_agents_reckon_with() -> None:
    rng = np.random.default_rng(3)
    for area in flight_space_of(field()).areas:
        for east, north in rng.uniform(-7.0, 7.0, (200, 2)).tolist():
            room_m = nearest(area, east, north).room_m
            assert beyond_m(area, (east, north, 1.0)) == pytest.approx(max(-room_m, 0.0), abs=1e-9)


def test_heights_count_as_the_fence_says() -> None:
    in_field, out_of_tree = flight_space_of(field()).areas
    assert beyond_m(in_field, (0.0, 0.0, 3.1)) == pytest.approx(0.6)
    low_tree = out_of_tree._replace(low_m=0.0, high_m=1.5)
    assert beyond_m(low_tree, (-1.2, 2.6, 1.0)) == pytest.approx(0.4)
    assert beyond_m(low_tree, (-1.2, 2.6, 1.4)) == pytest.approx(0.1)
    assert beyond_m(low_tree, (-1.2, 2.6, 2.0)) == 0.0


@pytest.mark.parametrize(
    ("place_enu_m", "fence"), [((3.0, 3.0), "field"), ((-1.2, 2.6), "tree"), ((0.0, 0.0), "")]
)
def test_a_vehicle_across_an_edge_within_the_box_is_wrong(
    lockstep: Any, place_enu_m: tuple[float, float], fence: str
) -> None:
    flight = lockstep(field(), seed=1)
    judge = Judge(flight, injection_of("ground slow"), "mav0", ())
    east_m, north_m = place_enu_m
    flight.simulation.emulator.world.vehicles.states.position_ned_m[0, :2] = north_m, east_m

    flight.run(0.1)

    crossed = [one for one in judge.wrong if "crosses the edge" in one]
    assert crossed == ([f"mav0 crosses the edge of the fence '{fence}'"] if fence else [])


@pytest.mark.parametrize("first", ["field", "tree", "ring"])
def test_the_order_outside_leads_across_an_edge_where_there_are_any(first: str) -> None:
    config = field()
    in_field, out_of_tree = config.fences
    ring = msgspec.structs.replace(out_of_tree, name="ring", keep="in")
    fences = {"field": (in_field, out_of_tree), "tree": (out_of_tree,), "ring": (ring,)}[first]
    config = msgspec.structs.replace(config, fences=fences)
    said: list[str] = []
    flight: Any = SimpleNamespace(config=config, client=SimpleNamespace(submit_now=said.append))

    order_outside(flight, "mav0")

    _, _, *goal = said[0].split()
    east_m, north_m, up_m = map(float, goal)
    assert beyond_m(flight_space_of(config).areas[0], (east_m, north_m, up_m)) > 0.1
