"""What can be said before flight: the bounds themselves, and each finding made to fail once on
purpose.
"""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping
from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility import bounds
from onboard.feasibility.bounds import Response
from onboard.feasibility.finding import Finding, at_least
from onboard.feasibility.fleet_checks import (
    ErrorClass,
    error_class,
    fleet_findings,
    spot_findings,
)
from onboard.feasibility.lift_off import blown_aside_m

ROOT = Path(__file__).resolve().parents[3]
SIH = Response(0.04, 11.0, 0.6)
WEAK = Response(0.04, 6.0, 0.7)


def fleet_with(changes: dict[str, Any] | None = None, base: str = "sih") -> FleetConfig:
    """A shipped fleet with some keys changed: ``{"law.name": "paper", "types.sih.max_tilt_deg":
    10}``.
    """
    data = tomllib.loads((ROOT / f"configs/fleets/{base}.toml").read_text())
    for key, value in (changes or {}).items():
        *path, last = key.split(".")
        table = data
        for part in path:
            table = table.setdefault(part, {})
        table[last] = value
    return fleet_from_mapping(data)


def named(fleet: FleetConfig, name: str, **options: Any) -> Finding:
    return next(finding for finding in fleet_findings(fleet, **options) if finding.title == name)


@pytest.mark.parametrize("base", ["paper", "sih"])
def test_the_shipped_fleets_can_be_flown_on_a_mocap(base: str) -> None:
    assert all(finding.status != "refused" for finding in fleet_findings(fleet_with(base=base)))


@pytest.mark.parametrize("base", ["paper", "sih"])
def test_gps_with_the_papers_spacing_is_refused_in_words(base: str) -> None:
    refused = {
        f.title: f
        for f in fleet_findings(fleet_with(base=base), errors="gps")
        if f.status == "refused"
    }
    assert {"initial conditions", "spacing, formation 'triangle'"} <= set(refused)
    assert all(
        "gps" in finding.sentence and finding.remedy in finding.sentence
        for finding in refused.values()
    )


@pytest.mark.parametrize(
    ("name", "wn_rad_s", "zeta", "delay_s", "status"),
    [
        ("attitude response", 3.0, 0.7, 0.04, "ok"),
        ("attitude response", 2.5, 0.7, 0.04, "warning"),
        ("attitude response", 1.0, 0.7, 0.0, "refused"),
        ("attitude response", 6.0, 2.0, 0.04, "refused"),
        ("attitude response", 4.0, 0.3, 0.04, "refused"),
        ("dead time", 11.0, 0.6, 0.25, "ok"),
        ("dead time", 11.0, 0.6, 0.3, "warning"),
        ("dead time", 11.0, 0.6, 0.35, "refused"),
    ],
)
def test_the_attitude_of_a_vehicle_that_flies_alone_is_judged(
    name: str, wn_rad_s: float, zeta: float, delay_s: float, status: str
) -> None:
    fleet = fleet_with(
        {
            "types.sih.attitude_wn_rad_s": wn_rad_s,
            "types.sih.attitude_zeta": zeta,
            "types.sih.attitude_delay_s": delay_s,
            "vehicles.mav1.enabled": False,
            "vehicles.mav2.enabled": False,
        }
    )
    assert fleet.enabled_names == ("mav0",)
    assert named(fleet, name).status == status


def test_a_fixed_margin_made_for_a_mocap_is_refused_for_a_worse_position() -> None:
    fixed = fleet_with({"law.margin": "fixed"})
    assert [
        named(fixed, "margin", errors=errors).status for errors in ("mocap", "vision", "gps")
    ] == [
        "ok",
        "refused",
        "refused",
    ]


def test_the_margin_that_the_law_sets_itself_makes_vehicles_park_farther_apart() -> None:
    fleet = fleet_with()
    near, far = (
        named(fleet, "spacing, formation 'triangle'", errors=errors)
        for errors in ("mocap", "vision")
    )
    assert near.bound < far.bound < near.bound + 0.4
    assert far.status == "ok"


