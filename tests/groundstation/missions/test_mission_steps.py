"""Steps that hold others, wait or carry formations, and sentences about wrong ones."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import pytest

from groundstation.mission_files.expected_course import expected_duration_s, expected_flight_s
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.mission_findings import mission_findings
from groundstation.mission_files.wall_time import WallTime
from groundstation.missions.beginning import time_refusal
from groundstation.missions.runner import MissionRun
from groundstation.verdict.expectations import EXPECT_MOST_M
from onboard.config.fleet import ConfigError, FleetConfig

DOCS = Path(__file__).resolve().parents[3] / "docs" / "mission-file.md"
UP = {"do": "takeoff", "height_m": 1.0}
RING = {"formations": {"ring": {"shape": "circle"}}}
TO_RING = {"do": "formation", "name": "ring", "position_enu_m": [0, 0, 1.0], "assign": "nearest"}
TURN = {
    "do": "fly_formation",
    "name": "ring",
    "position_enu_m": [0, 0, 1.0],
    "to": [{"turn_deg": 90.0}],
}
SWAP = {
    "do": "goto",
    "goals": {"mav0": [1.5, -1.5, 1.0], "mav2": [-1.5, -1.5, 1.0]},
    "speed_m_s": 0.5,
}
LONG = {"do": "wait", "duration_s": 60.0}
LOW = {"battery_below_pct": 50.0}


def make(fleet: FleetConfig, *steps: dict[str, Any], **tables: Any) -> Mission:
    return mission_from_mapping(
        {"schema": 1, "step": list(steps), **RING, **tables}, path="test.toml", fleet=fleet
    )


def reacting(when: dict[str, Any]) -> dict[str, Any]:
    return {"do": "react", "when": when, "steps": [TO_RING], "then": [{"do": "land"}]}


@pytest.mark.parametrize("name", EXPECT_MOST_M)
def test_an_expected_distance_of_zero_is_refused_as_the_documentation_says(
    name: str, fleet: FleetConfig
) -> None:
    with pytest.raises(ConfigError, match=rf"{name}' is 0.0; it must lie above 0"):
        make(fleet, UP, expect={name: 0.0})
    rows = [row for row in DOCS.read_text().splitlines() if row.startswith(f"| `{name}`")]
    assert all(f"| above 0 to {EXPECT_MOST_M[name]:g} |" in row for row in rows)
    assert rows


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ({"do": "repeat", "times": 3}, "its key 'steps' is missing"),
        ({"do": "repeat", "times": 3, "steps": []}, "step[1].steps"),
        ({"do": "repeat", "times": 0, "steps": [TO_RING]}, "step[1].times"),
        ({"do": "repeat", "times": 2, "steps": [{"do": "spin"}]}, "step[1].steps[0].do"),
        (
            {"do": "repeat", "times": 2, "steps": [{"do": "wait", "length_s": 1}]},
            "step[1].steps[0].length_s",
        ),
        ({"do": "repeat", "times": 2, "steps": [UP]}, "step[1].steps[0]"),
        ({"do": "parallel", "branches": [UP]}, "step[1].branches[0]"),
        (
            {"do": "parallel", "branches": [[{"do": "land", "vehicles": "mav9"}]]},
            "step[1].branches[0][0]",
        ),
        ({"do": "wait"}, "step[1]"),
        ({"do": "wait", "until": {}}, "empty condition"),
        (
            {"do": "wait", "until": {"within_m": 0.2}},
            "'step[1].until.within_m' is the distance from the positions in 'reached', which is",
        ),
        ({"do": "wait", "until": {**LOW, "within_m": 0.2}}, "'step[1].until.within_m'"),
        (reacting({"within_m": 0.2}), "'step[1].when.within_m'"),
        (reacting({"event": ""}), "'step[1].when.event' is empty"),
        ({"do": "wait", "until": {"battery": 3}}, "step[1].until.battery"),
        (
            {"do": "wait", "until": {"battery_below_pct": 200.0}},
            "'step[1].until.battery_below_pct' is 200.0; it must lie between 0.1 and 100",
        ),
        (
            {
                "do": "react",
                "when": {"separation_below_m": -1.0},
                "steps": [TO_RING],
                "then": [TO_RING],
            },
            "step[1].when.separation_below_m",
        ),
        ({"do": "take_off"}, "Did you mean 'takeoff'?"),
        (
            {"do": "takeoff", "heigth_m": 1.0},
            "unknown key 'step[1].heigth_m'. Did you mean 'height_m'? Known keys here: vehicles,"
            " timeout_s, height_m, by, every_s.",
        ),
        ({"do": "wait", "duration_s": "3"}, "it must be a number, not a text."),
        ({"do": "wait", "until": {"landed": "mav9"}}, "mav9"),
        ({"do": "wait", "until": {"reached": {"0-1": [0, 0, 1]}}}, "'0-1' names 2 vehicles"),
        (
            {"do": "wait", "until": {"reached": {"mav0": [0, 0, 1], "0": [1, 0, 1]}}},
            "mav0 has more than one position",
        ),
        (
            {"do": "react", "when": {"vehicles": "mav0"}, "steps": [TO_RING], "then": [UP]},
            "empty condition",
        ),
        (
            {
                "do": "repeat",
                "times": 2,
                "steps": [
                    {"do": "react", "when": {"landed": "mav9"}, "steps": [TO_RING], "then": [LONG]}
                ],
            },
            "step[1].steps[0].when",
        ),
        ({"do": "goto", "goals": {"mav9": [0, 0, 1]}}, "mav9"),
        ({**SWAP, "duration_s": 20.0}, "'step[1]' has a duration_s and a speed_m_s"),
        ({"do": "goto", "goals": {"all": [0, 0, 1]}}, "'all' names 3 vehicles"),
        (
            {"do": "goto", "goals": {"mav0": [0, 0, 1], "0": [1, 0, 1]}},
            "mav0 has more than one position",
        ),
        ({"do": "goto", "goals": {"0-1": [0, 0, 1]}}, "'0-1' names 2 vehicles"),
        ({"do": "goto", "goals": {}}, "'step[1]' (goto): 'goals' is empty"),
        (
            {"do": "goto", "vehicles": "0,2", "goals": {"0": [0, 0, 1], "mav1": [1, 1, 1]}},
            "'step[1]' (goto): 'goals' has mav1, which 'vehicles' does not name",
        ),
        ({"do": "wait", "until": {"separation_above_m": math.nan}}, "separation_above_m"),
        ({"do": "wait", "until": {"reached": {"mav0": [math.nan, 0, 1]}}}, "reached"),
        (
            {"do": "repeat", "times": 2, "steps": [reacting({"landed": "mav9"})]},
            "step[1].steps[0].when",
        ),
        ({**reacting({"fails": True}), "then": [reacting({"landed": "mav9"})]}, "then[0].when"),
        ({"do": "goto", "goals": {"mav0": [0, 0, 1], "mav1": [0.3, 0, 1]}}, "keeps"),
        ({**TO_RING, "name": "star"}, "star"),
        ({**TO_RING, "spacing_m": 0.0}, "step[1].spacing_m"),
        ({**TO_RING, "assign": "best"}, "step[1].assign"),
        ({**TURN, "to": []}, "at least one point"),
        ({**TURN, "to": [{"name": "star"}]}, "star"),
        ({**TURN, "to": [{"turn": 3}]}, "step[1].to"),
        ({**TURN, "leader": "mav9"}, "mav9"),
    ],
)
def test_a_wrong_step_is_refused_with_its_key(
    fleet: FleetConfig, step: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        make(fleet, UP, step)
    assert str(caught.value).startswith("test.toml")
    assert words in str(caught.value)


@pytest.mark.parametrize(("key", "meant"), [("steps", "step"), ("expects", "expect")])
def test_a_wrong_table_of_a_mission_is_refused_with_the_one_that_is_meant(
    fleet: FleetConfig, key: str, meant: str
) -> None:
    with pytest.raises(ConfigError, match=f"unknown key '{key}'. Did you mean '{meant}'"):
        make(fleet, **{key: [UP]})


def test_formations_of_a_mission_need_a_shape_and_stay_with_it_in_another_fleet(
    fleet: FleetConfig,
) -> None:
    with pytest.raises(ConfigError, match="needs a 'shape'"):
        make(fleet, UP, formations={"own": {"mav0": [0, 0, 0]}})
    # agents need not know it
    assert make(fleet, UP, TO_RING).fleet.config_hash == fleet.config_hash


def test_a_formation_that_cannot_be_made_is_named_before_a_step_or_an_operator_orders_it(
    fleet: FleetConfig,
) -> None:
    formations = {"ring": {"shape": "circle"}, "grid": {"shape": "csv", "file": "none.csv"}}
    mission = make(fleet, UP, TO_RING, LAND, formations=formations)
    (finding,) = [one for one in mission_findings(mission) if one.name == "formation"]
    assert finding.status == "warning"
    assert finding.sentence.startswith(
        "A formation of the mission cannot be made: 'formations.grid'"
    )
    assert "none.csv" in finding.sentence

    with pytest.raises(ConfigError, match=r"none\.csv"):
        make(fleet, UP, {**TO_RING, "name": "grid"}, LAND, formations=formations)


def test_paths_of_a_formation_are_judged_before_the_flight(fleet: FleetConfig) -> None:
    fast = {**TURN, "to": [{"turn_deg": 360.0, "duration_s": 2.0}]}
    refused = [
        one.sentence
        for one in mission_findings(make(fleet, UP, fast, {"do": "land"}))
        if one.status == "refused"
    ]
    assert any("speed" in sentence and "Step[1]" in sentence for sentence in refused)
    slow = mission_findings(make(fleet, UP, TURN, {"do": "land"}))
    assert not [one.sentence for one in slow if one.status == "refused"]


def test_a_mission_that_outlasts_a_battery_is_refused(fleet: FleetConfig) -> None:
    long = {"do": "wait", "duration_s": 400.0}
    home = {"do": "land"}
    vehicles = {
        name: msgspec.structs.replace(one, hover_time_s=480.0)
        for name, one in fleet.vehicles.items()
    }
    lasting = msgspec.structs.replace(fleet, vehicles=vehicles)

    def refused(config: FleetConfig) -> list[str]:
        return [
            one.name
            for one in mission_findings(make(config, UP, long, home))
            if one.status == "refused"
        ]

    assert refused(lasting) == ["endurance"]
    assert not refused(fleet)  # nobody knows how long its batteries last


@pytest.mark.parametrize(
    ("errors", "within_m", "status"),
    [
        ("mocap", 0.05, "warning"),
        ("mocap", 0.06, "ok"),
        ("vision", 0.15, "warning"),
        ("gps", 0.7, "warning"),  # one arrival in five is farther away
        ("gps", 0.95, "ok"),
    ],
)
def test_an_expected_arrival_is_compared_with_the_error_in_all_three_axes(
    fleet: FleetConfig, errors: Any, within_m: float, status: str
) -> None:
    mission = make(fleet, UP, SWAP, {"do": "land"}, expect={"arrived_within_m": within_m})
    findings = mission_findings(mission, errors)
    (finding,) = [one for one in findings if one.name == "arrival"]
    assert finding.status == status


def in_parallel(*durations_s: float) -> dict[str, Any]:
    waits = [[{"do": "wait", "duration_s": duration_s}] for duration_s in durations_s]
    return {"do": "parallel", "branches": waits}


def test_of_branches_side_by_side_the_longest_counts(fleet: FleetConfig) -> None:
    def length_s(*steps: dict[str, Any]) -> float:
        return expected_duration_s(make(fleet, UP, *steps).course())

    longest = {"do": "wait", "duration_s": 170.0}
    assert length_s(in_parallel(100.0, 170.0, 90.0)) == length_s(longest)
    inner = {"do": "parallel", "branches": [[in_parallel(50.0, 120.0), in_parallel(50.0)], [LONG]]}
    assert length_s(inner) == length_s(longest)
    again = {"do": "repeat", "times": 3, "steps": [in_parallel(100.0, 170.0)]}
    assert length_s(again) == length_s({**longest, "duration_s": 510.0})


def test_a_battery_is_charged_for_the_flights_of_its_own_vehicle(fleet: FleetConfig) -> None:
    steps = []
    for name in fleet.enabled_names:
        steps += [{**UP, "vehicles": name}, {**LONG, "duration_s": 200.0}]
        steps.append({"do": "land", "vehicles": name})
    vehicles = {
        name: msgspec.structs.replace(one, hover_time_s=480.0)
        for name, one in fleet.vehicles.items()
    }
    lasting = msgspec.structs.replace(fleet, vehicles=vehicles)

    def endurance(*steps: dict[str, Any]) -> Any:
        findings = mission_findings(make(lasting, *steps))
        return next(one for one in findings if one.name == "endurance")

    in_turn = endurance(*steps)
    assert in_turn.status == "ok"
    assert "flies for about 2" in in_turn.sentence  # 200 s, a take-off and a landing
    side_by_side = endurance(UP, in_parallel(200.0, 200.0, 200.0), {"do": "land"})
    assert side_by_side.value == pytest.approx(in_turn.value)
    # after a fault nobody knows who flies
    fault = {"do": "fault", "name": "no_poses", "vehicles": ["mav0"], "duration_s": 0.1}
    assert endurance(steps[0], fault, *steps[1:]).status == "refused"


def test_a_flight_among_branches_is_as_long_in_each_order_of_them(fleet: FleetConfig) -> None:
    up = {**UP, "vehicles": "mav0"}
    land = {"do": "land", "vehicles": "mav0"}
    wait = {"do": "wait", "duration_s": 5.0}

    def flights_s(before: list[dict[str, Any]], *branch: dict[str, Any]) -> list[float]:
        """Return mav0's flight with the branch as the first one of three, and as the last one."""
        times_s = []
        for branches in ([list(branch), [LONG], [wait]], [[LONG], [wait], list(branch)]):
            mission = make(fleet, *before, {"do": "parallel", "branches": branches})
            times_s.append(expected_flight_s(mission.course(), "mav0"))
        return times_s

    up_s = expected_flight_s(make(fleet, up).course(), "mav0")
    land_s = expected_flight_s(make(fleet, up, land).course(), "mav0") - up_s

    for flight_s, expected_s in (
        (flights_s([up], wait, land), up_s + 5.0 + land_s),  # ends in its branch
        (flights_s([up], wait, land, wait, up), up_s + 60.0 - 5.0),  # lands, and flies again
        (flights_s([], wait, up), 60.0 - 5.0),  # begins in its branch, waits for the others
        (flights_s([], up, wait, land), up_s + 5.0 + land_s),
        (flights_s([up], wait), up_s + 60.0),
        (flights_s([], wait), 0.0),
    ):
        assert flight_s == pytest.approx([expected_s, expected_s])

    inner = {"do": "parallel", "branches": [[wait], [land, LONG]]}
    assert flights_s([up], wait, inner) == pytest.approx(2 * [up_s + 5.0 + land_s])


