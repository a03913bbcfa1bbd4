"""Alarms: the table is whole, and what lasts is one line."""

from __future__ import annotations

import pytest

from groundstation.alarms.alarm_table import (
    NOT_HEARD_YET,
    TABLE,
    AlarmSeverity,
    GroundCondition,
    without_implied,
)
from groundstation.alarms.alarms import (
    LINGER_S,
    MAX_OVER,
    START_S,
    Alarms,
    conditions,
    lasting,
)
from groundstation.fleet import state as fleet_state
from groundstation.fleet.state import FleetState
from onboard.bus.schema import Event, Truth
from onboard.config.fleet import FleetConfig, load_fleet
from onboard.safety.failsafe_table import Condition
from onboard.types import TICK_S
from tests.groundstation.console.fake import telemetry

SECOND = 1_000_000_000
START_TICKS = round(START_S / TICK_S)
AT_REST = {"is_armed": False, "is_airborne": False, "is_position_valid": False}


class Ground3:
    """Three vehicles, and a clock that the test turns."""

    def __init__(self) -> None:
        self.fleet: FleetConfig = load_fleet("configs/fleets/paper.toml")
        self.state: FleetState = fleet_state.initial(self.fleet)
        self.alarms = Alarms(self.fleet)
        self.now_ns = 100 * SECOND
        self.sequence = 2 * START_TICKS  # the agents run for long

    def hear(self, vehicle: str = "mav0", **changes: object) -> None:
        self.sequence += 1
        usual = {
            "position_enu_m": (2.0 * self.fleet.enabled_names.index(vehicle) - 1.5, 0.0, 1.0),
            "config_hash": self.fleet.config_hash,
        }
        heard = telemetry(vehicle, sequence=self.sequence, **{**usual, **changes})
        self.state = fleet_state.fold(self.state, heard, self.now_ns)

    def all_hear(self, **changes: object) -> None:
        for name in self.fleet.enabled_names:
            self.hear(name, **changes)

    def kinds(self) -> list[object]:
        return [alarm.kind for alarm in conditions(self.state, self.fleet, self.now_ns)]

    def wait(self, seconds: float) -> None:
        self.now_ns += int(seconds * SECOND)

    def update(self) -> None:
        self.alarms.update(self.state, self.now_ns)

    def texts(self) -> list[str]:
        return [line.text(self.now_ns) for line in self.alarms.lines]


@pytest.fixture
def ground() -> Ground3:
    return Ground3()


@pytest.mark.parametrize("condition", list(Condition), ids=lambda condition: condition.name)
def test_every_failsafe_condition_has_an_alarm_with_a_sentence_and_advice(
    ground: Ground3, condition: Condition
) -> None:
    assert TABLE[condition].sentence
    assert TABLE[condition].advice_in_flight or TABLE[condition].advice
    assert TABLE[condition].in_flight > AlarmSeverity.NOTE
    ground.all_hear()
    ground.hear("mav1", conditions=(condition.value,))
    alarms = conditions(ground.state, ground.fleet, ground.now_ns)
    assert [(alarm.kind, alarm.subject) for alarm in alarms] == [(condition, "mav1")]
    assert "mav1" in alarms[0].sentence


def test_every_row_of_the_table_can_be_written_as_a_sentence() -> None:
    for kind in GroundCondition:
        row = TABLE[kind]
        assert row.on_ground <= row.in_flight
        assert "{" not in row.sentence.format(who="mav0", what="3")


def test_a_condition_that_this_console_does_not_know_is_shown_in_the_vehicles_words(
    ground: Ground3,
) -> None:
    ground.all_hear()
    ground.hear("mav2", conditions=("propeller\x1b[2J missing",))
    (alarm,) = conditions(ground.state, ground.fleet, ground.now_ns)
    assert alarm.kind is GroundCondition.UNKNOWN
    assert alarm.sentence == "mav2: propeller [2J missing"


def test_of_several_conditions_that_this_console_does_not_know_all_are_shown(
    ground: Ground3,
) -> None:
    ground.all_hear()
    ground.hear(conditions=("rotor iced", "parachute open"))
    ground.update()
    (text,) = ground.texts()
    assert "rotor iced" in text
    assert "parachute open" in text


