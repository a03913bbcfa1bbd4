"""PX4's own failsafes: each is demanded at a value, left as a net, or answered by a row."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec
import pytest

from onboard.autopilot import Version
from onboard.config.fleet import FleetConfig, Vehicle, load_fleet
from onboard.feasibility.fleet_checks import fleet_findings
from onboard.feasibility.vehicle_checks import OWN_FAILSAFES as FINDING
from onboard.px4.own_failsafes import (
    FLAGS_WITHOUT_ACTION,
    OWN_FAILSAFES,
    WITHOUT_ACTION,
    Treatment,
    demanded_parameters,
)
from onboard.px4.required_params import RequiredParam, differences, required_params, weakened
from sitl.px4.parameters import DEFAULTS

PAPER = load_fleet("paper")
SOLO = PAPER.vehicles["mav0"]
LISTS = tomllib.loads(
    Path(__file__).with_name("failsafe_parameters.toml").read_text(encoding="utf-8")
)
VERSIONS: dict[str, Version] = {"1.16": (1, 16), "1.17": (1, 17), "1.18": (1, 18)}

# a value of each demanded parameter by which PX4 would interfere
WRONG = {
    "COM_OF_LOSS_T": 1.0,
    "COM_OBL_RC_ACT": 3,
    "COM_LOW_BAT_ACT": 3,
    "BAT_CRIT_THR": 0.3,
    "COM_FLTT_LOW_ACT": 3,
    "NAV_RCL_ACT": 2,
    "COM_RCL_EXCEPT": 5,
    "NAV_DLL_ACT": 2,
    "MAN_OVERRIDE_SPD": 1.0,
    "COM_RC_OVERRIDE": 2,
    "COM_FLT_TIME_MAX": 300,
    "COM_WIND_MAX_ACT": 3,
    "COM_GNSSLOSS_ACT": 1,
    "GF_MAX_HOR_DIST": 5.0,
    "GF_MAX_VER_DIST": 2.0,
    "GF_PREDICT": 1,
    "FD_FAIL_R": 30,
    "FD_FAIL_P": 30,
    "COM_ACT_FAIL_ACT": 3,
    "COM_IMB_PROP_ACT": 1,
    "COM_PARACHUTE": 3,
    "COM_ARM_ODID": 3,
    "NAV_TRAFF_AVOID": 2,
    "COM_TRAFF_AVOID": 3,
    "COM_ARM_ON_BOOT": 1,
}


def required(name: str) -> dict[str, RequiredParam]:
    return required_params(PAPER, SOLO, VERSIONS[name])


def with_params(**px4_params: float) -> tuple[FleetConfig, Vehicle]:
    vehicle = msgspec.structs.replace(SOLO, px4_params=px4_params)
    vehicles = {**PAPER.vehicles, "mav0": vehicle}
    return msgspec.structs.replace(PAPER, vehicles=vehicles), vehicle


def versions_of(since: Version, before: Version) -> list[str]:
    return [name for name, version in VERSIONS.items() if since <= version < before]


def test_the_lists_are_of_all_versions() -> None:
    assert set(LISTS) == set(VERSIONS) == set(DEFAULTS)


def test_every_flag_of_px4s_failsafes_has_an_entry_or_takes_nobody_out_of_offboard() -> None:
    known = FLAGS_WITHOUT_ACTION | {flag for entry in OWN_FAILSAFES for flag in entry.flags}
    for name, lists in LISTS.items():
        assert set(lists["flags"]) <= known, name


@pytest.mark.parametrize("name", LISTS)
def test_every_parameter_of_px4s_failsafes_has_an_entry_in_each_version(name: str) -> None:
    entries = {
        own.name
        for failsafe in OWN_FAILSAFES
        for own in failsafe.parameters
        if name in versions_of(own.since, own.before)
    }
    optional = {own.name for own in demanded_parameters() if own.is_optional}
    listed = set(LISTS[name]["parameters"])
    assert listed - entries - WITHOUT_ACTION == set()
    assert not entries & WITHOUT_ACTION
    # and no entry is of a parameter that this version lacks
    families = {own for own in entries if not own.startswith("BAT_")}
    assert families - optional <= listed


@pytest.mark.parametrize("name", LISTS)
def test_the_emulated_px4_has_every_parameter_of_an_entry_and_needs_few_changes(name: str) -> None:
    values = DEFAULTS[name]
    for failsafe in OWN_FAILSAFES:
        for own in failsafe.parameters:
            is_there = name in versions_of(own.since, own.before) and not own.is_optional
            assert (own.name in values) == is_there, own.name

    demands = [own.name for own in demanded_parameters()]
    changed = {
        demand.name
        for demand in required(name).values()
        if demand.name in demands and not demand.is_met(values.get(demand.name))
    }
    usual = {"COM_OF_LOSS_T", "COM_OBL_RC_ACT", "COM_LOW_BAT_ACT", "NAV_RCL_ACT"}
    of_version = {
        "1.16": {"COM_FLTT_LOW_ACT"},
        "1.17": set(),
        "1.18": {"MAN_OVERRIDE_SPD", "COM_TRAFF_AVOID"},
    }
    assert changed == usual | of_version[name]


def test_each_entry_says_how_it_is_treated() -> None:
    for failsafe in OWN_FAILSAFES:
        has_demand = any(own.demand is not None for own in failsafe.parameters)
        if failsafe.treated is Treatment.DEMANDED:
            assert has_demand, failsafe.holds
        if failsafe.treated is Treatment.ROW:
            assert failsafe.rows, failsafe.holds
            assert not has_demand, failsafe.holds
        if failsafe.treated is Treatment.NET:
            assert failsafe.why, failsafe.holds


def test_there_is_a_wrong_value_of_each_demand() -> None:
    assert set(WRONG) == {own.name for own in demanded_parameters()}


@pytest.mark.parametrize("own", demanded_parameters(), ids=lambda own: own.name)
def test_a_wrong_value_is_refused_and_a_good_one_is_not(own) -> None:
    for name in versions_of(own.since, own.before):
        demand = required(name)[own.name]
        (sentence,) = differences([demand], {own.name: WRONG[own.name]})
        assert sentence.startswith(f"PX4 parameter {own.name} is {WRONG[own.name]:g}, this fleet")
        for value in (demand.value, *own.accepts):
            assert differences([demand], {own.name: value}) == (), value


def test_what_another_version_has_is_asked_of_no_px4() -> None:
    for name, lists in LISTS.items():
        asked = {demand for demand in required(name) if demand.startswith(("COM_", "FD_", "GF_"))}
        assert asked - set(lists["parameters"]) <= {"COM_TRAFF_AVOID"}, name

    # some PX4s v1.18 have it, and some do not
    demand = required("1.18")["COM_TRAFF_AVOID"]
    assert differences([demand], {}) == ()
    assert differences([demand], {"COM_TRAFF_AVOID": 4}) != ()


@pytest.mark.parametrize("name", WRONG)
def test_px4_params_that_weaken_a_demand_are_refused_by_check_and_do_not_replace_it(
    name: str,
) -> None:
    wrong = 2.0 if name == "COM_OF_LOSS_T" else WRONG[name]
    fleet, vehicle = with_params(**{name: wrong})
    (sentence,) = weakened(fleet, vehicle)
    assert f"px4_params set {name} = {wrong:g} for mav0" in sentence

    finding = next(found for found in fleet_findings(fleet) if found.name == FINDING)
    assert finding.status == "refused"
    assert sentence.removesuffix(".") in finding.sentence
    for version in VERSIONS.values():
        demand = required_params(fleet, vehicle, version).get(name)
        assert demand is None or not demand.is_met(wrong)


def test_px4_params_may_say_what_is_as_good() -> None:
    fleet, vehicle = with_params(
        COM_OF_LOSS_T=0.5, COM_FLTT_LOW_ACT=1, FD_FAIL_R=0, GF_MAX_HOR_DIST=80.0, BAT_CRIT_THR=0.08
    )
    assert weakened(fleet, vehicle) == ()
    own = required_params(fleet, vehicle, (1, 16))
    assert own["COM_OF_LOSS_T"].value == 0.5
    assert not own["COM_FLTT_LOW_ACT"].is_met(0)
    finding = next(found for found in fleet_findings(fleet) if found.name == FINDING)
    assert finding.status == "ok"


def test_px4s_own_fence_lies_outside_the_fleets_by_the_distance_that_stopping_takes() -> None:
    """A box of 8 by 8 by 3 m: 11.31 m across, and at 1 m/s half a metre to stop."""
    demands = required("1.18")
    assert demands["GF_MAX_HOR_DIST"].least == 12.0
    assert demands["GF_MAX_VER_DIST"].least == 4.0
    for name, good_m in (("GF_MAX_HOR_DIST", 12.0), ("GF_MAX_VER_DIST", 4.0)):
        assert demands[name].is_met(0.0)
        assert demands[name].is_met(good_m)
        assert not demands[name].is_met(good_m - 0.5)

    fast = msgspec.structs.replace(SOLO, max_speed_m_s=3.0)
    farther = required_params(PAPER, fast, (1, 18))["GF_MAX_HOR_DIST"]
    assert farther.least is not None
    assert farther.least > 12.0


def test_no_flight_reaches_the_angles_at_which_px4_terminates() -> None:
    steep = msgspec.structs.replace(SOLO, max_tilt_deg=45.0)
    demand = required_params(PAPER, steep, (1, 18))["FD_FAIL_R"]
    assert demand.is_met(60)
    assert not demand.is_met(59)
    assert demand.is_met(0)