def test_a_row_without_prediction_is_refused() -> None:
    without = fleet_with({"law.prediction": "none"}, base="paper")
    assert named(without, "kappas").status == "refused"
    assert named(without, "attitude response").status == "refused"


def test_a_goal_inside_an_obstacles_clearance_is_refused() -> None:
    pillar = [{"name": "pillar", "circle": {"center_enu_m": [0.0, 1.0], "radius_m": 0.3}}]
    fleet = fleet_with({"obstacles": pillar})
    assert spot_findings(fleet, {"mav0": (0.6, 1.0, 1.0)}, "goals")[0].title == "obstacles, goals"
    assert spot_findings(fleet, {"mav0": (0.6, 1.0, 1.0)}, "goals")[0].status == "refused"
    assert all(
        finding.status == "ok"
        for finding in spot_findings(fleet, {"mav0": (0.8, 1.0, 1.0)}, "goals")
    )


def test_gps_is_accepted_with_spacings_and_margin_two_and_a_half_times_as_large() -> None:
    wide: dict[str, Any] = {
        f"vehicles.mav{i}.start_enu_m": [-3.75 + 3.75 * i, -3.75, 0.0] for i in range(3)
    }
    wide |= {f"formations.triangle.mav{i}": [2.5 * x, 2.5 * y, 0.0] for i, x, y in
             ((0, 0.0, 0.92), (1, -0.8, -0.46), (2, 0.8, -0.46))}  # fmt: skip
    wide["fleet.geofence_m"] = {"x": [-10, 10], "y": [-10, 10], "z": [0, 3]}
    wide["law.design_margin_m"] = 1.36
    findings = fleet_findings(fleet_with(wide), errors="gps")
    # the map was flown without GPS, and the inequality takes a wider margin
    other = {finding.title: finding.status for finding in findings if finding.status != "ok"}
    assert other == {"map of the law": "note", "inequality": "note"}


def test_without_a_mocap_the_accuracy_is_that_of_gps() -> None:
    assert error_class(fleet_with()) == "mocap"
    assert error_class(fleet_with({"vehicles.mav1.mocap_required": False})) == "gps"


def test_the_fleet_file_declares_how_good_positions_are_and_check_and_flight_judge_by_it() -> None:
    vision = {"types.sih.mocap_required": False, "types.sih.px4_position": "vision"}
    fleet = fleet_with(vision)
    assert error_class(fleet) == "vision"
    assert error_class(fleet_with({**vision, "vehicles.mav1.px4_position": "gps"})) == "gps"
    assert fleet_findings(fleet) == fleet_findings(fleet, errors="vision")
    spots = {name: vehicle.start_enu_m for name, vehicle in fleet.vehicles.items()}
    assert spot_findings(fleet, spots, "starts") == spot_findings(
        fleet, spots, "starts", errors="vision"
    )
    with pytest.raises(ConfigError, match="px4_position"):
        fleet_with({"types.sih.px4_position": "radar"})


