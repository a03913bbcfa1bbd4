"""Go or no-go: each rule fails once on purpose, alone, with a sentence and a remedy that a person
can act on.
"""

from __future__ import annotations

import dataclasses
import math
import re
from typing import Any

import msgspec
import pytest

from onboard.autopilot import Refused
from onboard.config.fleet import CorrectionsConfig, FleetConfig, Origin, Person, load_fleet
from onboard.corrections.status import BaseFault, BaseJudgement, CorrectionsStatus
from onboard.preflight import all_rules
from onboard.preflight.all_rules import RULES
from onboard.preflight.preflight_facts import PreflightFacts, RadioMeasured
from onboard.preflight.preflight_rule import PreflightCheck
from onboard.safety.failsafe_table import TABLE, Action, Condition, Situation
from tests.architecture import tables

FLEET = load_fleet("configs/fleets/paper.toml")
VEHICLE = FLEET.vehicles["mav1"]
BARE = msgspec.structs.replace(VEHICLE, mocap_required=False)
BY_VISION = msgspec.structs.replace(BARE, px4_position="vision")
EMULATED = msgspec.structs.replace(VEHICLE, emulated=True)
REACHED = msgspec.structs.replace(VEHICLE, px4_version="1.18", direct="udpout://192.168.1.11:18570")
SIGNS = msgspec.structs.replace(VEHICLE, mavlink_signing=True)
SILENT: dict[str, Any] = {"autopilot_age_s": math.inf}
OUTSIDE = msgspec.structs.replace(VEHICLE, start_enu_m=(9.0, 0.0, 0.0))
WEAK = msgspec.structs.replace(VEHICLE, px4_params={"COM_FLTT_LOW_ACT": 3})
STEADY = msgspec.structs.replace(VEHICLE, px4_params={"MC_ROLL_P": 6.5, "MC_PITCH_P": 6.5})
RTK = msgspec.structs.replace(
    FLEET, corrections=CorrectionsConfig(source="tcp", address="x:1", fix="rtk_fixed")
)
ON_EARTH = msgspec.structs.replace(
    FLEET, fleet=msgspec.structs.replace(FLEET.fleet, origin=Origin(47.4, 8.5, 400.0))
)
ANY_FIX = msgspec.structs.replace(FLEET, corrections=CorrectionsConfig(source="mock"))
CORRECTED = CorrectionsStatus(age_s=0.6, base_id=7, base_distance_m=420.0)


def corrected(fleet: FleetConfig = RTK, fix_type: int | None = 6, **changes: Any) -> dict[str, Any]:
    """What is judged of a vehicle that takes corrections."""
    status = msgspec.structs.replace(CORRECTED, **changes)
    return {"fleet": fleet, "vehicle": BARE, "corrections": status, "fix_type": fix_type}


