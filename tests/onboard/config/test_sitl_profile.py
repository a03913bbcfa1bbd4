"""What a fleet file may say of a vehicle for the emulator only."""

from __future__ import annotations

from typing import Any

import pytest

from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping
from onboard.config.sitl import BOUNDS, SitlProfile


def fleet(**sitl: Any) -> FleetConfig:
    vehicle = {
        "system_id": 1,
        "start_enu_m": [0.0, 0.0, 0.0],
        "agent": "tcp/127.0.0.1:7460",
        "type": "mine",
    }
    return fleet_from_mapping(
        {
            "schema": 1,
            "fleet": {
                "name": "one",
                "geofence_m": {"x": [-4.0, 4.0], "y": [-4.0, 4.0], "z": [0.0, 3.0]},
            },
            "types": {"mine": {"mass_kg": 0.6, "sitl": sitl}},
            "vehicles": {"mav0": {**vehicle, "autopilot": "udpin://127.0.0.1:14540"}},
        },
        path="fleet.toml",
    )


def test_a_drone_at_hand_is_described_in_the_fleet_file() -> None:
    profile = (
        fleet(thrust_curve_frac=0.4, arm_m=0.11, inertia_kg_m2=[1e-3, 1e-3, 2e-3])
        .vehicles["mav0"]
        .sitl
    )
    assert (profile.thrust_curve_frac, profile.arm_m, profile.inertia_kg_m2) == (
        0.4,
        0.11,
        (1e-3, 1e-3, 2e-3),
    )


def test_every_value_has_bounds_and_what_lies_outside_is_refused_in_words() -> None:
    assert set(BOUNDS) == set(SitlProfile.__struct_fields__)
    for key, (low, high) in BOUNDS.items():
        for bad in (low - 1.0, high + 1.0):
            value: Any = [1e-3, bad, 1e-3] if key == "inertia_kg_m2" else bad
            with pytest.raises(
                ConfigError, match=rf"'types\.mine\.sitl\.{key}' is .* must lie between"
            ):
                fleet(**{key: value})


def test_an_unknown_key_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(ConfigError, match="thrust_curve_frac"):
        fleet(thrust_curve=0.4)