def test_all_well_is_no_alarm(ground: Ground3) -> None:
    ground.all_hear()
    assert ground.kinds() == []


def test_a_bad_number_is_an_alarm_even_if_the_vehicle_reports_no_condition(
    ground: Ground3,
) -> None:
    ground.all_hear()
    ground.hear("mav0", battery_frac=0.05)
    ground.hear("mav1", is_position_valid=False)
    ground.hear("mav2", position_enu_m=(500.0, 0.0, 1.0))
    assert set(ground.kinds()) == {
        Condition.BATTERY_LOW,
        Condition.POSITION_LOST,
        Condition.FENCE_BREACH,
    }


def test_nothing_is_said_to_hold_or_land_a_vehicle_that_a_pilot_flies(ground: Ground3) -> None:
    ground.all_hear()
    ground.hear("mav2", position_enu_m=(500.0, 0.0, 1.0))
    (alarm,) = conditions(ground.state, ground.fleet, ground.now_ns)
    assert alarm.advice.startswith("It holds.")

    ground.hear("mav2", position_enu_m=(500.0, 0.0, 1.0), is_flown_by_hand=True)
    (alarm,) = conditions(ground.state, ground.fleet, ground.now_ns)
    assert alarm.advice == (
        "Its pilot flies it: its agent does nothing about it. Is its position right?"
    )


def test_while_px4_lands_a_vehicle_nothing_is_said_to_be_done_by_its_agent(ground: Ground3) -> None:
    stalled = (Condition.POSITION_LOST.value, Condition.LOOP_STALLED_LONG.value)
    ground.all_hear()
    ground.hear("mav1", conditions=stalled, action="PX4 lands")
    cause, other = conditions(ground.state, ground.fleet, ground.now_ns)
    assert cause.kind is Condition.LOOP_STALLED_LONG
    assert cause.advice == "PX4 lands it. See its log."
    assert other.advice.startswith("PX4 lands it: its agent does nothing about it. ")


def test_why_a_vehicle_was_silent_takes_the_place_of_its_silence(ground: Ground3) -> None:
    ground.all_hear()
    ground.wait(2.0)
    ground.hear("mav0")
    ground.hear("mav2")
    ground.update()
    assert ground.alarms.worst is not None
    assert ground.alarms.worst.alarm.kind is GroundCondition.SILENT

    ground.hear("mav1", conditions=(Condition.LOOP_STALLED_LONG.value,), action="PX4 lands")
    ground.update()
    assert [line.alarm.kind for line in ground.alarms.lines] == [Condition.LOOP_STALLED_LONG]
    (over,) = ground.alarms.over
    assert over.alarm.kind is GroundCondition.SILENT


def test_of_two_alarms_that_say_the_same_only_the_worse_is_shown(ground: Ground3) -> None:
    ground.all_hear()
    both = (Condition.BUS_LOST.value, Condition.BUS_LOST_LONG.value)
    ground.hear("mav0", conditions=both)
    assert ground.kinds() == [Condition.BUS_LOST_LONG]


def test_what_px4_does_not_tell_is_part_of_its_silence(ground: Ground3) -> None:
    ground.all_hear()
    silent = (
        Condition.AUTOPILOT_SILENT,
        Condition.BATTERY_UNKNOWN,
        Condition.LANDED_UNKNOWN,
        Condition.POSITION_INACCURATE,
    )
    texts = tuple(condition.value for condition in silent)
    ground.hear("mav0", conditions=texts)
    assert ground.kinds() == [Condition.AUTOPILOT_SILENT]
    assert without_implied(texts) == [Condition.AUTOPILOT_SILENT.value]


def test_a_vehicle_out_of_service_raises_no_alarm_while_it_stands(ground: Ground3) -> None:
    ground.all_hear()
    standing = {"is_armed": False, "is_airborne": False, "conditions": ("PX4 silent",)}
    ground.hear("mav1", disabled_by="olga", **standing)
    assert ground.kinds() == []

    ground.hear("mav1", **standing)
    assert ground.kinds() == [Condition.AUTOPILOT_SILENT]

    flying = {**standing, "is_armed": True, "is_airborne": True}
    ground.hear("mav1", disabled_by="olga", **flying)
    assert ground.kinds() == [Condition.AUTOPILOT_SILENT]