def test_a_timed_step_after_branches_is_not_refused_as_too_late(fleet: FleetConfig) -> None:
    timed = {"do": "wait", "at": "21:30:00", "duration_s": 1.0}
    mission = make(fleet, UP, in_parallel(100.0, 100.0, 100.0), timed)

    def refusal(start_s: float) -> str:
        times = {"21:30:00": WallTime("21:30:00", round(start_s * 1e9))}
        return time_refusal(mission, times, begin_ns=0)

    assert not refusal(130.0)
    assert "was not begun: 'step[2]' (wait)" in refusal(90.0)


def test_the_course_counts_repetitions_and_tells_what_is_left(fleet: FleetConfig) -> None:
    turns = {"do": "repeat", "times": 5, "steps": [{"do": "wait", "duration_s": 2.0}]}
    once, five = (make(fleet, UP, one) for one in (turns["steps"][0], turns))  # type: ignore[index]

    def length_s(mission: Mission) -> float:
        return expected_duration_s(mission.course())

    assert length_s(five) == pytest.approx(length_s(once) + 8.0)


async def test_blocks_are_flown_in_their_order_and_said_with_the_time_left(
    fleet: FleetConfig, client: Any
) -> None:
    lines: list[str] = []
    corners = {"mav0": [-2, -2, 1], "mav1": [0, 2.5, 1], "mav2": [2, -2, 1]}
    branches = [
        [{"do": "move", "vehicles": name, "position_enu_m": corner}]
        for name, corner in corners.items()
    ]
    mission = make(
        fleet,
        UP,
        {"do": "repeat", "times": 2, "steps": [SWAP, TO_RING]},
        {"do": "parallel", "branches": branches},
        {"do": "wait", "until": {"reached": {"mav1": [0, 2.5, 1]}, "separation_above_m": 1.0}},
        {"do": "react", "when": {"flying": "all"}, "steps": [LONG], "then": [{"do": "land"}]},
        expect={"min_separation_m": 0.8, "all_landed": True},
    )
    verdict = await MissionRun(mission, client, say=lines.append).run()
    assert verdict.exit_status == 0, verdict.sentences
    verbs = [step.step.partition(" ")[0] for step in verdict.steps]
    assert verbs == ["takeoff", *["goto", "formation"] * 2, *["move"] * 3, "land"]
    assert next(line for line in lines if line.startswith("[")).startswith("[1/5] takeoff; about ")


