"""A report that surprises is believed when others of its kind agree, and never by itself."""

from __future__ import annotations

import math
from typing import Any

import pytest
from msgspec.structs import replace

from onboard.autopilot import Landed, Snapshot
from onboard.safety.report_confirmation import KINDS, Expected, ReportConfirmation

FLYING = Expected(is_armed=True, mode="OFFBOARD")
S = 1_000_000_000
TRUE = Snapshot(
    heartbeat_ns=S,
    is_armed=True,
    mode="OFFBOARD",
    attitude_ns=S,
    px4_boot_ms=60_000,
    battery_ns=S,
    battery_frac=0.8,
    battery_voltage_v=15.2,
    global_origin=(47.0, 8.0, 0.0),
    landed=Landed.IN_AIR,
)
STEP_NS = {"heartbeat": S, "attitude": 20_000_000, "battery": S // 2}
WRONG: dict[str, tuple[dict[str, Any], ...]] = {
    "heartbeat": ({"is_armed": False}, {"mode": "POSCTL"}, {"mode": "LAND", "is_failsafe": True}),
    "attitude": (
        {"px4_boot_ms": 10},
        {"px4_boot_ms": 2**31},
        {"quaternion_enu_flu_wxyz": (0.0, 1.0, 0.0, 0.0)},
    ),
    "battery": (
        {"battery_frac": 0.05},
        {"battery_voltage_v": 12.0},
        {"battery_frac": math.nan},
    ),
}


def _later(kind: str, stamp: str, number: int, **changes: Any) -> Snapshot:
    """The report of a kind that comes ``number`` steps later, with its clock."""
    after_ns = number * STEP_NS[kind]
    clock: dict[str, Any] = (
        {"px4_boot_ms": TRUE.px4_boot_ms + after_ns // 1_000_000} if kind == "attitude" else {}
    )
    return replace(TRUE, **{stamp: S + after_ns, **clock, **changes})


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_one_wrong_report_is_never_believed_and_contradicted_by_the_next(kind) -> None:
    for wrong in WRONG[kind.name]:
        reports = ReportConfirmation()
        assert reports.believe(TRUE, FLYING) is TRUE
        later: dict[str, Any] = {}
        for number, changes in ((1, wrong), (2, later), (3, later)):
            believed = reports.believe(_later(kind.name, kind.stamp, number, **changes), FLYING)
            for name, value in changes.items():
                assert getattr(believed, name) == getattr(TRUE, name), (name, value)
        assert believed == _later(kind.name, kind.stamp, 3)
        assert reports.contradicted == kind.name
        now_ns = S + 3 * STEP_NS[kind.name]
        assert reports.has_contradiction(now_ns)
        assert reports.contradicted_s(now_ns) == 0.0


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_reports_that_agree_are_believed_after_their_number(kind) -> None:
    for wrong in WRONG[kind.name]:
        reports = ReportConfirmation()
        reports.believe(TRUE, FLYING)
        for number in range(1, kind.needed + 1):
            now = dict(wrong)
            if "px4_boot_ms" in now:
                now["px4_boot_ms"] = int(now["px4_boot_ms"]) + 20 * number
            believed = reports.believe(_later(kind.name, kind.stamp, number, **now), FLYING)
            is_believed = all(
                repr(getattr(believed, name)) == repr(value) for name, value in now.items()
            )
            assert is_believed is (number == kind.needed), (wrong, number)
        assert not reports.contradicted


def test_two_reports_of_one_moment_are_one_and_px4_is_asked_meanwhile() -> None:
    reports = ReportConfirmation()
    reports.believe(TRUE, FLYING)
    asked = 0
    for after_ms in range(0, 100, 20):
        now_ns = 2 * S + after_ms * 1_000_000
        believed = reports.believe(replace(TRUE, heartbeat_ns=now_ns, is_armed=False), FLYING)
        assert believed.is_armed
        asked += reports.is_heartbeat_due(now_ns)
    assert asked == 2
    assert not reports.believe(
        replace(TRUE, heartbeat_ns=2 * S + 100_000_000, is_armed=False), FLYING
    ).is_armed
    assert not reports.is_heartbeat_due(3 * S)


def test_contradictions_that_go_on_count_as_long_and_a_single_one_is_forgotten() -> None:
    reports = ReportConfirmation()
    for second in range(1, 7):
        wrong = {"is_armed": False} if second % 2 == 0 else {}
        reports.believe(replace(TRUE, heartbeat_ns=second * S, **wrong), FLYING)
    assert reports.contradicted_s(6 * S) == pytest.approx(2.0)  # in the third and the fifth second
    assert not reports.has_contradiction(9 * S)
    assert reports.contradicted_s(9 * S) == 0.0


def test_on_the_ground_and_in_a_landing_heartbeats_are_believed_at_once() -> None:
    for expected in (Expected(), Expected(mode="OFFBOARD")):
        reports = ReportConfirmation()
        reports.believe(TRUE, expected)
        down = replace(
            TRUE, heartbeat_ns=2 * S, is_armed=False, mode="HOLD", landed=Landed.ON_GROUND
        )
        assert reports.believe(down, expected) is down


@pytest.mark.parametrize(
    "changes",
    [
        {"is_armed": True, "landed": Landed.ON_GROUND},
        {"is_armed": False, "landed": Landed.IN_AIR},
    ],
)
def test_who_leaves_the_mode_in_the_air_or_armed_has_not_landed(changes: dict[str, Any]) -> None:
    reports = ReportConfirmation()
    reports.believe(TRUE, Expected(mode="OFFBOARD"))
    left = replace(TRUE, heartbeat_ns=2 * S, mode="HOLD", **changes)
    assert reports.believe(left, Expected(mode="OFFBOARD")).mode == "OFFBOARD"


def test_what_a_flight_does_not_expect_any_more_is_believed_without_another_report() -> None:
    reports = ReportConfirmation()
    reports.believe(TRUE, FLYING)
    disarmed = replace(TRUE, heartbeat_ns=2 * S, is_armed=False)
    assert reports.believe(disarmed, FLYING).is_armed
    assert not reports.believe(disarmed, Expected(mode="OFFBOARD")).is_armed
    assert not reports.contradicted


def test_on_the_ground_a_battery_may_be_exchanged_or_fill_up() -> None:
    reports = ReportConfirmation()
    landed = replace(TRUE, landed=Landed.ON_GROUND)
    reports.believe(landed, Expected())
    for number, charge in ((1, 0.9), (2, 1.0)):
        later = replace(
            landed,
            battery_ns=S + number * S // 2,
            battery_frac=charge,
            battery_voltage_v=14.0 + 2 * charge,
        )
        assert reports.believe(later, Expected()) == later
    assert not reports.contradicted
    wrong = replace(later, battery_ns=3 * S, battery_frac=0.05)
    # a flight is not on the ground because PX4 once says so
    assert reports.believe(wrong, FLYING).battery_frac == 1.0


@pytest.mark.parametrize(
    ("kind", "apart_ms", "changes"),
    [("heartbeat", 100, {"is_armed": False}), ("battery", 300, {"battery_frac": 0.05})],
)
def test_reports_confirm_each_other_from_their_shortest_distance_on(
    kind: str, apart_ms: int, changes: dict[str, Any]
) -> None:
    stamp = f"{kind}_ns"
    for later_ms, is_believed in ((apart_ms - 1, False), (apart_ms, True)):
        reports = ReportConfirmation()
        reports.believe(TRUE, FLYING)
        reports.believe(replace(TRUE, **{stamp: 2 * S}, **changes), FLYING)

        later_ns = 2 * S + later_ms * 1_000_000
        believed = reports.believe(replace(TRUE, **{stamp: later_ns}, **changes), FLYING)
        (name,) = changes
        assert (getattr(believed, name) == changes[name]) is is_believed


def test_a_battery_that_measures_no_voltage_is_believed() -> None:
    reports = ReportConfirmation()
    without = replace(TRUE, battery_voltage_v=0.0)
    reports.believe(without, FLYING)
    later = replace(without, battery_ns=2 * S, battery_frac=0.79)
    assert reports.believe(later, FLYING) is later


def attitude(after_ms: float, *, turn_deg: float = 0.0, gained_ms: int = 0) -> Snapshot:
    """The attitude so long after the first one, turned, and with a clock that has gained."""
    half_rad = math.radians(turn_deg) / 2.0
    return replace(
        TRUE,
        attitude_ns=S + round(after_ms * 1e6),
        px4_boot_ms=TRUE.px4_boot_ms + round(after_ms) + gained_ms,
        quaternion_enu_flu_wxyz=(math.cos(half_rad), math.sin(half_rad), 0.0, 0.0),
    )


def is_believed_at_once(report: Snapshot, expected: Expected = FLYING) -> bool:
    reports = ReportConfirmation()
    level = replace(TRUE, quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0))
    reports.believe(level, expected)
    return reports.believe(report, expected) is report


@pytest.mark.parametrize(
    ("report", "is_believed"),
    [
        (attitude(20.0, turn_deg=44.0), True),
        (attitude(20.0, turn_deg=46.0), False),
        (attitude(20.0, turn_deg=-46.0), False),
        (attitude(100.0, turn_deg=180.0), False),
        (attitude(101.0, turn_deg=180.0), True),  # it may have turned so far since
        (attitude(20.0, gained_ms=500), True),
        (attitude(20.0, gained_ms=501), False),
        (attitude(20.0, gained_ms=-520), True),
        (attitude(20.0, gained_ms=-521), False),
    ],
)
def test_an_attitude_surprises_beyond_45_degrees_or_half_a_second_of_its_clock(
    report: Snapshot, is_believed: bool
) -> None:
    assert is_believed_at_once(report) is is_believed


@pytest.mark.parametrize(
    ("changes", "is_believed"),
    [
        ({"battery_frac": 0.71}, True),
        ({"battery_frac": 0.69}, False),
        ({"battery_voltage_v": 13.8}, True),
        ({"battery_voltage_v": 13.5}, False),
    ],
)
def test_a_battery_surprises_beyond_a_tenth(changes: dict[str, float], is_believed: bool) -> None:
    report = replace(TRUE, battery_ns=2 * S, **changes)
    level = replace(report, quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0))
    assert is_believed_at_once(level) is is_believed
    # nobody exchanges the battery of a vehicle in the air, whoever flies it
    assert is_believed_at_once(level, Expected()) is is_believed