@pytest.mark.parametrize("condition", NOT_HEARD_YET, ids=lambda condition: condition.name)
def test_what_an_agent_has_not_heard_yet_is_no_alarm_in_its_first_20_s_at_rest(
    ground: Ground3, condition: Condition
) -> None:
    ground.all_hear(**AT_REST)
    ground.sequence = 1
    ground.hear("mav1", boot_id=2, conditions=(condition.value,), **AT_REST)
    assert ground.kinds() == []

    ground.sequence = START_TICKS
    ground.hear("mav1", boot_id=2, conditions=(condition.value,), **AT_REST)
    assert ground.kinds() == [condition]


@pytest.mark.parametrize("condition", NOT_HEARD_YET, ids=lambda condition: condition.name)
@pytest.mark.parametrize("moving", ["is_armed", "is_airborne"])
def test_what_an_armed_or_flying_vehicle_does_not_hear_is_an_alarm_at_once(
    ground: Ground3, moving: str, condition: Condition
) -> None:
    ground.all_hear(**AT_REST)
    ground.sequence = 1
    not_at_rest = {**AT_REST, "is_position_valid": True, moving: True}
    ground.hear("mav1", boot_id=2, conditions=(condition.value,), **not_at_rest)
    assert ground.kinds() == [condition]


def test_while_an_agent_has_not_heard_px4_yet_nobody_says_that_all_is_well(
    ground: Ground3,
) -> None:
    ground.all_hear(**AT_REST)
    ground.update()
    assert ground.alarms.words_without_alarm == "all well"

    ground.sequence = 1
    ground.hear("mav1", boot_id=2, conditions=("PX4 silent",), **AT_REST)
    ground.update()
    assert ground.texts() == []
    assert ground.alarms.words_without_alarm == "starting: mav1"

    ground.hear("mav1", boot_id=2, **AT_REST)
    ground.update()
    assert ground.alarms.words_without_alarm == "all well"


def test_an_agent_that_starts_anew_in_flight_alarms_at_once(ground: Ground3) -> None:
    ground.all_hear()
    ground.sequence = 1
    for _ in range(3):
        ground.hear("mav1", boot_id=2, conditions=("PX4 silent",), **AT_REST)
        assert ground.kinds() == [Condition.AUTOPILOT_SILENT]


def test_an_agent_that_starts_anew_again_and_again_in_flight_alarms_at_once(
    ground: Ground3,
) -> None:
    ground.all_hear()
    deaf = {"autopilot_age_s": float("inf"), "conditions": ("PX4 silent",)}
    for boot_id in (2, 3, 4):
        ground.sequence = 1
        ground.hear("mav1", boot_id=boot_id, **deaf, **AT_REST)
        assert ground.kinds() == [Condition.AUTOPILOT_SILENT]

    ground.hear("mav1", boot_id=4, **AT_REST)  # it hears PX4, which stands disarmed
    ground.sequence = 1
    ground.hear("mav1", boot_id=5, **deaf, **AT_REST)
    assert ground.kinds() == []


def test_ticks_that_an_agent_left_out_count_for_the_time_since_its_start(ground: Ground3) -> None:
    ground.all_hear(**AT_REST)
    ground.sequence = 1
    late = {"missed_ticks": START_TICKS, "conditions": ("PX4 silent",)}
    ground.hear("mav1", boot_id=2, **late, **AT_REST)
    assert ground.kinds() == [Condition.AUTOPILOT_SILENT]


def test_what_the_silence_of_px4_implies_is_no_alarm_either_while_an_agent_starts(
    ground: Ground3,
) -> None:
    ground.all_hear(**AT_REST)
    ground.sequence = 1
    texts = (Condition.AUTOPILOT_SILENT.value, Condition.SATELLITES_LOST.value)
    ground.hear("mav1", boot_id=2, conditions=texts, **AT_REST)
    assert ground.kinds() == []