async def test_a_condition_that_does_not_come_true_fails_the_step_in_words(
    fleet: FleetConfig, client: Any
) -> None:
    late = {"do": "wait", "until": LOW, "timeout_s": 0.2}
    verdict = await MissionRun(make(fleet, UP, late, {"do": "land"}), client).run()
    assert verdict.exit_status == 1
    assert "below 50 % of battery" in verdict.summary
    assert "Traceback" not in verdict.summary
    assert all(verdict.landed.values())


async def test_a_branch_that_fails_ends_the_others(fleet: FleetConfig, client: Any) -> None:
    late = [{"do": "wait", "until": LOW, "timeout_s": 0.2}]
    both = {"do": "parallel", "branches": [late, [{"do": "wait", "duration_s": 500}]]}
    verdict = await MissionRun(make(fleet, UP, both), client).run()
    assert "below 50 % of battery" in verdict.summary
    assert all(verdict.landed.values())


async def test_a_mission_goes_on_when_nobody_is_left_to_follow_a_path(
    fleet: FleetConfig, client: Any, tmp_path: Path
) -> None:
    (tmp_path / "path.csv").write_text("t,x,y,z\n0,0,1,1\n5,0,2,1\n", encoding="utf-8")
    follow = {"do": "follow_path", "paths": {"mav1": "path.csv"}}
    mission = mission_from_mapping(
        {"schema": 1, "step": [UP, follow, {"do": "land"}], "on_failure": {"do": "go_on"}},
        path=str(tmp_path / "test.toml"),
        fleet=fleet,
    )
    run = MissionRun(mission, client)
    run.fleet.leave_out("mav1")

    verdict = await run.run()
    assert [step.step.partition(" ")[0] for step in verdict.steps] == ["takeoff", "land"]