FINE = PreflightFacts(
    autopilot_age_s=0.01,
    heartbeat_age_s=0.4,
    px4_version=(1, 17),
    attitude_hz=50.0,
    has_rc=True,
    sample_delay_s=0.02,
    sample_age_s=0.01,
    position_age_s=0.02,
    position_enu_m=(0.02, -1.5, 0.0),
    px4_position_enu_m=(0.05, -1.52, 0.1),
    fuses_position=True,
    fuses_heading=True,
    battery_frac=0.87,
    battery_voltage_v=11.9,
    missing_neighbours=(),
    lost_neighbours=(),
    other_hashes={},
    config_hash="abc",
    param_problems=(),
    loop_p99_ms=20.4,
    is_law_warm=True,
    is_airborne=False,
    has_recorder=True,
)
VISITED = msgspec.structs.replace(FLEET, people={"anna": Person(), "ben": Person()})
OWN_LAW = msgspec.structs.replace(FLEET, law=msgspec.structs.replace(FLEET.law, name="mine:law"))
VARIANT = msgspec.structs.replace(
    FLEET, law=msgspec.structs.replace(FLEET.law, rotation="violated")
)
FINDING = ("spacing", "mav1 and mav2 are 0.4 m apart.", "Spread the places by 0.65 m.")
SPOT_OF_MAV2 = (1.5, -1.4, 0.0)
SPOTS = {name: vehicle.start_enu_m for name, vehicle in FLEET.vehicles.items()}
# as the mocap sees them that was turned by 7 degrees about its origin, and one that was shifted
TURNED = {
    name: (0.9925 * x - 0.1219 * y, 0.1219 * x + 0.9925 * y, z) for name, (x, y, z) in SPOTS.items()
}
SHIFTED = {name: (x + 0.2, y, z) for name, (x, y, z) in SPOTS.items()}
# rule and fault -> what is wrong, and words that its sentence has
CASES: dict[tuple[str, str], tuple[dict[str, Any], str]] = {
    ("frame", "turned"): ({"spots_seen_enu_m": TURNED}, "turned by 7.0°: so are the places of 3"),
    ("frame", "shifted"): ({"spots_seen_enu_m": SHIFTED}, "3 vehicles are 0.20 m off"),
    ("frame", "spots too near"): (
        {"spots_seen_enu_m": SPOTS, "has_emulator": True},
        "turned by less than 4.1°",
    ),
    ("px4", "silent"): ({"autopilot_age_s": 0.5}, "udpin://127.0.0.1:14541"),
    ("px4", "nonsense"): (
        {
            "autopilot_age_s": math.inf,
            "px4_nonsense": "PX4 says that it is 5335 km from its origin.",
        },
        "5335 km",
    ),
    ("px4", "unsigned"): (
        SILENT | {"refused": Refused(newest="unsigned"), "refused_age_s": 1.0},
        "does not sign",
    ),
    ("px4", "forged"): (
        SILENT | {"refused": Refused(newest="forged"), "refused_age_s": 1.0},
        "another key than keys/mav1",
    ),
    ("px4", "old"): (
        SILENT | {"refused": Refused(newest="old"), "refused_age_s": 1.0},
        "older than what was heard",
    ),
    ("version", "unknown"): ({"px4_version": None}, "does not say its version"),
    ("version", "unmeasured"): ({"px4_version": (1, 19)}, "v1.19 was never measured"),
    ("version", "other lag"): ({"px4_version": (1, 18)}, "lags by 0.29 s instead of 0.25 s"),
    ("version", "same lag"): (
        {"px4_version": (1, 16), "vehicle": STEADY},
        "PX4 is v1.16, the fleet file says v1.17",
    ),
    ("version", "nonsense"): ({"px4_version": (255, 255)}, "version 255.255, which no PX4 has"),
    ("link", "too slow"): ({"attitude_hz": 9.0}, "only 9 Hz"),
    ("link", "slower than usual"): ({"attitude_hz": 30.0}, "30 Hz"),
    ("port", "open to networks"): (
        {"vehicle": msgspec.structs.replace(VEHICLE, autopilot="udpin://0.0.0.0:14541")},
        "every network",
    ),
    ("port", "strangers"): (
        {
            "refused": Refused(other_address=7, newest="other_address", source="10.0.0.9 port 5"),
            "refused_age_s": 1.0,
        },
        "7 packets were not let in, the newest from 10.0.0.9 port 5 (under PX4's ids, from "
        "another address)",
    ),
    ("signing", "keyless"): ({"is_signed": True}, "ignores what is not signed"),
    ("signing", "clock behind"): (
        {"is_signed": True, "has_signing_clock_behind": True, "vehicle": SIGNS},
        "a minute behind",
    ),
    ("signing", "takes any key"): (
        {"px4_version": (1, 18), "vehicle": REACHED},
        "udpout://192.168.1.11:18570, and while it is disarmed it takes a key",
    ),
    ("alone", "duplicate"): ({"has_duplicate": True}, "Another agent runs for mav1"),
    ("health", "failsafe"): ({"is_failsafe": True}, "failsafe"),
    ("health", "unhealthy"): (
        {"unhealthy": (("gyroscope", True), ("satellites", False))},
        "sensors: gyroscope.",
    ),
    ("health", "not required"): ({"unhealthy": (("satellites", False),)}, "satellites"),
    ("disarmed", "not known"): ({"has_landed_report": False}, "does not tell"),
    ("disarmed", "airborne"): ({"is_airborne": True, "is_armed": True}, "in the air"),
    ("disarmed", "armed"): ({"is_armed": True}, "armed already"),
    ("failsafe", "disk full"): (
        {"conditions": frozenset({Condition.DISK_FULL, Condition.POSITION_STALE})},
        "The disk on which this agent logs is full.",
    ),
    ("failsafe", "condition holds"): (
        {
            "conditions": frozenset(
                {Condition.MOCAP_FROZEN, Condition.DISK_FULL, Condition.POSITION_STALE}
            )
        },
        "Mocap repeats itself, disk full.",
    ),
    ("parameters", "unread"): ({"param_problems": None}, "not read yet"),
    ("parameters", "weakened"): (
        {"vehicle": WEAK},
        "px4_params set COM_FLTT_LOW_ACT = 3 for mav1",
    ),
    ("parameters", "differ"): (
        {"param_problems": ("PX4 parameter COM_OF_LOSS_T is 1, this fleet needs 0.3.",)},
        "0.3",
    ),
    ("position", "several sources"): (
        {"pose_sources": 2},
        "2 programs send poses of mocap body 'mav1'",
    ),
    ("position", "no emulator"): (
        {"position_age_s": math.inf, "sample_age_s": math.inf, "vehicle": EMULATED},
        "which covey sitl is to send",
    ),
    ("position", "untracked"): (
        {"position_age_s": math.inf, "sample_age_s": math.inf},
        "mocap body 'mav1'",
    ),
    ("position", "source faulty"): (
        {"position_age_s": math.inf, "source_problem": "OptiTrack at 127.0.0.9 does not answer."},
        "mocap body 'mav1': OptiTrack at 127.0.0.9 does not answer.",
    ),
    ("position", "displaced"): (
        {"position_age_s": 0.3, "vehicle": BARE, "displaced_m": 4.2},
        "begun anew 4.2 m from the take-off spot",
    ),
    ("position", "camera began anew"): (
        {"position_age_s": 0.3, "vehicle": BY_VISION, "displaced_m": 0.1},
        "likely 0.1 m from its take-off spot",
    ),
    ("position", "contradicted"): (
        {"position_age_s": 0.3, "is_contradicted": True},
        "came back somewhere else than PX4's own position",
    ),
    ("position", "camera turned"): (
        {"position_age_s": 0.3, "vehicle": BARE, "is_camera_turned": True},
        "does not use the heading of its camera",
    ),
    ("position", "silent"): ({"position_age_s": 0.3, "vehicle": BARE}, "no local position"),
    ("clock", "wrong stamps"): (
        {"sample_delay_s": -3.0, "position_age_s": math.inf},
        "3 s in the future",
    ),
    ("clock", "unmeasured"): (
        {"clock_bounds_s": {"mav2": math.inf, "mocap": 0.001}},
        "clock of mav2 is not measured",
    ),
    ("clock", "uncertain"): (
        {"clock_bounds_s": {"mav0": 0.002, "mav2": 0.045}},
        "clock of mav2 is known to 45 ms only",
    ),
    ("agreement", "tilt"): (
        {"tilt_miss_rad": math.radians(90.0)},
        "by 90 degrees about which way is up",
    ),
    ("agreement", "tilted by hand"): ({"differed_when_tilted": True}, "tilted by hand"),
    ("agreement", "heading"): (
        {"heading_miss_rad": math.radians(-90.0)},
        "-90 degrees about the heading",
    ),
    ("agreement", "no PX4 position"): ({"px4_position_enu_m": None}, "no local position"),
    ("agreement", "apart"): (
        {"px4_position_enu_m": (1.0, -1.5, 0.0)},
        "0.98 m from where the mocap",
    ),
    ("agreement", "compass"): (
        {"heading_miss_rad": 1.0, "fuses_heading": False},
        "57 degrees from PX4's compass",
    ),
    ("at rest", "moving"): ({"speed_m_s": 0.8}, "It moves with 0.8 m/s"),
    ("at rest", "position moves"): (
        {"speed_m_s": 0.8, "vehicle": BARE},
        "by PX4 moves with 0.8 m/s",
    ),
    ("spot", "not followed"): (
        {"position_enu_m": (1.5, 0.0, 0.0), "has_flown": True, "fuses_position": False},
        "has not followed it there without a break since its flight",
    ),
    ("spot", "swapped"): (
        {"position_enu_m": SPOT_OF_MAV2, "fuses_position": False},
        "take-off spot of mav2",
    ),
    ("spot", "away"): (
        {"position_enu_m": (1.5, 0.0, 0.0), "fuses_position": False},
        "2.12 m from its take-off spot",
    ),
    ("spot", "elsewhere"): (
        {
            "fleet": ON_EARTH,
            "vehicle": BARE,
            "position_enu_m": (0.0, 0.61, 0.0),
            "position_std_m": 0.2,
        },
        "2.11 m from its take-off spot (0.00, -1.50, 0.00) m; 2.10 m are allowed",
    ),
    ("fence", "spot outside"): (
        {
            "vehicle": OUTSIDE,
            "position_enu_m": (3.9, 0.0, 0.0),
            "may_be_anywhere": True,
            "fuses_position": False,
        },
        "(9.00, 0.00, 0.00) m lies outside",
    ),
    ("fence", "position outside"): (
        {"position_enu_m": (0.0, -4.2, 0.0), "may_be_anywhere": True, "fuses_position": False},
        "(0.00, -4.20, 0.00) m lies outside",
    ),
    ("neighbours", "missing"): (
        {"missing_neighbours": ("mav0", "mav2")},
        "mav0, mav2 are not heard",
    ),
    ("neighbours", "lost"): ({"lost_neighbours": ("mav0",)}, "mav0 does not know its position"),
    ("neighbours", "late"): (
        {"radio": RadioMeasured(0.12, "mav0", 0.0, "mav2")},
        "mav0 are 120 ms late or more; the fleet file expects 40",
    ),
    ("corrections", "several sources"): (
        corrected(has_several_sources=True),
        "Two sources of corrections",
    ),
    ("corrections", "base wrong"): (
        corrected(base=BaseJudgement(BaseFault.ELSEWHERE, 12.34)),
        "is not where it was surveyed, by 12.3 m: they are not given to PX4",
    ),
    ("corrections", "silent"): (corrected(age_s=math.inf), "No corrections have come"),
    ("corrections", "old"): (
        corrected(age_s=12.4),
        "The newest corrections are 12 s old; 10 s are allowed",
    ),
    ("corrections", "unsteady"): (corrected(unsteady_s=3.6), "moved 4 s ago"),
    ("corrections", "base far"): (
        corrected(base_distance_m=25_400.0),
        "The base is 25.4 km away; 20 km are allowed",
    ),
    ("corrections", "fix too poor"): (
        corrected(fix_type=5),
        "The fix is RTK float; this fleet demands RTK fixed",
    ),
    ("corrections", "settling"): (
        {**corrected(), "conditions": frozenset({Condition.FIX_FELL_BACK})},
        "right for a moment only",
    ),
    ("corrections", "silent, not demanded"): (
        corrected(ANY_FIX, fix_type=3, age_s=math.inf),
        "No corrections have come; the fix is 3D",
    ),
    ("corrections", "old, not demanded"): (corrected(ANY_FIX, age_s=12.4), "are 12 s old"),
    ("corrections", "message too long"): (corrected(too_long_bytes=906), "A message of 906 bytes"),
    ("neighbours", "lossy"): (
        {"radio": RadioMeasured(0.05, "mav0", 0.31, "mav2")},
        "mav2 31 % are lost or late; the fleet file expects 10",
    ),
    ("people", "too near"): (
        {"fleet": VISITED, "people_m": {"ben": 3.0, "anna": 0.62}},
        "anna is 0.62 m away",
    ),
    ("configuration", "disabled"): (
        {"vehicle": msgspec.structs.replace(VEHICLE, enabled=False)},
        "disables this vehicle",
    ),
    ("configuration", "differs"): (
        {"other_hashes": {"mav2": "xyz"}},
        "mav2 flies with another fleet file, or another law (xyz, here abc",
    ),
    ("certificates", "ended"): ({"certificate_left": ("mav2", -60.0)}, "of mav2 has ended"),
    ("certificates", "ends too soon"): (
        {"certificate_left": ("mav1", 240.0)},
        "of mav1 ends in 0.1 h; a flight and an hour to spare take",
    ),
    ("certificates", "soon"): ({"certificate_left": ("mav1", 1e6)}, "ends in 12 days"),
    ("law", "refused"): ({"law_refusals": (FINDING,)}, "0.4 m apart"),
    ("law", "own law"): (
        {"fleet": OWN_LAW},
        "Law 'mine:law' is none of Covey's, and mav1 is a real vehicle",
    ),
    ("law", "changed policies"): (
        {"fleet": VARIANT},
        "The fleet file sets law.rotation, and mav1 is a real vehicle",
    ),
    ("law", "comparison only"): ({"law_refusals": (FINDING,), "law": "paper"}, "0.4 m apart"),
    ("hover thrust", "far off"): (
        {"hover_frac": 0.45},
        "0.45 of its throttle, the fleet file says 0.75",
    ),
    ("hover thrust", "off"): ({"hover_frac": 0.65}, "0.65"),
    ("battery", "unknown"): ({"battery_frac": math.nan}, "no battery level"),
    ("battery", "implausible"): ({"battery_voltage_v": 0.4}, "0.4 V, which cannot be"),
    ("battery", "low"): ({"battery_frac": 0.22}, "Battery at 22 %, take-off requires 30 %"),
    ("loop", "warming"): ({"is_law_warm": False}, "warming up"),
    ("loop", "late"): ({"loop_p99_ms": 55.0}, "55 ms"),
    ("record", "no recorder"): ({"has_recorder": False}, "Nobody records"),
    ("kill switch", "heard"): ({}, "hears a radio control"),
    ("kill switch", "unheard"): ({"has_rc": False}, "no radio control"),
    ("kill switch", "unknown"): ({"has_rc": None}, "not known"),
}