def test_what_an_agent_sees_is_an_alarm_from_its_start(ground: Ground3) -> None:
    ground.all_hear(**AT_REST)
    ground.sequence = 1
    texts = (Condition.DISK_FULL.value, Condition.AUTOPILOT_IMPOSSIBLE.value)
    ground.hear("mav1", boot_id=2, conditions=texts, battery_frac=0.05, **AT_REST)
    assert set(ground.kinds()) == {
        Condition.DISK_FULL,
        Condition.AUTOPILOT_IMPOSSIBLE,
        Condition.BATTERY_WARNING,
    }


def test_on_the_ground_nobody_is_told_what_happens_in_flight(ground: Ground3) -> None:
    conditions_now = (Condition.POSITION_LOST.value,)
    ground.all_hear()
    ground.hear("mav0", conditions=conditions_now)
    ground.hear("mav1", is_airborne=False, conditions=conditions_now)
    ground.update()

    in_flight, on_ground = ground.texts()
    assert "It lands by dead reckoning." in in_flight
    assert "It lands" not in on_ground
    assert "Look at its markers or satellites." in on_ground


def test_silence_is_critical_in_the_air_and_a_warning_on_the_ground(ground: Ground3) -> None:
    ground.all_hear()
    ground.hear("mav1", is_airborne=False, position_enu_m=(0.5, 0.0, 0.0))
    ground.wait(5.0)
    alarms = {
        alarm.subject: alarm.severity
        for alarm in conditions(ground.state, ground.fleet, ground.now_ns)
    }
    assert alarms == {
        "mav0": AlarmSeverity.CRITICAL,
        "mav1": AlarmSeverity.WARNING,
        "mav2": AlarmSeverity.CRITICAL,
    }


def test_a_silence_counts_from_the_last_telemetry(ground: Ground3) -> None:
    ground.all_hear()
    ground.wait(7.0)
    ground.update()
    assert "mav0: silent (7 s)" in ground.texts()[0]


def test_every_pair_below_the_limit_is_named_with_its_distance(ground: Ground3) -> None:
    ground.hear("mav0", position_enu_m=(0.0, 0.0, 1.0), velocity_enu_m_s=(0.0, 0.0, 0.0))
    ground.hear("mav1", position_enu_m=(0.3, 0.0, 1.0), velocity_enu_m_s=(0.0, 0.0, 0.0))
    ground.hear("mav2", position_enu_m=(0.6, 0.0, 1.0), velocity_enu_m_s=(0.0, 0.0, 0.0))
    alarms = conditions(ground.state, ground.fleet, ground.now_ns)
    assert [alarm.subject for alarm in alarms] == ["mav0 – mav1", "mav0 – mav2", "mav1 – mav2"]
    assert "0.30 m apart" in alarms[0].sentence


def test_a_collision_by_ground_truth_is_the_worst_of_all(ground: Ground3) -> None:
    ground.all_hear(battery_frac=0.01)
    zero = (0.0, 0.0, 0.0)
    truth = Truth(
        vehicle="mav2",
        stamp_ns=1,
        position_enu_m=zero,
        velocity_enu_m_s=zero,
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
        is_on_ground=False,
        is_collided=True,
    )
    ground.state = fleet_state.fold(ground.state, truth, ground.now_ns)
    ground.update()
    assert ground.alarms.worst is not None
    assert ground.alarms.worst.alarm.sentence == "mav2 collided"


def test_an_alarm_that_lasts_is_one_line_with_a_duration(ground: Ground3) -> None:
    for _ in range(700):
        ground.all_hear()
        ground.hear("mav1", conditions=(Condition.LOOP_LATE.value,))
        ground.update()
        ground.wait(0.1)
    (line,) = ground.texts()
    assert line.startswith("mav1: its loop is late (1 min 10 s). ")
    assert ground.alarms.over == []


def test_an_alarm_that_flickers_is_one_line_and_rings_once(ground: Ground3) -> None:
    news = 0
    for step in range(100):
        ground.all_hear()
        if step % 2:
            ground.hear("mav1", conditions=(Condition.POSITION_STALE.value,))
        ground.update()
        news += ground.alarms.has_new
        ground.wait(0.1)
    assert news == 1
    assert len(ground.alarms.lines) == 1
    assert ground.alarms.over == []