BROKEN: list[tuple[str, dict[str, Any], str]] = [
    ("margin", {"law.margin": "fixed", "law.design_margin_m": 0.02}, "refused"),
    ("shortfall gain", {"law.shortfall_gain": 1.1}, "refused"),
    ("shortfall gain", {"law.shortfall_gain": 0.2}, "warning"),
    ("speed limit", {"law.avoid_speed_frac": 2.0}, "refused"),
    ("body", {"fleet.body_diameter_m": 0.75}, "refused"),
    ("sensing range", {"law.range_m": 1.5}, "refused"),
    ("bus delay", {"radio": {"expected_delay_s": 0.2}}, "refused"),
    ("kappas", {"law.kappa_1_1_s": 10.0, "law.kappa_2_1_s": 20.0}, "refused"),
    ("kappas", {"types.sih.attitude_wn_rad_s": 6.0}, "warning"),
    ("lag", {"types.sih.attitude_delay_s": 0.25}, "warning"),
    ("lag", {"types.sih.attitude_wn_rad_s": 2.0}, "refused"),
    ("vehicles", {"defaults.enabled": False}, "refused"),
    ("braking", {"types.sih.max_speed_m_s": 4.0}, "refused"),
    ("initial conditions", {"vehicles.mav1.start_enu_m": [-0.65, -1.5, 0.0]}, "refused"),
    ("initial conditions", {"vehicles.mav1.start_enu_m": [-0.55, -1.5, 0.0]}, "warning"),
    (
        "crowding",
        {"fleet.geofence_m": {"x": [-1.9, 1.9], "y": [-1.9, -0.9], "z": [0, 3]}},
        "refused",
    ),
    ("neighbours", {"law.max_neighbours": 1}, "refused"),
    (
        "fence, take-off spots",
        {"fleet.geofence_m": {"x": [-1.6, 4], "y": [-4, 4], "z": [0, 3]}},
        "refused",
    ),
    ("fence, take-off spots", {"law.fence_margin_m": 5.0}, "refused"),
    ("height at full tilt", {"types.sih.hover_thrust_frac": 0.9}, "refused"),
    ("thrust reserve", {"types.sih.hover_thrust_frac": 0.9}, "refused"),
    ("gust reserve", {"types.sih.max_tilt_deg": 12.0}, "refused"),
    ("battery", {"types.sih.px4_params": {"BAT_CRIT_THR": 0.25}}, "refused"),
    ("battery", {"fleet.battery_land_pct": 9.0}, "warning"),
    ("silence", {"types.sih.px4_params": {"COM_OF_LOSS_T": 2.0}}, "refused"),
    ("law", {"law.name": "off"}, "warning"),
]


def test_each_finding_fails_on_purpose_with_value_bound_and_remedy() -> None:
    for name, changes, status in BROKEN:
        case = f"{name}: {changes}"
        finding = named(fleet_with(changes), name)
        assert finding.status == status, case
        assert finding.sentence.endswith(finding.remedy), case
        if name not in ("law", "vehicles"):
            assert f"{finding.bound:.3g}" in finding.sentence, case
            assert (finding.value < finding.bound) == (finding.relation == "at least"), case


# finding, accuracy, changes, the remedy's numbers, and the keys to which they are added or set
FOLLOWED: list[tuple[str, ErrorClass, list[dict[str, Any]], str, list[str]]] = [
    (
        "height at full tilt",
        "mocap",
        [
            {"types.sih.hover_thrust_frac": hover, "types.sih.max_tilt_deg": 45.0}
            for hover in (0.66, 0.7, 0.75, 0.8, 0.85, 0.9)
        ],
        r"max_tilt_deg = (\d+)",
        ["types.sih.max_tilt_deg"],
    ),
    (
        "wind",
        "mocap",
        [
            {
                "types.sih.drag_1_s": drag,
                "types.sih.max_wind_m_s": 30.0,
                "types.sih.max_tilt_deg": 10.0,
            }
            for drag in (0.3, 1.52, 2.5, 3.3, 4.55)
        ],
        r"max_wind_m_s = ([\d.]+)",
        ["types.sih.max_wind_m_s"],
    ),
    (
        "kappas",
        "mocap",
        [
            {"law.kappa_1_1_s": kappa, "law.kappa_2_1_s": 2.0 * kappa}
            for kappa in (7.73, 11.23, 13.1)
        ],
        r"up to ([\d.]+) and ([\d.]+) 1/s",
        ["law.kappa_1_1_s", "law.kappa_2_1_s"],
    ),
    (
        "kappas",
        "mocap",
        [{"law.name": "paper", "types.sih.attitude_wn_rad_s": wn} for wn in (5.0, 7.0, 9.0, 11.0)],
        r"Lower them to ([\d.]+),",
        ["law.paper_kappa_1_1_s", "law.paper_kappa_2_1_s"],
    ),
    (
        "margin",
        "vision",
        [{"law.margin": "fixed", "law.kappa_1_1_s": kappa} for kappa in (3.0, 4.0, 5.0)],
        r"design_margin_m = ([\d.]+)",
        ["law.design_margin_m"],
    ),
    (
        "bus delay",
        "mocap",
        [{"radio.expected_delay_s": delay} for delay in (0.2, 0.25, 0.333)],
        r"design_margin_m = ([\d.]+)",
        ["law.design_margin_m"],
    ),
    (
        "inequality",
        "mocap",
        [{"types.sih.max_speed_m_s": speed} for speed in (1.5, 1.7, 1.9, 2.2)],
        r"margin of ([\d.]+) m would",
        ["law.design_margin_m"],
    ),
    (
        "sensing range",
        "mocap",
        [{"law.range_m": 1.0, "types.sih.max_speed_m_s": speed} for speed in (0.7, 0.9, 1.1)],
        r"by ([\d.]+) m",
        ["law.range_m +"],
    ),
    (
        "body",
        "mocap",
        [{"fleet.body_diameter_m": diameter_m} for diameter_m in (0.71, 0.734, 0.777)],
        r"by ([\d.]+) m",
        ["fleet.safety_distance_m +"],
    ),
]


