"""A verdict in words: the loop periods, and how near a vehicle came to a person."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from msgspec.structs import replace

from groundstation.fleet.state import (
    MAX_EVENTS,
    Separation,
    fold,
    initial,
    without_earlier_flights,
)
from groundstation.recording.flight_report import FlightReport, LoopTiming
from groundstation.verdict.expectations import Expect, check
from groundstation.verdict.observations import Arrival, FlightObservations, StepResult
from groundstation.verdict.verdict import (
    LandingSpeed,
    NearestPerson,
    Verdict,
    describe,
    judge,
)
from onboard.bus.schema import Event, Telemetry, Truth
from onboard.config.fleet import FleetConfig


def told(begin: str, **changes: Any) -> str:
    """The sentence of a verdict that begins so, without this begin."""
    values: dict[str, Any] = {
        "passed": True,
        "exit_status": 0,
        "summary": "PASSED",
        "mission": "hop",
        "fleet": "paper",
        "law": "covey",
        "checks": [],
        "steps": [],
        "closest": None,
        "is_collision": False,
        "arrivals": [],
        "worst_arrival_m": None,
        "landed": {},
        "loop": {},
        "duration_s": 10.0,
    }
    sentences = describe(Verdict(**{**values, **changes}))
    [sentence] = [line for line in sentences if line.startswith(begin)]
    return sentence.removeprefix(begin)


@pytest.mark.parametrize(
    ("limit_m", "has_come_true", "words"),
    [
        (0.9445, False, "At least 0.9445 m between all: mav0 and mav1 came to 0.944 m."),
        (0.939, True, "At least 0.939 m between all: mav0 and mav1 came to 0.944 m."),
        (12.345678, False, "At least 12.345678 m between all: mav0 and mav1 came to 0.944 m."),
        (0.9, True, "At least 0.90 m between all: mav0 and mav1 came to 0.944 m."),
    ],
)
def test_an_expectation_says_the_distance_that_was_declared(
    fleet: FleetConfig, limit_m: float, has_come_true: bool, words: str
) -> None:
    closest = Separation("mav0", "mav1", 0.9442, stamp_ns=1)
    arrival = Arrival(step="go", vehicle="mav0", distance_m=0.9442, is_truth=True)
    separation, arrived = check(
        Expect(min_separation_m=limit_m, arrived_within_m=limit_m), fleet, closest, [arrival], {}
    )
    assert (separation.has_come_true, separation.sentence) == (has_come_true, words)
    assert separation.limit_m == arrived.limit_m == limit_m
    declared = words.removeprefix("At least ").partition(" between")[0]
    assert arrived.sentence.startswith(f"Goals reached within {declared}: ")


def loop_words(*periods_ms: float) -> str:
    loops = {
        f"mav{number}": LoopTiming(
            period_p50_ms=20.0, period_p99_ms=period_ms, period_max_ms=40.0, ticks=1000
        )
        for number, period_ms in enumerate(periods_ms)
    }
    return told("Loop period, 99th percentile (nominal 20 ms): ", loop=loops)


def test_the_loops_of_a_few_vehicles_are_told_one_by_one() -> None:
    assert loop_words(20.0, 20.1, 20.0) == "mav0 20.0 ms, mav1 20.1 ms, mav2 20.0 ms."


def test_of_many_vehicles_the_longest_loop_period_is_told() -> None:
    assert loop_words(20.0, 20.1, 23.4, 20.0, 20.0) == "at most 23.4 ms, mav2."


@pytest.mark.parametrize(
    ("distance_m", "words"),
    [
        (0.86, "mav0, 0.86 m from the circle of anna, at 12.3 s."),
        (0.74, "mav0, 0.74 m from the circle of anna, at 12.3 s: LESS THAN 0.80 m."),
        (-0.1, "mav0, 0.10 m inside the circle of anna, at 12.3 s: LESS THAN 0.80 m."),
    ],
)
def test_the_vehicle_that_came_nearest_to_a_person_is_told(distance_m: float, words: str) -> None:
    nearest = NearestPerson(
        vehicle="mav0",
        person="anna",
        distance_m=distance_m,
        time_s=12.34,
        safety_distance_m=0.8,
    )
    assert told("Nearest to a person: ", nearest_person=nearest) == words


def test_a_mission_that_went_on_after_a_step_names_who_had_not_done_it(fleet: FleetConfig) -> None:
    left = "Its position is not known any more, so it left the path."
    vehicles = {"mav0": "failed", "mav1": "failed", "mav2": "done"}
    step = StepResult(
        step="follow_path mav0,mav1,mav2",
        duration_s=3.0,
        vehicles=vehicles,
        sentences={"mav0": left, "mav1": left, "mav2": "At (0, 0, 1) m."},
    )
    state = initial(fleet)
    flown = FlightObservations(
        mission="escort",
        fleet=fleet,
        state=state,
        steps=[step],
        arrivals=[],
        begin_ns=0,
        end_ns=0,
    )
    verdict = judge(flown, Expect())
    assert not verdict.passed
    assert verdict.summary.endswith(f"'follow_path mav0,mav1,mav2': mav0, mav1 failed: {left}")


def test_a_vehicle_that_fell_has_not_landed_and_its_speed_is_told() -> None:
    fall = LandingSpeed(
        vehicle="mav1", time_s=14.6, speed_m_s=4.93, limit_m_s=1.6, had_thrust=False
    )
    flight = {"landed": {"mav0": True, "mav1": True}, "touchdowns": [fall]}
    assert told("Landed and disarmed: ", **flight) == "mav0."
    assert told("Fell: ", **flight) == "mav1, and hit the ground with 4.9 m/s, at 14.6 s."


def test_a_vehicle_whose_motors_stopped_just_above_the_ground_has_landed() -> None:
    soft = LandingSpeed(vehicle="mav1", time_s=14.6, speed_m_s=0.3, limit_m_s=0.8, had_thrust=False)
    flight = {"landed": {"mav0": True, "mav1": True}, "touchdowns": [soft]}
    assert told("Landed and disarmed: ", **flight) == "mav0, mav1."


def _observed(fleet: FleetConfig, **changes: Any) -> FlightObservations:
    state = initial(fleet)
    values: dict[str, Any] = {
        "mission": "test",
        "fleet": fleet,
        "state": state,
        "steps": [],
        "arrivals": [],
        "begin_ns": 0,
        "end_ns": 0,
    }
    return FlightObservations(**{**values, **changes})


def test_of_vehicles_that_were_not_heard_before_an_interruption_nothing_is_said(
    fleet: FleetConfig, make_telemetry: Callable[..., Telemetry]
) -> None:
    unheard = _observed(fleet, is_interrupted=True)
    assert "No vehicle was heard, so nothing is known of any." in judge(unheard, Expect()).sentences
    state = fold(initial(fleet), make_telemetry("mav0"), 5)
    heard = _observed(fleet, is_interrupted=True, state=state)
    assert "Landed and disarmed: mav0; NOT: mav1, mav2." in judge(heard, Expect()).sentences


def test_a_mission_that_went_on_without_all_of_its_vehicles_has_not_passed(
    fleet: FleetConfig,
) -> None:
    verdict = judge(_observed(fleet, left_out={"mav0", "mav1"}), Expect())
    assert "No vehicle was left" not in verdict.summary
    verdict = judge(_observed(fleet, left_out={"mav0", "mav1", "mav2"}), Expect())
    assert not verdict.passed
    assert "No vehicle was left: the mission went on without mav0, mav1, mav2." in verdict.summary


def test_a_distance_of_a_vehicle_without_truth_is_not_replaced_by_a_larger_one_of_others(
    fleet: FleetConfig,
) -> None:
    """In a mixed flight only some vehicles have ground truth."""

    def pair(first: str, second: str, distance_m: float, *, is_truth: bool) -> Separation:
        return Separation(first, second, distance_m, 0, is_truth=is_truth)

    recorded = pair("mav0", "mav1", 1.2, is_truth=True)
    report = FlightReport(
        smallest=recorded,
        pairs={"mav0-mav1": recorded},
        collided=(),
        loops={},
        begin_ns=0,
        duration_s=1.0,
    )
    for first, second, distance_m in (("mav0", "mav2", 0.4), ("mav0", "mav1", 1.2)):
        near = pair(first, second, 0.4, is_truth=False)
        state = replace(initial(fleet), smallest=near)
        verdict = judge(_observed(fleet, state=state), Expect(), report)
        assert verdict.closest is not None
        assert verdict.closest.distance_m == distance_m


@pytest.mark.parametrize(
    ("collided", "distance_m", "is_truth", "words"),
    [
        (("mav0", "mav2"), 0.6, True, "mav0, mav2 collided."),
        ((), 0.3, False, "mav0 and mav2 collided."),
        # the truth of PX4s that are simulated one by one knows no contacts
        ((), 0.3, True, "mav0 and mav2 collided."),
    ],
)
def test_a_mission_in_which_vehicles_touched_each_other_has_not_passed(
    fleet: FleetConfig,
    collided: tuple[str, ...],
    distance_m: float,
    is_truth: bool,
    words: str,
) -> None:
    nearest = Separation("mav0", "mav2", distance_m, 0, is_truth=is_truth)
    report = FlightReport(
        smallest=nearest,
        pairs={"mav0-mav2": nearest},
        collided=collided,
        loops={},
        begin_ns=0,
        duration_s=1.0,
    )
    verdict = judge(_observed(fleet), Expect(), report)
    assert verdict.is_collision
    assert not verdict.passed
    assert verdict.exit_status == 1
    assert verdict.summary.endswith(words)


@pytest.mark.parametrize(
    ("simulators", "is_collision"),
    [
        ((7, 7, 7), False),
        ((0, 0, 0), True),  # real PX4s that are simulated one by one
        ((7, 0, 7), True),  # mixed reality
        ((7, 7, 8), True),  # the emulators of two computers
        ((7, 7), True),  # one without truth
    ],
)
def test_only_a_simulator_of_all_vehicles_says_that_those_above_each_other_did_not_touch(
    fleet: FleetConfig, simulators: tuple[int, ...], is_collision: bool
) -> None:
    state = initial(fleet)
    names = fleet.enabled_names[: len(simulators)]
    positions = ((0.0, 0.0, 1.0), (0.0, 0.0, 2.0), (2.0, 0.0, 1.0))[: len(simulators)]
    for name, simulator, position_enu_m in zip(names, simulators, positions, strict=True):
        true = Truth(
            vehicle=name,
            stamp_ns=1,
            position_enu_m=position_enu_m,
            velocity_enu_m_s=(0.0, 0.0, 0.0),
            quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
            is_on_ground=False,
            is_collided=False,
            contacts_known_by=simulator,
        )
        state = fold(state, true, 1)
    verdict = judge(_observed(fleet, state=state), Expect())
    assert verdict.closest is not None
    assert verdict.closest.distance_m == 0.0
    assert verdict.is_collision is is_collision
    assert verdict.passed is not is_collision


def test_a_flight_in_which_an_own_law_was_replaced_has_not_passed(fleet: FleetConfig) -> None:
    state = initial(fleet)
    for name in ("mav2", "mav1"):
        refusal = Event(
            vehicle=name,
            stamp_ns=1,
            severity="warning",
            code="own-law-refused",
            sentence="my_law:law raised NameError: oops.",
        )
        state = fold(state, refusal, 1)

    # as many events follow as the state keeps
    note = Event(vehicle="mav0", stamp_ns=2, severity="debug", code="note", sentence="A note.")
    for _ in range(MAX_EVENTS):
        state = fold(state, note, 2)

    verdict = judge(_observed(fleet, state=state), Expect())
    assert not verdict.passed
    assert verdict.exit_status == 1
    words = "flew in place of the user's own on mav1, mav2: my_law:law raised NameError: oops."
    assert words in verdict.summary

    # the next mission of the same fleet flies anew, and counts only the refusals of its own flights
    state = without_earlier_flights(state)
    assert judge(_observed(fleet, state=state), Expect()).passed


def test_vehicles_that_came_nearer_than_the_fleet_file_says_have_passed_without_an_expectation(
    fleet: FleetConfig,
) -> None:
    nearest = Separation("mav0", "mav2", 0.6, 0, is_truth=True)
    state = replace(initial(fleet), smallest=nearest)
    assert judge(_observed(fleet, state=state), Expect()).passed