def judged(fleet: FleetConfig = FLEET, **changes: Any) -> tuple[PreflightCheck, ...]:
    vehicle = changes.pop("vehicle", VEHICLE)
    return all_rules.checks(dataclasses.replace(FINE, **changes), fleet, vehicle)


def test_a_vehicle_that_is_fine_is_go_and_only_the_kill_switch_is_a_word_of_advice() -> None:
    assert all(check.is_ok for check in judged())
    assert [check.name for check in judged() if check.remedy] == ["kill switch"]
    assert all_rules.reasons(FINE, FLEET, VEHICLE) == ()


def test_corrections_that_are_fine_are_told_with_fix_base_and_distance() -> None:
    check = {one.name: one for one in judged(**corrected())}["corrections"]
    assert check.sentence == "RTK fixed; corrections 0.6 s old of base 7, 420 m."
    assert not check.remedy


def test_a_fix_that_px4_does_not_tell_is_none() -> None:
    check = {one.name: one for one in judged(**corrected(fix_type=None))}["corrections"]
    assert not check.is_ok
    assert "The fix is not told" in check.sentence


def test_each_fault_shows_in_its_own_line_only_with_sentence_and_remedy() -> None:
    for (rule, fault), (changes, words) in CASES.items():
        case = f"{rule}: {fault}"
        by_name = {check.name: check for check in judged(**dict(changes))}
        others = {name for name, check in by_name.items() if not (check.is_ok and not check.remedy)}
        assert not others - {rule, "kill switch"}, case
        check = by_name[rule]
        assert words in check.sentence, case
        assert check.sentence.endswith("."), case
        assert check.remedy.endswith("."), case
        assert "{" not in check.sentence + check.remedy, case
        is_advice = {r.name: r for r in RULES}[rule].faults[fault].is_advice
        assert check.is_ok is is_advice, case
        facts = dataclasses.replace(
            FINE,
            **{key: value for key, value in changes.items() if key not in ("vehicle", "fleet")},
        )
        refusals = all_rules.reasons(
            facts, changes.get("fleet", FLEET), changes.get("vehicle", VEHICLE)
        )
        assert refusals == (() if is_advice else (f"{check.sentence} {check.remedy}",)), case