def test_an_alarm_does_not_ring_while_a_worse_one_that_implies_it_flickers(
    ground: Ground3,
) -> None:
    stale = (Condition.POSITION_STALE.value,)
    lost = (Condition.POSITION_LOST.value,)
    news = []
    for step in range(100):
        ground.all_hear()
        ground.hear("mav1", conditions=lost if step % 2 else stale)
        ground.update()
        if ground.alarms.has_new:
            news.append(step)
        ground.wait(0.1)
    assert news == [0, 1], "once for each of the two"
    (line,) = ground.alarms.lines
    assert line.alarm.kind is Condition.POSITION_LOST

    for _ in range(40):
        ground.all_hear()
        ground.hear("mav1", conditions=stale)
        ground.update()
        ground.wait(0.1)
    (line,) = ground.alarms.lines
    assert line.alarm.kind is Condition.POSITION_STALE, "the worse one is over"


def test_an_alarm_that_ends_is_kept_as_over_with_how_long_it_lasted(ground: Ground3) -> None:
    ground.all_hear(battery_frac=0.05)
    ground.hear("mav1")
    ground.hear("mav2")
    ground.update()
    ground.wait(0.5)
    ground.all_hear()
    ground.update()
    ground.wait(LINGER_S + 0.1)
    ground.all_hear()
    ground.update()
    assert ground.alarms.lines == []
    (line,) = ground.alarms.over
    assert line.alarm.kind is Condition.BATTERY_LOW
    assert "over for 3 s" in line.text(ground.now_ns)


def test_an_acknowledged_alarm_stays_in_sight_behind_the_open_ones(ground: Ground3) -> None:
    ground.all_hear()
    ground.hear("mav0", conditions=(Condition.FALLEN.value,))
    ground.update()
    assert ground.alarms.acknowledge(ground.alarms.worst) == 1
    ground.hear("mav1", conditions=(Condition.LOOP_LATE.value,))
    ground.update()
    assert [line.alarm.kind for line in ground.alarms.lines] == [
        Condition.LOOP_LATE,
        Condition.FALLEN,
    ]
    assert ground.alarms.lines[1].is_acknowledged
    assert ground.alarms.acknowledge() == 1


def test_an_acknowledged_alarm_that_gets_worse_is_open_and_rings_again(ground: Ground3) -> None:
    ground.all_hear(is_airborne=False)
    ground.hear("mav0", is_airborne=False, conditions=(Condition.POSITION_LOST.value,))
    ground.update()
    ground.alarms.acknowledge()
    ground.wait(0.1)
    ground.hear("mav0", is_airborne=True, conditions=(Condition.POSITION_LOST.value,))
    ground.update()
    assert ground.alarms.has_new
    assert ground.alarms.worst is not None
    assert not ground.alarms.worst.is_acknowledged


def test_the_same_alarm_of_many_vehicles_is_one_line_and_acknowledged_together(
    ground: Ground3,
) -> None:
    names = [f"mav{index}" for index in range(8)]
    views = {name: fleet_state.VehicleView(name) for name in names}
    state = fleet_state.FleetState(views)
    for index, name in enumerate(names):
        heard = telemetry(
            name,
            position_enu_m=(0.2 * index, 0.0, 0.0),
            is_airborne=False,
            battery_frac=0.1,
            config_hash=ground.fleet.config_hash,
        )
        state = fleet_state.fold(state, heard, ground.now_ns)
    ground.alarms.update(state, ground.now_ns)
    (line,) = ground.alarms.lines
    assert line.count == 8
    assert line.alarm.sentence == "8 of them: mav0, mav1, mav2 and 5 more: battery low, 10 %"
    assert ground.alarms.acknowledge(line) == 8
    assert [line.alarm.kind for line in ground.alarms.of("mav7")] == [Condition.BATTERY_WARNING]