@pytest.mark.parametrize(
    ("name", "errors", "cases", "numbers", "keys"), FOLLOWED, ids=[row[0] for row in FOLLOWED]
)
def test_the_number_of_a_remedy_ends_the_finding(
    name: str, errors: ErrorClass, cases: list[dict[str, Any]], numbers: str, keys: list[str]
) -> None:
    for changes in cases:
        fleet = fleet_with(changes)
        finding = named(fleet, name, errors=errors)
        assert finding.status != "ok", changes
        found = re.search(numbers, finding.remedy)
        assert found is not None, finding.remedy

        followed = dict(changes)
        for index, key in enumerate(keys):
            number = float(found[min(index + 1, found.re.groups)])
            key, _, plus = key.partition(" ")
            if plus:
                section, field = key.split(".")
                number += getattr(getattr(fleet, section), field)
            followed[key] = number
        after = named(fleet_with(followed), name, errors=errors)
        assert after.status == "ok", (changes, finding.remedy, after.sentence)


def test_spots_that_are_moved_apart_by_the_remedy_are_far_enough_apart() -> None:
    fleet = fleet_with()
    for x_m in (0.951, 0.9555, 0.999):
        for _ in range(2):
            spots = {"mav0": (0.0, 0.0, 1.0), "mav1": (x_m, 0.0, 1.0)}
            findings = {finding.title: finding for finding in spot_findings(fleet, spots, "here")}
            spacing = findings["spacing, here"]
            found = re.search(r"([\d.]+) m farther apart", spacing.remedy)
            if found is not None:
                x_m += float(found[1])
        assert spacing.status == "ok", spacing.sentence


def test_a_crowd_that_knows_too_few_and_has_too_little_room_is_told_both_at_once() -> None:
    crowded = {"x": [-1.9, 1.9], "y": [-1.9, -0.9], "z": [0, 3]}
    fleet = fleet_with({"fleet.geofence_m": crowded, "law.max_neighbours": 1})
    assert named(fleet, "neighbours").status == "refused"
    assert named(fleet, "crowding").status == "refused"


def test_the_papers_law_is_held_to_its_own_initial_conditions_and_kappas() -> None:
    near = fleet_with({"law.name": "paper", "law.paper_v_perp_m_s": 3.2, "formations": {}})
    start = named(near, "initial conditions")
    assert start.bound == pytest.approx(math.sqrt(0.8**2 + 0.8 * 3.2 / 1.5), abs=1e-4)
    assert start.status == "refused"
    assert named(near, "kappas").bound == pytest.approx(4.0 / (27.0 * SIH.lag_s), abs=1e-4)
    assert named(fleet_with({"law.name": "paper"}, base="paper"), "kappas").status == "refused"
    slower = {"law.name": "paper", "law.paper_kappa_1_1_s": 0.9, "law.paper_kappa_2_1_s": 0.9}
    assert named(fleet_with(slower), "kappas").status == "ok"


def test_at_the_papers_bound_h_2_of_equation_21_vanishes_at_rest() -> None:
    d_inf = 0.8
    v_perp = 0.1
    kappa_3 = 1.5
    kappa_4 = 1.5
    fleet = fleet_with({"law.name": "paper"})
    d = named(fleet, "initial conditions").bound
    h_2 = -kappa_4 * (0.0 - d_inf * v_perp) - kappa_3 * kappa_4 * (d * d - d_inf**2)
    assert h_2 == pytest.approx(0.0, abs=1e-3)