def test_a_heartbeat_of_the_flights_mode_is_believed_at_once_with_all_that_it_says() -> None:
    level = replace(TRUE, quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0))
    assert is_believed_at_once(replace(level, heartbeat_ns=2 * S, is_failsafe=True))


def test_a_report_that_waits_still_waits_in_ticks_without_another_one() -> None:
    reports = ReportConfirmation()
    reports.believe(TRUE, FLYING)
    disarmed = replace(TRUE, heartbeat_ns=2 * S, is_armed=False)
    for _ in range(3):
        assert reports.believe(disarmed, FLYING).is_armed
    assert not reports.contradicted


def test_two_surprises_that_differ_contradict_each_other_and_are_counted_anew() -> None:
    reports = ReportConfirmation()
    reports.believe(attitude(0.0), FLYING)
    reports.believe(attitude(20.0, turn_deg=90.0), FLYING)
    assert not reports.contradicted

    for number in range(2, 6):
        turned = attitude(20.0 * number, turn_deg=180.0)
        assert reports.believe(turned, FLYING) is not turned
        assert reports.contradicted == "attitude"
    fifth = attitude(120.0, turn_deg=180.0)
    assert reports.believe(fifth, FLYING) is fifth


def test_an_attitude_that_surprises_is_believed_with_the_fifth_of_its_kind() -> None:
    """They come so quickly that the vehicle cannot have turned meanwhile."""
    reports = ReportConfirmation()
    reports.believe(attitude(0.0), FLYING)
    for number in range(1, 5):
        turned = attitude(10.0 * number, turn_deg=90.0)
        assert reports.believe(turned, FLYING) is not turned
    fifth = attitude(50.0, turn_deg=90.0)
    assert reports.believe(fifth, FLYING) is fifth


