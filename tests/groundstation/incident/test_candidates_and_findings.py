"""What is tried to explain an incident, and which answer comes first."""

from __future__ import annotations

from pathlib import Path

from groundstation.flights.changes import Change, FlightOrigin, changed
from groundstation.flights.simulation_settings import SimulationSettings
from groundstation.incident.candidates import Candidate, candidates_of
from groundstation.incident.findings import Trial, findings_of, sentences
from groundstation.starter.fleet_edit import edited

PAPER = Path("configs/fleets/paper.toml").read_text()
MISSION = Path("configs/missions/paper.toml").read_text()


def origin(fleet: str = PAPER, mission: str = MISSION, **settings: object) -> FlightOrigin:
    return FlightOrigin(
        fleet_text=fleet,
        mission_text=mission,
        settings=SimulationSettings(mission_path="paper.toml", **settings),  # type: ignore[arg-type]
    )


def causes(of: FlightOrigin) -> list[str]:
    return [one.what for one in candidates_of(of) if one.kind == "cause"]


def test_a_flight_of_shipped_files_in_calm_air_has_no_cause_to_try() -> None:
    assert causes(origin()) == []


def test_faults_orders_weather_and_bus_are_tried_one_by_one() -> None:
    of = origin(
        faults=("mav1 motor_dead at=11 motor=2",),
        orders=("12 hold all",),
        wind_enu_m_s=(3.0, 0.0),
        gust_m_s=0.5,
        bus={"loss": 0.2, "delay_s": 0.1},
    )
    assert causes(of) == [
        "without the fault 'mav1 motor_dead at=11 motor=2'",
        "without the order '12 hold all'",
        "in calm air",
        "without the gusts",
        "with the usual loss of the bus (0 in place of 0.2)",
        "with the usual delay_s of the bus (0.001 in place of 0.1)",
        "with a perfect bus",
    ]


def test_numbers_that_others_do_not_have_are_tried_with_the_usual_ones() -> None:
    fleet = edited(
        PAPER,
        {
            "law": {"range_m": 0.9},
            "types": {"ardrone": {"drag_1_s": 0.9, "sitl": {"static_gain": 0.5}}},
            "vehicles": {"mav1": {"max_speed_m_s": 2.0}},
        },
    )
    assert causes(origin(fleet)) == [
        "with law.range_m = 8.0 in place of 0.9",
        "with types.ardrone.drag_1_s = 0.3 in place of 0.9",
        "with types.ardrone.sitl.static_gain = 0.9 in place of 0.5",
        "with vehicles.mav1.max_speed_m_s = 1.0 in place of 2.0",
    ]


DEFAULTS = {
    "max_speed_m_s": 9.0,
    "attitude_delay_s": 0.4,
    "hover_time_s": 600.0,  # has no usual value
    "sitl": {"static_gain": 0.5},
}


def test_values_that_all_vehicles_share_are_tried_with_the_usual_ones() -> None:
    fleet = edited(PAPER, {"defaults": DEFAULTS, "vehicles": {"mav1": {"drag_1_s": 0.9}}})
    assert causes(origin(fleet)) == [
        "with defaults.max_speed_m_s = 1.0 in place of 9.0",
        "with defaults.attitude_delay_s = 0.04 in place of 0.4",
        "with defaults.sitl.static_gain = 1.0 in place of 0.5",
        "with vehicles.mav1.drag_1_s = 0.3 in place of 0.9",
    ]


def test_less_speed_is_less_for_every_vehicle() -> None:
    fleet = edited(PAPER, {"defaults": DEFAULTS, "vehicles": {"mav1": {"max_speed_m_s": 2.0}}})
    (slower,) = [one for one in candidates_of(origin(fleet)) if "less speed" in one.what]
    assert [change.text for change in slower.changes] == [
        "defaults.max_speed_m_s=6.3",
        "types.ardrone.max_speed_m_s=0.7",
        "vehicles.mav1.max_speed_m_s=1.4",
    ]


def test_every_candidate_can_be_made_a_change_of_the_files() -> None:
    fleet = edited(PAPER, {"law": {"range_m": 0.9}, "vehicles": {"mav1": {"max_speed_m_s": 2.0}}})
    fleet = edited(fleet, {"defaults": DEFAULTS})
    mission = MISSION + '\n[[step]]\ndo = "fault"\nname = "mocap_lost"\nvehicles = "mav1"\n'
    of = origin(fleet, mission, faults=("mav1 motor_dead motor=2",), orders=("12 hold all",))
    for candidate in candidates_of(of):
        assert changed(of, candidate.changes, None) != of, candidate.what


def trial(what: str, separation_m: float, *, kind: str = "cause", passed: bool = True) -> Trial:
    candidate = Candidate(kind=kind, what=what, changes=(Change("seed", "1"),))  # type: ignore[arg-type]
    return Trial(candidate=candidate, min_separation_m=separation_m, has_passed=passed)


def test_the_cause_whose_absence_leaves_the_most_room_comes_first() -> None:
    findings = findings_of(
        [
            trial("without the light wind", 0.82),
            trial("without the fault", 0.95),
            trial("without the order", 0.94, passed=False),
            trial("0.2 m more margin", 1.1, kind="defence"),
        ],
        0.8,
    )
    told = sentences(findings)
    assert told[0].startswith("1. The flight would have passed without the fault")
    assert told[1].startswith("2. The flight would have passed without the light wind")
    assert told[2].startswith("It would have passed also by 0.2 m more margin")
    assert "It would not have helped to fly without the order" in told[3]


def test_where_nothing_helps_it_is_said() -> None:
    assert "No single thing" in sentences(findings_of([trial("without the fault", 0.5)], 0.8))[0]


def test_where_there_was_nothing_to_take_away_it_is_said() -> None:
    margin = trial("0.2 m more margin", 0.5, kind="defence")
    not_flown = trial("without the fault", 0.0)._replace(failure="The fleet file is wrong.")
    for trials in ([margin], [margin, not_flown]):
        told = sentences(findings_of(trials, 0.8))
        assert told[0].endswith("nothing unusual of this flight could be taken away.")