def test_one_vehicle_alone_is_not_asked_about_neighbours() -> None:
    alone = fleet_with({"vehicles.mav1.enabled": False, "vehicles.mav2.enabled": False})
    assert {"margin", "kappas", "initial conditions"}.isdisjoint(
        f.name for f in fleet_findings(alone)
    )
    nobody = fleet_with({f"vehicles.mav{i}.enabled": False for i in range(3)})
    assert [(finding.name, finding.status) for finding in fleet_findings(nobody)] == [
        ("vehicles", "refused")
    ]


def test_the_worst_comes_first_and_of_unequal_vehicles_the_worst_is_named() -> None:
    findings = fleet_findings(
        fleet_with({"vehicles.mav1.hover_thrust_frac": 0.9, "law.range_m": 3.0})
    )
    order = [("refused", "warning", "note", "ok").index(finding.status) for finding in findings]
    assert order == sorted(order)
    assert "mav1" in next(f for f in findings if f.name == "thrust reserve").sentence


def test_spots_of_a_constellation_are_judged_for_spacing_and_room() -> None:
    fleet = fleet_with()
    tight = spot_findings(fleet, {"mav0": (0.0, 0.0, 1.0), "mav1": (0.95, 0.0, 1.0)}, "here")
    assert [finding.status for finding in tight] == ["refused", "ok", "ok"]
    assert spot_findings(fleet, {"mav0": (3.9, 0.0, 1.0)}, "there")[0].status == "refused"


def test_the_margin_is_the_fit_at_the_accuracies_it_was_made_for() -> None:
    assert bounds.required_margin_m(ACCURACIES["mocap"], 4.0, 8.0) == pytest.approx(0.10, abs=0.02)
    assert bounds.required_margin_m(ACCURACIES["vision"], 5.0, 10.0) == pytest.approx(
        0.41, abs=0.01
    )
    assert bounds.required_margin_m(ACCURACIES["gps"], 4.0, 8.0) == pytest.approx(1.49, abs=0.01)


@pytest.mark.parametrize(
    ("errors", "margin_m", "status"),
    [
        ("mocap", 0.2, "ok"),
        ("vision", 0.2, "warning"),
        ("vision", 0.32, "ok"),
        ("gps", 0.3, "warning"),
    ],
)
def test_obstacles_need_a_margin_for_the_error_of_the_estimate(
    errors: ErrorClass, margin_m: float, status: str
) -> None:
    fleet = fleet_with({"law.obstacle_margin_m": margin_m}, base="gap")
    assert named(fleet, "obstacle margin", errors=errors).status == status
    assert fleet_with().obstacles == ()
    assert "obstacle margin" not in {each.name for each in fleet_findings(fleet_with())}


@pytest.mark.parametrize(("speed_m_s", "status"), [(1.0, "ok"), (0.75, "ok"), (0.6, "warning")])
def test_a_vehicle_beside_people_is_fast_enough_to_flee(speed_m_s: float, status: str) -> None:
    """In flights past a person at 1.5 m/s, vehicles of 0.6 m/s came to 0.56 m from his circle."""
    fleet = fleet_with({"people.anna.radius_m": 0.4, "types.sih.max_speed_m_s": speed_m_s})
    finding = named(fleet, "people")
    assert finding.status == status
    assert "anna" in finding.sentence
    assert "people" not in {each.name for each in fleet_findings(fleet_with())}


def test_the_row_of_two_vehicles_closing_head_on_begins_to_ask_at_its_range() -> None:
    v = 2.0
    d = 0.9
    k_1 = 4.0
    k_2 = 8.0
    r = bounds.row_range_m(v, d, k_1, k_2)
    need = -v * v + (k_1 + k_2) * r * v - 0.5 * k_1 * k_2 * (r * r - d * d)
    assert need == pytest.approx(0.0, abs=1e-9)