def test_an_own_law_flies_emulated_vehicles_and_real_ones_only_where_the_file_says_so() -> None:
    allowed = msgspec.structs.replace(OWN_LAW.law, allow_own_law_on_real_vehicles=True)
    real = msgspec.structs.replace(OWN_LAW, law=allowed)
    mixed = msgspec.structs.replace(OWN_LAW, vehicles={**FLEET.vehicles, "mav2": EMULATED})
    for fleet, changes, is_ok in (
        (OWN_LAW, {}, False),
        (OWN_LAW, {"has_emulator": True}, True),
        (OWN_LAW, {"vehicle": EMULATED}, True),
        (mixed, {"has_emulator": True}, False),
        (real, {}, True),
    ):
        assert {check.name: check.is_ok for check in judged(fleet, **changes)}["law"] is is_ok


@pytest.mark.parametrize(
    "policy",
    [
        {"responsibility": "half"},
        {"prediction": "none"},
        {"margin": "fixed"},
        {"rotation": "always"},
        {"direction": "pair"},
        {"jam": "ignore"},
    ],
)
def test_a_variant_of_the_law_is_refused_by_a_real_vehicle_and_flown_by_an_emulated_one(policy):
    variant = msgspec.structs.replace(FLEET, law=msgspec.structs.replace(FLEET.law, **policy))
    (name,) = policy
    real = {check.name: check for check in judged(variant)}["law"]
    assert not real.is_ok
    assert f"law.{name}" in real.sentence
    assert {check.name: check for check in judged(variant, has_emulator=True)}["law"].is_ok