@pytest.mark.timeout(20)
def test_a_formation_that_is_farther_away_than_numbers_reach_is_refused(
    fleet: FleetConfig,
) -> None:
    with pytest.raises(ConfigError, match="outside the geofence"):
        make(fleet, UP, {**TO_RING, "position_enu_m": [1e200, 0, 1]})


def test_a_take_off_is_judged_from_the_ground_on_which_the_vehicle_has_landed(
    fleet: FleetConfig,
) -> None:
    raised = msgspec.structs.replace(fleet.vehicles["mav1"], start_enu_m=(0.0, -1.5, 0.6))
    hill = msgspec.structs.replace(fleet, vehicles={**fleet.vehicles, "mav1": raised})
    low = {**UP, "height_m": 0.7}
    with pytest.raises(ConfigError, match=r"'step\[0\]' \(takeoff\): mav1: .* leave the ground"):
        make(hill, low)

    beside = {"do": "goto", "goals": {"mav1": [0.0, 1.5, 1.0]}}
    make(hill, UP, beside, {"do": "land"}, low)
    with pytest.raises(ConfigError, match=r"'step\[2\]' .* leave the ground"):
        make(hill, UP, {"do": "land"}, low)


LAND = {"do": "land"}
HOME = {"do": "home"}
PAUSE = {"do": "wait", "duration_s": 5.0}
ONE_MOVE = {"do": "move", "vehicles": "mav0", "position_enu_m": [-1.5, 0.0, 1.0]}


