"""A fleet in a field that is no box, in wind: nobody leaves it; without the braking some do."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from onboard.agent import control_step
from onboard.avoidance.params import obstacles
from onboard.config.areas import nearest
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from onboard.config.flight_space import flight_space_of
from sitl.emulator.emulator import Environment
from sitl.lockstep.flight import Lockstep
from sitl.physics.wind import WindSettings

pytestmark = pytest.mark.long

# two arms of 3.6 m, and a corner between them that points inwards
ELL = [[-3, -3], [6, -3], [6, 0.6], [0.6, 0.6], [0.6, 6], [-3, 6]]
TREE = {"center_enu_m": [-1.2, 2.6], "radius_m": 0.4}
# into the arms, and across the bay from one arm to the other
ORDERS = (
    "move mav0 -0.6 5.0 1.0",
    "move mav2 5.0 -0.4 1.0",
    "move mav1 -1.8 5.2 1.0",
    "move mav0 5.2 -2.2 1.0",
    "move mav1 0.0 -0.3 1.0",
    "move mav2 0.0 5.2 1.0",
)


def field() -> FleetConfig:
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["fleet"]["geofence_m"] = {"x": [-8.0, 8.0], "y": [-8.0, 8.0], "z": [0.0, 3.0]}
    data["fleet"]["max_wind_m_s"] = 6.0
    data["fences"] = [
        {"name": "field", "keep": "in", "polygon_enu_m": ELL, "height_m": [0.0, 2.5]}
        | {"buffer_m": 0.2},
        {"name": "tree", "keep": "out", "circle": TREE, "buffer_m": 0.3},
    ]
    return fleet_from_mapping(data)


def least_room_m(flight: Lockstep) -> tuple[dict[str, float], list[str]]:
    """Fly the orders in the field.

    Returns:
        the least room to each fence, by ground truth, and the orders that were not done.
    """
    areas = flight_space_of(flight.config).areas
    least_m = {area.name: float("inf") for area in areas}

    def look(state: object) -> None:
        for view in flight.state.vehicles.values():
            if view.truth is None:
                continue
            x, y, _ = view.truth.position_enu_m
            for area in areas:
                least_m[area.name] = min(least_m[area.name], nearest(area, x, y).room_m)

    flight.client.add_listener(look)
    flight.takeoff(1.0)
    open_orders = []
    for text in ORDERS:
        results = flight.order(text, timeout_s=50.0)
        open_orders += [text for result in results.values() if not result.is_done]
    flight.land()
    return least_m, open_orders


def blowing(east_m_s: float, north_m_s: float, gust_m_s: float) -> Environment:
    return Environment(WindSettings((east_m_s, north_m_s, 0.0), gust_m_s))


@pytest.mark.parametrize("wind_m_s", [(0.0, 0.0), (2.8, 2.8)])
def test_nobody_leaves_a_field_with_two_arms_nor_meets_its_tree(
    lockstep, wind_m_s: tuple[float, float]
) -> None:
    flight = lockstep(field(), seed=1, environment=blowing(*wind_m_s, 0.6))
    least_m, open_orders = least_room_m(flight)
    assert least_m["field"] > 0.0
    assert least_m["tree"] > 0.0
    assert set(open_orders) <= {ORDERS[-1]}  # mav1 hovers in its way, beside the inner corner
    assert flight.min_separation_m > 0.8


def test_without_the_edges_in_the_law_the_same_orders_lead_outside(
    lockstep, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_step, "still", obstacles)
    flight = lockstep(field(), seed=1, environment=blowing(2.8, 2.8, 0.6))
    least_m, _ = least_room_m(flight)
    assert least_m["field"] < -0.1