def test_a_version_refuses_only_where_its_attitude_lags_by_more_than_the_law_tolerates() -> None:
    for file, flown, gain, is_ok in (
        ("1.16", (1, 17), None, False),  # another default of MC_ROLL_P
        ("1.16", (1, 17), 6.5, True),
        ("1.17", (1, 16), None, False),
        ("1.17", (1, 18), 4.0, False),  # filtered setpoints
        ("1.18", (1, 18), 4.0, True),
        ("1.16", (1, 18), 6.5, False),
    ):
        params = {} if gain is None else {"MC_ROLL_P": gain, "MC_PITCH_P": gain}
        vehicle = msgspec.structs.replace(VEHICLE, px4_version=file, px4_params=params)
        (check,) = (
            check for check in judged(px4_version=flown, vehicle=vehicle) if check.name == "version"
        )
        assert check.is_ok is is_ok, (file, flown, gain)


def test_no_fault_is_left_out_of_these_cases() -> None:
    assert set(CASES) == {(rule.name, fault) for rule in RULES for fault in rule.faults}


def test_every_condition_that_refuses_take_off_is_in_some_line_of_the_page() -> None:
    # which line shows those that have one of their own
    own = {
        "position": {
            Condition.POSITION_STALE,
            Condition.POSITION_LOST,
            Condition.POSITION_LOST_LONG,
        },
        "px4": {Condition.AUTOPILOT_SILENT, Condition.AUTOPILOT_FROZEN, Condition.HEARTBEAT_LOST},
        "corrections": {Condition.FIX_COARSE, Condition.FIX_FELL_BACK, Condition.BASE_FAULT},
        "alone": {Condition.TWIN},
        "neighbours": {Condition.BUS_LOST, Condition.BUS_LOST_LONG},
        "law": {Condition.SEPARATION_BREACHED},
        "configuration": {Condition.CONFIG_DIFFERS},
        "battery": {Condition.BATTERY_WARNING, Condition.BATTERY_LOW, Condition.BATTERY_UNKNOWN},
        "disarmed": {Condition.LANDED_UNKNOWN},
        "fence": {Condition.FENCE_BREACH, Condition.FENCE_BREACH_LONG},
    }
    refusing = {
        condition for condition in Condition if TABLE[Situation.GROUND, condition] is Action.REFUSE
    }
    for condition in refusing - set().union(*own.values()) - {Condition.SHUTDOWN}:
        found = {check.name: check for check in judged(conditions=frozenset({condition}))}
        assert not found["failsafe"].is_ok, condition