@pytest.mark.parametrize(
    "step",
    [{"do": "rotate", "angle_deg": 90.0}, {"do": "move", "position_enu_m": [0.0, 0.0, 1.0]}],
)
def test_an_order_to_the_present_formation_is_refused_where_there_is_none(
    fleet: FleetConfig, step: dict[str, Any]
) -> None:
    without = msgspec.structs.replace(fleet, formations={})
    with pytest.raises(ConfigError, match=r"step\[1\].* this fleet file has no formation"):
        make(without, UP, step, formations={})
    make(without, UP, TO_RING, step)


@pytest.mark.parametrize("verb", ["home", "bring_home"])
@pytest.mark.parametrize("ground_m", [0.0, -50.0])
def test_the_way_home_is_judged_at_the_height_at_which_the_vehicles_are(
    fleet: FleetConfig, verb: str, ground_m: float
) -> None:
    vehicles = {}
    for name, vehicle in fleet.vehicles.items():
        x, y, _ = vehicle.start_enu_m
        vehicles[name] = msgspec.structs.replace(vehicle, start_enu_m=(x, y, ground_m))
    geofence = msgspec.structs.replace(fleet.fleet.geofence_m, z=(ground_m - 0.1, ground_m + 0.95))
    section = msgspec.structs.replace(fleet.fleet, geofence_m=geofence)
    low = msgspec.structs.replace(fleet, vehicles=vehicles, fleet=section)

    height_m = ground_m + 0.6
    mission = make(low, {"do": "takeoff", "height_m": height_m}, {"do": verb})
    home = list(mission.course())[-1]
    assert home.planned is not None
    for order in home.planned.orders.values():
        assert order.position_enu_m is not None
        assert order.position_enu_m[2] == pytest.approx(height_m)


def test_a_goal_at_a_vehicle_on_the_ground_is_named_before_the_flight(fleet: FleetConfig) -> None:
    at_spot_of_mav0 = {"do": "goto", "goals": {"mav1": [-1.5, -1.2, 1.0]}}
    alone = make(fleet, {**UP, "vehicles": "mav1"}, at_spot_of_mav0)
    (finding,) = [each for each in mission_findings(alone) if each.name == "parked"]
    assert finding.status == "refused"
    assert finding.never_refuses_flights, "mav0 may be absent"
    assert "Step[1] (goto): the goal of mav1 is 0.3 m from mav0" in finding.sentence

    aside = {"do": "goto", "goals": {"mav0": [-1.5, 1.0, 1.0]}}
    findings = mission_findings(make(fleet, UP, aside, at_spot_of_mav0))
    assert "parked" not in {each.name for each in findings}