def test_the_loop_dies_out_with_prediction_where_it_grows_without() -> None:
    assert bounds.loop_growth_1_s(SIH, 4.0, 8.0) < 0.0
    assert bounds.loop_growth_1_s(SIH, 4.0, 8.0, is_predicted=False) > 0.5
    grown = [
        bounds.loop_growth_1_s(SIH, 4.0, 8.0, lag_error_s=error) for error in (0.0, 0.04, 0.12)
    ]
    assert grown[0] < grown[1] < 0.0 < grown[2]


@pytest.mark.parametrize("zeta", [0.5, 1.0, 2.0])
def test_a_response_that_is_quicker_than_the_error_of_its_lag_does_not_count_as_growing(
    zeta: float,
) -> None:
    quick = Response(delay_s=0.0, wn_rad_s=60.0, zeta=zeta)
    for lag_error_s in (-0.04, 0.0, 0.04):
        assert bounds.loop_growth_1_s(quick, 4.0, 8.0, lag_error_s=lag_error_s) < 0.0


def test_the_growth_rate_is_that_of_the_loop_flown_in_time() -> None:
    k_1 = 10.0
    k_2 = 20.0
    dt = 0.02
    steps = round(WEAK.delay_s / dt)
    y = 0.01
    v = 0.0
    a = 0.0
    jerk = 0.0
    past = [0.0] * 40
    sizes = []
    for _ in range(400):
        window = WEAK.lag_s
        p = y + WEAK.lag_s * v
        w = v
        for index, u in enumerate(past):
            inside = min(max(window - index * dt, 0.0), dt)
            w += inside * u
            p += inside * (index * dt + 0.5 * inside) * u
        past = [-(k_1 + k_2) * w - k_1 * k_2 * p, *past[:-1]]
        for _ in range(4):
            h = dt / 4
            jerk += h * (
                WEAK.wn_rad_s**2 * (past[steps] - a) - 2.0 * WEAK.zeta * WEAK.wn_rad_s * jerk
            )
            a += h * jerk
            y += h * v + 0.5 * h * h * a
            v += h * a
        sizes.append(math.hypot(y, v))
    flown = np.log(max(sizes[300:]) / max(sizes[200:300])) / (100 * dt)
    assert bounds.loop_growth_1_s(WEAK, k_1, k_2) == pytest.approx(flown, rel=0.15)


def test_braking_needs_more_the_faster_two_vehicles_close() -> None:
    asked = [bounds.braking_m_s2(v, 0.9, 4.0, 8.0) for v in (1.0, 2.0, 4.0)]
    assert asked == sorted(asked)
    assert asked[0] > 0.0


def test_available_acceleration_is_bounded_by_tilt_and_by_thrust() -> None:
    assert bounds.available_acceleration_m_s2(20.0, 0.5) == pytest.approx(
        9.80665 * math.tan(math.radians(20.0))
    )
    assert bounds.available_acceleration_m_s2(45.0, 0.9) < 4.0
    assert bounds.available_acceleration_m_s2(30.0, 0.99) == 0.0


def test_vehicles_that_would_be_too_long_without_poses_are_warned_of_and_then_refused() -> None:
    fleet = fleet_with()
    statuses = []
    for height_m in (2.5, 4.2, 8.0):
        spots = {"mav0": (0.0, 0.0, 1.0), "mav1": (2.0, 0.0, height_m)}
        findings = {finding.title: finding for finding in spot_findings(fleet, spots, "here")}
        statuses.append(findings["descent without poses, here"].status)
    assert statuses == ["ok", "warning", "refused"]
    alone = spot_findings(fleet, {"mav1": (2.0, 0.0, 8.0)}, "here")
    assert "descent without poses, here" not in {finding.title for finding in alone}


