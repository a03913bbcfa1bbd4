"""The verdicts of ``covey identify``; the TOML that it proposes has the measured lag."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from typing import Any

import msgspec
import pytest

from groundstation.identification.identification_report import (
    IdentifiedVehicle,
    rows,
    sets_values,
    table_toml,
    tomls,
    unknown_parameters,
)
from groundstation.identification.identify import Estimate, Identified
from onboard.config.fleet import FleetConfig
from onboard.config.validation import VEHICLE_BOUNDS


def estimate(value: float) -> Estimate:
    return Estimate(value=value, std=0.01, low=value - 0.02, high=value + 0.02)


def flown(
    fleet: FleetConfig, name: str = "mav0", *, lag_s: float, wn_rad_s: float, zeta: float
) -> IdentifiedVehicle:
    identified = Identified(
        hover_thrust_frac=estimate(0.5),
        lag_s=estimate(lag_s),
        delay_s=estimate(lag_s - 2.0 * zeta / wn_rad_s),
        wn_rad_s=estimate(wn_rad_s),
        zeta=estimate(zeta),
        drag_1_s=estimate(0.3),
        static_gain=estimate(1.0),
        tilt_error_x_deg=estimate(0.0),
        tilt_error_y_deg=estimate(0.0),
        duration_s=40.0,
        attitude_rms_deg=0.1,
        position_rms_m=0.001,
    )
    return IdentifiedVehicle(vehicle=fleet.vehicles[name], identified=identified)


@pytest.mark.parametrize(
    ("lag_s", "wn_rad_s", "zeta"),
    [
        (0.273, 9.0, 0.7),
        (0.16, 40.0, 2.8),  # zeta above its bound
        (0.10, 6.0, 0.16),  # zeta below its bound
        (0.20, 20.0, 2.8),
        (0.15, 8.0, 0.7),  # the response alone is longer than the lag
        (0.80, 10.0, 0.7),  # a delay above its bound
        (0.05, 60.0, 2.5),  # wn above its bound for the largest zeta
    ],
)
def test_the_written_values_have_the_measured_lag_and_lie_within_their_bounds(
    fleet: FleetConfig, lag_s: float, wn_rad_s: float, zeta: float
) -> None:
    member = flown(fleet, lag_s=lag_s, wn_rad_s=wn_rad_s, zeta=zeta)
    text = table_toml("types.quad", [member])
    values = tomllib.loads(text)["types"]["quad"]
    for key in ("attitude_delay_s", "attitude_wn_rad_s", "attitude_zeta"):
        low, high = VEHICLE_BOUNDS[key]
        assert low <= values[key] <= high
    written_s = (
        values["attitude_delay_s"] + 2.0 * values["attitude_zeta"] / values["attitude_wn_rad_s"]
    )
    assert written_s == pytest.approx(lag_s, abs=0.001)
    assert "allow no L" not in text


def test_a_lag_that_the_bounds_do_not_allow_is_said(fleet: FleetConfig) -> None:
    text = table_toml("types.quad", [flown(fleet, lag_s=0.004, wn_rad_s=60.0, zeta=0.5)])
    assert "allow no L of 0.004 s; these values have one of 0.007 s" in text


def written(fleet: FleetConfig, lags_s: dict[str, float], *, own: str = "") -> dict[str, Any]:
    """The values that are written for vehicles with these lags; ``own`` has values of its own."""
    members = []
    for name, lag_s in lags_s.items():
        member = flown(fleet, name, lag_s=lag_s, wn_rad_s=9.0, zeta=0.7)
        members.append(replace(member, has_own_values=name == own))
    tables: dict[str, Any] = {}
    for text in tomls(members):
        tables |= tomllib.loads(text).get("types", {}) | tomllib.loads(text).get("vehicles", {})
    return tables


def test_vehicles_with_equal_lags_share_the_values_of_their_type(fleet: FleetConfig) -> None:
    tables = written(fleet, {"mav0": 0.25, "mav1": 0.27})
    assert list(tables) == [fleet.vehicles["mav0"].type]


def test_vehicles_whose_lags_differ_have_values_of_their_own(fleet: FleetConfig) -> None:
    tables = written(fleet, {"mav0": 0.20, "mav1": 0.30})
    assert list(tables) == ["mav0", "mav1"]
    delays_s = [table["attitude_delay_s"] for table in tables.values()]
    assert delays_s[1] - delays_s[0] == pytest.approx(0.1, abs=0.002)


def test_a_vehicle_with_values_of_its_own_gets_new_ones_there(fleet: FleetConfig) -> None:
    assert list(written(fleet, {"mav1": 0.35}, own="mav1")) == ["mav1"]
    tables = written(fleet, {"mav0": 0.25, "mav1": 0.35}, own="mav1")
    assert list(tables) == [fleet.vehicles["mav0"].type, "mav1"]


@pytest.mark.parametrize(
    ("own_table", "expected"),
    [
        ({"attitude_delay_s": 0.1}, True),
        ({"sitl": {"static_gain": 0.9}}, True),
        ({"system_id": 2, "sitl": {}}, False),
    ],
)
def test_a_vehicle_s_own_table_may_set_what_is_identified(
    own_table: dict[str, Any], *, expected: bool
) -> None:
    assert sets_values(own_table) == expected


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [(-0.01, 0.03, "agrees"), (-0.2, 0.3, "not known well enough: fly longer")],
)
def test_a_value_agrees_only_if_its_interval_is_narrow(
    fleet: FleetConfig, low: float, high: float, verdict: str
) -> None:
    member = flown(fleet, lag_s=fleet.vehicles["mav0"].lag_s, wn_rad_s=9.0, zeta=0.7)
    lag = member.identified.lag_s
    wide = replace(lag, low=lag.value + low, high=lag.value + high)
    member = replace(member, identified=replace(member.identified, lag_s=wide))

    by_name = {row["name"]: row["verdict"] for row in rows(member)}
    assert by_name["lag L [s]"] == verdict
    assert ("lag L [s]" in unknown_parameters(member)) == (verdict != "agrees")


def test_what_a_calm_flight_shows_of_a_fast_vehicles_drag_is_enough(fleet: FleetConfig) -> None:
    member = flown(fleet, lag_s=0.2, wn_rad_s=9.0, zeta=0.7)
    drag = Estimate(value=0.3, std=0.021, low=0.258, high=0.342)
    member = IdentifiedVehicle(
        vehicle=msgspec.structs.replace(member.vehicle, max_speed_m_s=15.0),
        identified=replace(member.identified, drag_1_s=drag),
    )
    assert "drag_1_s" not in unknown_parameters(member)


@pytest.mark.parametrize(("gain", "word"), [(0.7, "weak"), (1.3, "strong")])
def test_a_wrong_gain_is_named_by_its_direction(fleet: FleetConfig, gain: float, word: str) -> None:
    member = flown(fleet, lag_s=0.2, wn_rad_s=9.0, zeta=0.7)
    member = replace(member, identified=replace(member.identified, static_gain=estimate(gain)))
    assert rows(member)[-1]["verdict"] == f"matters: the attitude loop is too {word}: tune it"