@pytest.mark.parametrize("verb", ["home", "bring_home"])
def test_a_spot_on_which_another_vehicle_has_landed_is_known_to_the_course(
    fleet: FleetConfig, verb: str
) -> None:
    steps: list[dict[str, Any]] = [
        UP,
        {"do": "goto", "goals": {"mav0": [-1.5, 1.0, 1.0], "mav1": [0.0, 1.0, 1.0]}},
        {"do": "goto", "goals": {"mav0": [0.0, -1.5, 1.0]}},
        {"do": "land", "vehicles": "mav0"},
        {"do": verb, "vehicles": "mav1"},
    ]
    mission = make(fleet, *steps)
    last = list(mission.course())[-1]
    refused = {each.name for each in mission_findings(mission) if each.status == "refused"}
    if verb == "home":
        assert refused == {"parked"}
    else:
        assert refused == set()
        assert last.goals["mav1"][:2] == fleet.vehicles["mav0"].start_enu_m[:2]


def react(steps: list[dict[str, Any]], then: list[dict[str, Any]]) -> dict[str, Any]:
    return {"do": "react", "when": LOW, "steps": steps, "then": then}


@pytest.mark.parametrize(
    ("before", "steps", "then"),
    [
        ([UP], [ONE_MOVE, LONG, LAND], [HOME]),  # the whole rest of the flight
        ([], [UP, ONE_MOVE], [HOME]),  # in the take-off at the earliest
        ([], [{"do": "repeat", "times": 2, "steps": [UP, LAND]}], [{"do": "hold"}]),
        ([UP], [react([LONG], [LAND])], [HOME]),
        ([UP], [LONG, LAND, LONG], [{**UP, "vehicles": "mav0"}, LAND]),
    ],
)
def test_a_reaction_may_begin_before_and_during_each_of_its_steps(
    fleet: FleetConfig,
    before: list[dict[str, Any]],
    steps: list[dict[str, Any]],
    then: list[dict[str, Any]],
) -> None:
    mission = make(fleet, *before, react(steps, then))
    assert not [one for one in mission_findings(mission) if one.name == "reaction"]


@pytest.mark.parametrize(
    ("before", "then", "words"),
    [
        ([UP], [UP], "mav0, mav1, mav2 would fly already at this step"),
        ([UP], [LAND, HOME], "mav0, mav1, mav2 would be on the ground at this step"),
        ([], [HOME], "mav0, mav1, mav2 would be on the ground at this step"),
    ],
)
def test_a_reaction_whose_vehicles_can_carry_it_out_at_no_time_is_refused(
    fleet: FleetConfig, before: list[dict[str, Any]], then: list[dict[str, Any]], words: str
) -> None:
    key = f"'step[{len(before)}].then[{len(then) - 1}]'"
    with pytest.raises(ConfigError) as caught:
        make(fleet, *before, react([PAUSE], then))
    assert key in str(caught.value)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("steps", "then", "after", "words"),
    [
        ([PAUSE], [LAND], ONE_MOVE, "mav0 may be on the ground, and would refuse it"),
        ([PAUSE], [LAND], UP, "mav0, mav1, mav2 may be in the air, and would refuse it"),
        ([PAUSE], [LAND], TURN, "mav0, mav1, mav2 may be on the ground"),
        ([PAUSE, LAND], [{**LAND, "vehicles": "mav1"}], UP, "mav0, mav2 may be in the air"),
        ([PAUSE], [LAND], {"do": "hold"}, "mav0, mav1, mav2 may be on the ground"),
        ([PAUSE], [LAND], {"do": "arm", "vehicles": "mav2"}, "mav2 may be in the air"),
        ([PAUSE], [LAND], LAND, ""),
        ([PAUSE], [{"do": "hold"}], ONE_MOVE, ""),
        ([PAUSE, LAND], [HOME], UP, ""),
        ([PAUSE], [{**LAND, "vehicles": "mav1"}], ONE_MOVE, ""),
    ],
)
def test_a_step_after_a_react_that_fits_only_one_of_its_ends_is_named(
    fleet: FleetConfig,
    steps: list[dict[str, Any]],
    then: list[dict[str, Any]],
    after: dict[str, Any],
    words: str,
) -> None:
    mission = make(fleet, UP, react(steps, then), after)
    found = [one for one in mission_findings(mission) if one.name == "reaction"]
    assert len(found) == bool(words)
    for one in found:
        assert one.status == "warning"
        assert one.sentence.startswith(f"Step[2] ({after['do']}): {words}")
        assert "the reaction of step[1] has come" in one.sentence