def test_a_descent_without_poses_goes_to_the_ground_below_and_not_to_the_own_spot() -> None:
    on_roof = {"vehicles.mav1.start_enu_m": [2.0, 2.0, 6.0], "fleet.geofence_m.z": [-1.0, 12.0]}
    fleet = fleet_with(on_roof)
    statuses = []
    for x, y in ((2.0, 2.0), (0.0, -1.5)):  # above the roof, and above the yard beside it
        spots = {"mav0": (-1.5, -1.5, 1.0), "mav1": (x, y, 8.0)}
        findings = {finding.title: finding for finding in spot_findings(fleet, spots, "here")}
        statuses.append(findings["descent without poses, here"].status)
    assert statuses == ["ok", "refused"]


def test_the_wind_finding_says_how_far_apart_to_put_vehicles_down() -> None:
    assert (
        "by about 1.0 m: put them down 1.8 m apart"
        in named(fleet_with(base="paper"), "wind").sentence
    )
    weak = named(fleet_with({"fleet.max_wind_m_s": 1.0}, base="paper"), "wind")
    assert "by about 0.1 m: put them down 0.9 m apart" in weak.sentence

    # a wind that takes all of the tilt is refused; nobody lifts off in it
    fleet = fleet_with({"types.ardrone.max_wind_m_s": 16.0}, base="paper")
    assert "lift-off" not in named(fleet, "wind").sentence
    with pytest.raises(ValueError, match="takes all of the tilt"):
        blown_aside_m(fleet.vehicles["mav0"], 16.0)


def test_a_vehicle_is_blown_aside_further_the_more_it_lags_and_the_less_it_tilts() -> None:
    usual_m = blown_aside_m(fleet_with().vehicles["mav0"], 2.0)
    slow_m = blown_aside_m(fleet_with({"types.sih.attitude_delay_s": 0.2}).vehicles["mav0"], 2.0)
    upright_m = blown_aside_m(fleet_with({"types.sih.max_tilt_deg": 15}).vehicles["mav0"], 2.0)
    assert slow_m > usual_m < upright_m
    assert blown_aside_m(fleet_with().vehicles["mav0"], 0.0) == 0.0


@pytest.mark.parametrize(
    ("value", "words"), [(0.9177, "It is 0.9177 m of 0.9181 m."), (1.2, "It is 1.2 m of 0.918 m.")]
)
def test_a_value_that_misses_its_bound_by_little_is_written_so_that_they_differ(
    value: float, words: str
) -> None:
    finding = at_least("x", value, 0.9181, "m", "It is <value> of <bound>", "Move.")
    assert finding.sentence.startswith(words)


def test_vehicles_by_px4s_position_in_a_fleet_without_an_origin_on_earth_are_warned_of() -> None:
    without_mocap = {"vehicles.mav1.mocap_required": False}
    finding = named(fleet_with(without_mocap), "no place on Earth")
    assert finding.status == "warning"
    assert finding.sentence.startswith("Without a mocap, mav1 flies by PX4's own position")

    origin = {"latitude_deg": 47.4, "longitude_deg": 8.5, "altitude_m": 489.0}
    names = [f.name for f in fleet_findings(fleet_with({**without_mocap, "fleet.origin": origin}))]
    assert "no place on Earth" not in names
    assert "no place on Earth" not in [f.name for f in fleet_findings(fleet_with())]

    by_vision = {**without_mocap, "vehicles.mav1.px4_position": "vision", "fleet.origin": origin}
    finding = named(fleet_with(by_vision), "no place on Earth")
    assert "mav1 flies by vision" in finding.sentence
    assert finding.remedy == "Outdoors, fly by satellites.", "the fleet has an origin"

    both = {
        **by_vision,
        "vehicles.mav2.mocap_required": False,
        "vehicles.mav2.px4_position": "vision",
    }
    assert "mav1, mav2 fly by vision" in named(fleet_with(both), "no place on Earth").sentence


def test_heights_by_satellites_are_warned_of_where_vehicles_pass_above_each_other() -> None:
    above = {"fleet.vertical_separation_m": 1.0}
    assert "heights by satellites" not in [f.name for f in fleet_findings(fleet_with(above))]

    by_satellites = {**above, "vehicles.mav1.mocap_required": False}
    finding = named(fleet_with(by_satellites), "heights by satellites")
    assert finding.status == "warning"
    assert "mav1 flies by satellites, whose heights err by metres" in finding.sentence