def test_a_dropped_snapshot_counts_for_a_second() -> None:
    reports = ReportConfirmation()
    assert reports.impossible(S) == ""
    reports.drop("PX4 says nonsense.", 5 * S)
    assert reports.impossible(6 * S - 1) == "PX4 says nonsense."
    assert reports.impossible(6 * S) == ""


def test_px4_is_asked_for_a_heartbeat_each_60_ms_at_most() -> None:
    reports = ReportConfirmation()
    assert not reports.is_heartbeat_due(S)
    reports.is_heartbeat_wanted = True
    assert reports.is_heartbeat_due(S)
    assert not reports.is_heartbeat_due(S + 59_999_999)
    assert reports.is_heartbeat_due(S + 60_000_000)


@pytest.mark.parametrize(("apart_s", "lasts_s"), [(3.0, 3.0), (3.1, 0.0)])
def test_contradictions_within_three_seconds_belong_together_and_count_for_two(
    apart_s: float, lasts_s: float
) -> None:
    reports = ReportConfirmation()
    assert not reports.has_contradiction(S)
    assert reports.contradicted_s(S) == 0.0
    second_ns = 3 * S + round(apart_s * S)
    for right_ns in (3 * S, second_ns):
        wrong = replace(TRUE, heartbeat_ns=right_ns - S // 2, is_armed=False)
        reports.believe(replace(TRUE, heartbeat_ns=right_ns - S), FLYING)
        reports.believe(wrong, FLYING)
        reports.believe(replace(TRUE, heartbeat_ns=right_ns), FLYING)

    assert reports.contradicted_s(second_ns) == pytest.approx(lasts_s, abs=1e-6)
    assert reports.has_contradiction(second_ns + 2 * S)
    assert not reports.has_contradiction(second_ns + 2 * S + 1)
    assert reports.contradicted_s(second_ns + 2 * S + 1) == 0.0