def test_what_cannot_be_judged_says_so_and_refuses_nothing_by_itself() -> None:
    silent = {check.name: check for check in judged(autopilot_age_s=math.inf)}
    assert [name for name, check in silent.items() if not check.is_ok] == ["px4"]
    assert silent["battery"].sentence == "Not judged while PX4 is silent."
    blind = {check.name: check for check in judged(position_age_s=math.inf, sample_age_s=math.inf)}
    assert [name for name, check in blind.items() if not check.is_ok] == ["position"]
    assert blind["spot"].sentence == "Not judged without a fresh position."


@pytest.mark.parametrize(
    ("fleet", "north_m", "changes", "is_ready"),
    [
        (ON_EARTH, 0.59, {}, True),
        (ON_EARTH, 0.61, {}, False),
        (ON_EARTH, 0.61, {"position_std_m": 0.3}, True),
        (ON_EARTH, 0.61, {"may_be_anywhere": True}, True),
        (FLEET, 0.61, {}, True),  # its frame begins where it stands
    ],
)
def test_a_vehicle_by_satellites_stands_near_its_spot_before_its_first_flight(
    fleet: FleetConfig, north_m: float, changes: dict[str, Any], is_ready: bool
) -> None:
    facts = {"position_enu_m": (0.0, north_m, 0.0), "position_std_m": 0.2, **changes}
    found = {check.name: check for check in judged(fleet=fleet, vehicle=BARE, **facts)}
    assert found["spot"].is_ok is is_ready