def test_a_step_after_a_react_that_fits_neither_of_its_ends_is_refused(fleet: FleetConfig) -> None:
    with pytest.raises(ConfigError, match=r"'step\[2\]' \(takeoff\): .* would fly already"):
        make(fleet, UP, react([PAUSE], [{"do": "hold"}]), UP)
    with pytest.raises(ConfigError, match=r"'step\[2\]' \(move\): mav0 would be on the ground"):
        make(fleet, UP, react([LAND], [HOME]), ONE_MOVE)


HOLD = {"do": "hold", "vehicles": "mav0"}
WATCH = [{"do": "wait", "until": {"flying": "mav0"}}, react([PAUSE], [PAUSE]), HOLD]


@pytest.mark.parametrize("late_land", [[], [PAUSE, LAND, PAUSE]])
def test_a_branch_may_order_vehicles_that_another_branch_takes_off_or_lands(
    fleet: FleetConfig, late_land: list[dict[str, Any]]
) -> None:
    """The branches are flown side by side, so their order in the file says nothing."""
    takes_off = [UP, PAUSE]
    in_three = [WATCH, [UP, *late_land], [PAUSE, HOLD]]
    for branches in ([WATCH, takes_off], [takes_off, WATCH], in_three):
        mission = make(fleet, {"do": "parallel", "branches": branches}, LAND)
        assert not [one for one in mission_findings(mission) if one.name in ("ending", "reaction")]

    watched = make(fleet, UP, {"do": "parallel", "branches": [[PAUSE, LAND], WATCH]})
    assert not [one for one in mission_findings(watched) if one.name == "ending"]


def test_a_branch_is_refused_vehicles_that_no_branch_takes_off(fleet: FleetConfig) -> None:
    up = {**UP, "vehicles": "mav1"}
    with pytest.raises(ConfigError, match=r"branches\[0\]\[2\]' \(hold\): mav0 would be on the"):
        make(fleet, {"do": "parallel", "branches": [WATCH, [up]]}, LAND)

    side_by_side = {"do": "parallel", "branches": [WATCH, [UP]]}
    with pytest.raises(ConfigError, match=r"'step\[1\]' \(takeoff\): .* would fly already"):
        make(fleet, side_by_side, UP)


def test_vehicles_may_be_down_after_a_condition_that_says_so(fleet: FleetConfig) -> None:
    down = {"landed": "mav0"}
    again = {**UP, "vehicles": "mav0"}
    wait = {"do": "wait", "until": down}
    make(fleet, UP, wait, again, LAND)
    make(fleet, UP, wait, TURN, LAND)  # the others may go on without it
    with pytest.raises(ConfigError, match="mav0 would fly already"):
        make(fleet, UP, wait, again, again)

    # one that is down in any case stays down
    hold = {"do": "hold", "vehicles": "mav0"}
    with pytest.raises(ConfigError, match="mav0 would be on the ground"):
        make(fleet, UP, {**LAND, "vehicles": "mav0"}, wait, hold)
    with pytest.raises(ConfigError, match="mav0 would be on the ground"):
        make(fleet, {**UP, "vehicles": "mav1"}, wait, hold)
    all_down = make(fleet, UP, {"do": "wait", "until": {"landed": "all"}})
    assert not [one for one in mission_findings(all_down) if one.name == "ending"]

    reacting_to = {**react([LONG], [PAUSE]), "when": down}
    make(fleet, UP, reacting_to, again, LAND)
    make(fleet, UP, {**reacting_to, "then": [again, TURN]}, LAND)

    with pytest.raises(ConfigError, match=r"'step\[1\].when': .*mav9"):
        make(fleet, UP, {**reacting_to, "when": {"landed": "mav9"}}, LAND)


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ([UP], "The mission ends with mav0, mav1, mav2 in the air, so it cannot pass"),
        ([UP, {"do": "hold"}], "The mission ends with mav0, mav1, mav2 in the air, so it cannot"),
        ([{"do": "arm", "vehicles": "1-2"}], "The mission ends with mav1, mav2 armed, so it may"),
        (
            [UP, react([PAUSE], [LAND])],
            "The mission ends with mav0, mav1, mav2 in the air, depending on whether the reaction "
            "of step[1] has come, so it may not pass",
        ),
        (
            [UP, {"do": "expect", "all_landed": True}, LAND],
            "Step[1] (expect): it expects that all have landed, and is reached with mav0, mav1, "
            "mav2 in the air, so it cannot pass",
        ),
        ([{"do": "arm"}, {"do": "disarm"}], ""),
        ([{"do": "arm"}, UP, LAND], ""),
        ([UP, {"do": "expect", "all_landed": False}, LAND], ""),
        ([UP, react([PAUSE], [LAND]), LAND, {"do": "expect", "all_landed": True}], ""),
    ],
)
def test_vehicles_that_are_not_down_where_they_must_be_are_named(
    fleet: FleetConfig, steps: list[dict[str, Any]], words: str
) -> None:
    def found(**expect: bool) -> list[str]:
        findings = mission_findings(make(fleet, *steps, expect=expect))
        return [one.sentence for one in findings if one.name == "ending"]

    assert len(found()) == bool(words)
    for sentence in found():
        assert sentence.startswith(words)
    if "Step[" not in words:
        assert not found(all_landed=False)