def test_a_line_of_many_vehicles_says_the_lowest_battery_also_below_ten_percent(
    ground: Ground3,
) -> None:
    charges_pct = {"mav0": 12.0, "mav1": 9.0, "mav2": 13.0, "mav3": 14.0}
    state = fleet_state.FleetState({name: fleet_state.VehicleView(name) for name in charges_pct})
    for index, (name, charge_pct) in enumerate(charges_pct.items()):
        heard = telemetry(
            name,
            position_enu_m=(0.2 * index, 0.0, 0.0),
            is_airborne=False,
            battery_frac=charge_pct / 100.0,
            config_hash=ground.fleet.config_hash,
        )
        state = fleet_state.fold(state, heard, ground.now_ns)
    ground.alarms.update(state, ground.now_ns)
    (line,) = ground.alarms.lines
    assert line.alarm.sentence == "4 of them: mav0, mav1, mav2 and 1 more: battery low, 9 %"


def test_an_event_that_ends_the_record_stays_until_it_is_acknowledged(ground: Ground3) -> None:
    ground.all_hear()
    event = Event(
        vehicle="ground",
        stamp_ns=1,
        severity="critical",
        code="record_failed",
        sentence="The disk is full.",
    )
    ground.state = fleet_state.fold(ground.state, event, ground.now_ns)
    for _ in range(100):
        ground.all_hear()
        ground.update()
        ground.wait(0.1)
    assert [line.alarm.kind for line in ground.alarms.lines] == [GroundCondition.RECORD_ENDED]
    ground.alarms.acknowledge()
    ground.update()
    assert ground.alarms.lines == []
    assert [line.alarm.kind for line in ground.alarms.over] == [GroundCondition.RECORD_ENDED]


def test_a_kill_in_the_air_is_an_alarm_until_it_is_acknowledged(ground: Ground3) -> None:
    ground.all_hear()
    sentence = "Killed in the air by order of ann (from ground-1)."
    event = Event(vehicle="mav1", stamp_ns=1, severity="critical", code="killed", sentence=sentence)
    ground.state = fleet_state.fold(ground.state, event, ground.now_ns)
    ground.update()
    ground.wait(60.0)
    ground.all_hear(is_airborne=False)
    ground.update()
    (line,) = ground.alarms.lines
    assert (line.alarm.kind, line.alarm.severity) == (
        GroundCondition.KILLED,
        AlarmSeverity.CRITICAL,
    )
    assert line.alarm.sentence == "mav1: Killed in the air by order of ann (from ground-1)"


def test_an_alarm_of_an_event_is_as_old_as_its_event(ground: Ground3) -> None:
    event = Event(vehicle="mav1", stamp_ns=1, severity="critical", code="killed", sentence="Why.")
    ground.state = fleet_state.fold(ground.state, event, ground.now_ns)
    ground.wait(7200.0)
    ground.all_hear()
    ground.update()
    (line,) = ground.alarms.lines
    assert line.duration_s(ground.now_ns) == pytest.approx(7200.0)


@pytest.mark.long
def test_a_vehicle_that_comes_and_goes_a_thousand_times_costs_no_memory(ground: Ground3) -> None:
    for _ in range(1000):
        ground.all_hear(battery_frac=0.05)
        ground.update()
        ground.all_hear()
        ground.wait(LINGER_S + 1.0)
        ground.all_hear()
        ground.update()
    assert len(ground.alarms.over) == MAX_OVER
    assert ground.alarms.lines == []


def test_telemetry_that_is_not_finite_raises_nothing(ground: Ground3) -> None:
    nan = float("nan")
    ground.all_hear(battery_frac=nan, position_enu_m=(nan, nan, nan), state="failed", reason="\n")
    ground.update()
    assert all(
        line.alarm.kind in (GroundCondition.FAILED, Condition.POSITION_LOST)
        for line in ground.alarms.lines
    )


def test_durations_are_short_and_right() -> None:
    assert [lasting(value) for value in (0.0, 59.9, 61.0, 7500.0)] == [
        "0 s",
        "59 s",
        "1 min 1 s",
        "2 h 5 min",
    ]


def test_a_vehicle_that_was_never_heard_is_waited_for_until_another_one_has_its_place(
    ground: Ground3,
) -> None:
    ground.hear("mav0")
    ground.hear("mav1")
    assert GroundCondition.WAITING in ground.kinds()
    ground.hear("mav1", stands_in_for="mav2")
    assert GroundCondition.WAITING not in ground.kinds()