@pytest.mark.parametrize("rule", ["spot", "frame"])
def test_a_vehicle_by_vision_is_not_compared_with_its_spot(rule: str) -> None:
    by_vision = msgspec.structs.replace(BARE, px4_position="vision")
    found = {check.name: check for check in judged(fleet=ON_EARTH, vehicle=by_vision)}
    assert found[rule].sentence == "Not judged for a vehicle whose frame begins where it stands."


def test_numbers_that_are_not_finite_never_make_a_vehicle_ready() -> None:
    for name in (
        "autopilot_age_s",
        "heartbeat_age_s",
        "position_age_s",
        "battery_frac",
        "tilt_miss_rad",
        "heading_miss_rad",
        "speed_m_s",
    ):
        assert all_rules.reasons(
            dataclasses.replace(FINE, **dict[str, Any]({name: math.nan})), FLEET, VEHICLE
        ), name
    lost = dataclasses.replace(FINE, position_enu_m=(math.nan, 0.0, 0.0))
    assert all_rules.reasons(lost, FLEET, VEHICLE)


def test_the_page_names_every_rule_and_marks_what_refuses() -> None:
    page = tables.preflight()
    assert re.findall(r"^### (.+)$", page, re.MULTILINE) == [rule.name for rule in RULES]
    assert page.count("**no-go**") == sum(
        not fault.is_advice for rule in RULES for fault in rule.faults.values()
    )