def test_branches_that_order_the_same_vehicle_are_refused_or_named(fleet: FleetConfig) -> None:
    def mission_of(*branches: list[dict[str, Any]]) -> Mission:
        return make(fleet, UP, {"do": "parallel", "branches": list(branches)}, LAND)

    def named(*branches: list[dict[str, Any]]) -> list[str]:
        findings = mission_findings(mission_of(*branches))
        return [one.sentence for one in findings if one.name == "branches"]

    yaw = {"do": "yaw", "yaw_deg": 40.0}
    for branches, names in (
        (([TO_RING], [yaw]), "mav0, mav1, mav2"),
        (([PAUSE], [ONE_MOVE], [TURN]), "mav0"),
        (([ONE_MOVE], [{"do": "repeat", "times": 2, "steps": [ONE_MOVE]}]), "mav0"),
    ):
        with pytest.raises(ConfigError, match=r"'step\[1\]' \(parallel\)") as caught:
            mission_of(*branches)
        assert f"several branches begin with an order to {names}." in str(caught.value)

    others = {**yaw, "vehicles": ["mav1", "mav2"]}
    assert not named([ONE_MOVE, ONE_MOVE], [others, others])
    (sentence,) = named([ONE_MOVE], [PAUSE, yaw], [others])
    assert sentence.startswith("Step[1] (parallel): several branches order mav0, mav1, mav2;")


@pytest.mark.parametrize(
    ("code", "meant"),
    [
        ("batery_low", "battery-low"),
        ("fence_breach", "fence-breach"),
        ("battery-low", ""),
        ("*", ""),
        # of other parts, which no table has
        ("order-move", ""),
        ("ground_stalled", ""),
        ("own-event-of-a-script", ""),
    ],
)
def test_an_event_with_a_misspelt_code_is_named(fleet: FleetConfig, code: str, meant: str) -> None:
    wait = {"do": "wait", "until": {"event": code}}
    mission = make(fleet, UP, {"do": "repeat", "times": 2, "steps": [wait]}, LAND)
    found = [one for one in mission_findings(mission) if one.name == "event"]
    assert len(found) == bool(meant)
    for one in found:
        assert one.status == "warning"
        assert one.sentence.startswith("Step[1].steps[0].until: no row of the failsafe table")
        assert one.remedy == f'Write event = "{meant}".'


def test_vehicles_in_the_air_without_a_path_are_found_and_their_lights_are_refused(
    fleet: FleetConfig, tmp_path: Path
) -> None:
    (tmp_path / "path.csv").write_text("t,x,y,z\n0,0,1,1\n5,0,2,1\n", encoding="utf-8")
    (tmp_path / "lights.csv").write_text("t,red,green,blue\n0,255,0,0\n", encoding="utf-8")
    follow = {"do": "follow_path", "paths": {"mav1": "path.csv"}}

    def mission_of(*steps: dict[str, Any]) -> Mission:
        return mission_from_mapping(
            {"schema": 1, "step": [UP, *steps, {"do": "land"}]},
            path=str(tmp_path / "test.toml"),
            fleet=fleet,
        )

    def pathless(mission: Mission) -> list[str]:
        findings = mission_findings(mission)
        return [found.sentence for found in findings if found.name == "no path"]

    (sentence,) = pathless(mission_of(follow))
    assert sentence.startswith("Step[1] (follow_path): mav0, mav2 will hover on the spot")
    assert not pathless(mission_of({"do": "land", "vehicles": ["mav0", "mav2"]}, follow))
    # what the others do is in another branch
    assert not pathless(mission_of({"do": "parallel", "branches": [[follow], [LONG]]}))

    with pytest.raises(ConfigError, match=r"'step\[1\]\.lights' has mav2, without a path"):
        mission_of({**follow, "lights": {"mav1": "lights.csv", "mav2": "lights.csv"}})
