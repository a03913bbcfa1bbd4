"""An operator's order stays: it ends a mission, and the mission replaces it by nothing."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from groundstation import Fleet
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions.taken import FleetTaken
from onboard.bus.order_answers import order_answer
from onboard.config.fleet import FleetConfig
from sitl.faults.catalogue import Fault
from sitl.lockstep.flight import GROUND
from tests.sitl.lockstep.taking import at_moment, crossing, pilot_takes, second_ground

NAMES = ("mav0", "mav1", "mav2")


def _orders(flight: Any) -> dict[str, list[str]]:
    """Kinds of the orders that each vehicle has taken, by its own word."""
    taken: dict[str, list[str]] = {name: [] for name in NAMES}
    for logged in flight.state.events:
        answer = order_answer(logged.event)
        vehicle = logged.event.vehicle
        if answer is not None and vehicle in taken and "accepted" in answer.words:
            taken[vehicle].append(answer.kind)
    return taken


@pytest.mark.parametrize(
    ("line", "moment"),
    [
        ("hold all", "crossing"),
        pytest.param("hold all", "climb", marks=pytest.mark.long),
        pytest.param("hold all", "hover", marks=pytest.mark.long),
        pytest.param("land mav1", "crossing", marks=pytest.mark.long),
        pytest.param("hold mav1", "hover", marks=pytest.mark.long),
        pytest.param("kill mav1", "crossing", marks=pytest.mark.long),
        pytest.param("land all", "crossing", marks=pytest.mark.long),
    ],
)
def test_an_order_of_another_ground_ends_the_mission_and_stays(
    lockstep: Any, paper: FleetConfig, line: str, moment: str
) -> None:
    flight = lockstep(paper, seed=3)
    ada = second_ground(flight)
    at_moment(flight, moment, lambda: ada.submit_now(line))
    verdict = flight.fly(crossing(paper))
    verb, _, whom = line.partition(" ")
    named = NAMES if whom == "all" else (whom,)

    assert verdict.exit_status == 1
    assert f"ada (ground-2) has ordered {verb} {','.join(named)}" in verdict.summary
    flight.run(20.0)
    for name in named:
        assert _orders(flight)[name][-1] == verb, name
    for name in set(NAMES) - set(named):
        # it has finished its own order, and holds there
        assert _orders(flight)[name][-1] == "move"
        telemetry = flight.state.vehicles[name].telemetry
        assert telemetry.state == "flying"
        assert telemetry.order_kind == ""


@pytest.mark.long
def test_a_hold_just_before_the_start_of_the_paths_lets_nobody_start(
    lockstep: Any, paper: FleetConfig
) -> None:
    steps = [
        {"do": "takeoff", "height_m": 1.0},
        {
            "do": "fly_formation",
            "name": "triangle",
            "position_enu_m": [0.0, 0.0, 1.0],
            "to": [{"position_enu_m": [0.0, 1.2, 1.0], "duration_s": 6.0}],
        },
        {"do": "land"},
    ]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="show.toml", fleet=paper)
    said: list[str] = []
    flight = lockstep(paper, seed=3, say=said.append)
    ada = second_ground(flight)
    before: dict[str, float] = {}

    def hold() -> None:
        ada.submit_now("hold mav1")
        before.update({name: _north_m(flight, name) for name in NAMES})

    def look() -> None:
        path = flight.agents["mav1"].core.flight.path
        if path.show_id and -1.5 < path.time_s < 0.0:
            hold()
        else:
            flight.at(flight.time_s + 0.1, look)

    flight.at(1.0, look)
    verdict = flight.fly(mission)
    assert "ada (ground-2) has ordered hold mav1" in verdict.summary
    called_off = [line for line in said if "nobody starts" in line]
    assert called_off == ["  mav0, mav2 hold, and nobody starts."]
    flight.run(8.0)
    for name in NAMES:
        assert _north_m(flight, name) == pytest.approx(before[name], abs=0.15)
        assert _orders(flight)[name][-1] == "hold"


def _north_m(flight: Any, name: str) -> float:
    return float(flight.state.vehicles[name].telemetry.position_enu_m[1])


@pytest.mark.long
def test_neither_locate_nor_a_hold_that_is_refused_ends_a_mission(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    ada = second_ground(flight)
    at_moment(flight, "crossing", lambda: flight.client.submit_now("locate mav1"))
    at_moment(flight, "landing", lambda: ada.submit_now("hold all"))  # who lands, lands
    assert flight.fly(crossing(paper)).passed


@pytest.mark.long
def test_covey_fly_stays_says_who_has_the_fleet_and_ends_with_its_landing(
    lockstep: Any, paper: FleetConfig
) -> None:
    said: list[str] = []
    flight = lockstep(paper, seed=3, say=said.append)
    ada = second_ground(flight)

    def take() -> None:
        ada.submit_now("hold all")
        flight.at(flight.time_s + 10.0, ada.control.take)
        flight.at(flight.time_s + 15.0, lambda: ada.submit_now("move mav1 0 0.4 1.2"))
        flight.at(flight.time_s + 25.0, lambda: ada.submit_now("land all"))

    at_moment(flight, "crossing", take)
    verdict = flight.fly(crossing(paper), stays=True)
    assert verdict.exit_status == 1
    assert all(verdict.landed.values())
    text = "\n".join(said)
    assert "ada (ground-2) has ordered hold mav0,mav1,mav2" in text
    assert "s after the mission began, and has the fleet." in text
    assert "Ctrl-C lands all" in text
    assert f"{paper.fleet.battery_land_pct:g} %" in text
    assert f"after {paper.fleet.ground_lost_land_s:g} s" in text
    assert "ada (ground-2) has the fleet for 10 s; up: mav0, mav1, mav2." in text
    # it has given control up: the other ground flies
    assert _orders(flight)["mav1"][-2:] == ["move", "land"]


@pytest.mark.long
def test_an_interrupt_beside_a_fleet_that_was_taken_lands_all(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    ada = second_ground(flight)

    def take() -> None:
        ada.submit_now("hold all")
        flight.at(flight.time_s + 5.0, lambda: flight.run_under_way.interrupt())

    at_moment(flight, "crossing", take)
    verdict = flight.fly(crossing(paper), stays=True)
    assert verdict.exit_status == 130
    assert all(verdict.landed.values())
    assert flight.time_s < 60.0


@pytest.mark.long
def test_an_order_that_comes_while_a_failed_mission_lands_stays(
    lockstep: Any, paper: FleetConfig
) -> None:
    """A pilot ends the mission, [on_failure] lands the others, and somebody holds them at once."""
    flight = lockstep(paper, seed=3)
    ada = second_ground(flight)

    def take() -> None:
        pilot_takes(flight)
        ada.submit_now("hold mav0")

    at_moment(flight, "crossing", take)
    flight.fly(crossing(paper))
    flight.run(15.0)
    assert _orders(flight)["mav0"][-1] == "hold"


@pytest.mark.long
def test_control_that_was_taken_ends_the_mission_without_landing(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    ada = second_ground(flight)

    def take() -> None:
        flight.client.control.hand_over()
        ada.control.take()
        flight.at(flight.time_s + 1.5, lambda: ada.submit_now("yaw mav1 30"))

    at_moment(flight, "hover", take)
    verdict = flight.fly(crossing(paper))
    assert verdict.exit_status == 1
    assert "ada (ground-2) has" in verdict.summary
    flight.run(10.0)
    assert _orders(flight)["mav1"][-1] == "move"
    assert _orders(flight)["mav0"][-1] == "move"


@pytest.mark.long
def test_in_the_console_a_persons_hold_ends_the_mission_and_his_move_beside_it_does_not(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    flight.client.has_person = True
    at_moment(flight, "crossing", lambda: flight.client.submit_now("hold all"))
    verdict = flight.fly(crossing(paper))
    assert "has ordered hold" in verdict.summary
    flight.run(5.0)
    assert _orders(flight)["mav0"][-1] == "hold"


@pytest.mark.parametrize(
    ("line", "taken"),
    [
        ("home all", "home mav0,mav1,mav2"),
        ("move mav1 -2 -1.5 1.5", "move mav1"),
        pytest.param("home mav1", "home mav1", marks=pytest.mark.long),
        pytest.param("yaw all 90", "yaw mav0,mav1,mav2", marks=pytest.mark.long),
    ],
)
def test_an_order_of_the_person_here_that_replaces_one_of_the_mission_ends_it_and_stays(
    lockstep: Any, paper: FleetConfig, line: str, taken: str
) -> None:
    flight = lockstep(paper, seed=3)
    flight.client.has_person = True
    given: list[Any] = []
    at_moment(flight, "crossing", lambda: given.append(flight.client.submit_now(line)))
    verdict = flight.fly(crossing(paper))
    assert f"has ordered {taken}: that stays" in verdict.summary

    flight.run(25.0)
    (order,) = given
    assert {result.phase for result in order.results.values()} == {"done"}
    for name in NAMES:
        assert "land" not in _orders(flight)[name]


@pytest.mark.long
def test_an_order_of_the_person_here_that_replaces_nothing_is_flown_beside_the_mission(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    flight.client.has_person = True
    at_moment(flight, "hover", lambda: flight.client.submit_now("yaw mav1 30"))
    assert flight.fly(crossing(paper)).passed


def test_control_that_another_ground_takes_during_a_wait_ends_the_mission_at_once(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    ada = second_ground(flight)

    def take() -> None:
        flight.client.control.hand_over()
        ada.control.take()

    steps = [
        {"do": "takeoff", "height_m": 1.0},
        {"do": "wait", "duration_s": 30.0},
        {"do": "land"},
    ]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="wait.toml", fleet=paper)
    flight.at(flight.time_s + 15.0, take)
    verdict = flight.fly(mission)
    assert "ada (ground-2) has taken control: that stays" in verdict.summary
    assert flight.time_s < 25.0
    assert "land" not in _orders(flight)["mav1"]


@pytest.mark.long
def test_an_order_to_hold_while_a_failed_mission_flies_home_is_followed_by_no_landing(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    flight.client.has_person = True
    wait_in_vain = {"do": "wait", "until": {"reached": {"mav1": [0, 3, 1]}}, "timeout_s": 0.5}
    steps = [
        {"do": "takeoff", "height_m": 1.0},
        {"do": "move", "position_enu_m": [0.0, 1.0, 1.0]},
        wait_in_vain,
    ]
    values = {"schema": 1, "step": steps, "on_failure": {"do": "home"}}
    mission = mission_from_mapping(values, path="home.toml", fleet=paper)

    def look() -> None:
        flies_home = any(step.step.startswith("move") for step in flight.run_under_way.fleet.steps)
        if flies_home and _orders(flight)["mav1"].count("move") == 2:
            flight.client.submit_now("hold all")
        else:
            flight.at(flight.time_s + 0.1, look)

    flight.at(flight.time_s + 8.0, look)
    verdict = flight.fly(mission)
    assert "has ordered hold mav0,mav1,mav2: that stays" in verdict.summary
    flight.run(10.0)
    for name in NAMES:
        assert _orders(flight)[name][-1] == "hold"


@pytest.mark.long
def test_a_script_leaves_a_fleet_that_was_taken_as_it_is(lockstep: Any, paper: FleetConfig) -> None:
    flight = lockstep(paper, seed=3)
    ada = second_ground(flight)

    async def script() -> None:
        async with Fleet.connect("paper", at_end="land") as fleet:
            await fleet.takeoff(1.0)
            ada.submit_now("hold all")
            flight.at(flight.time_s + 12.0, lambda: ada.submit_now("land all"))
            await fleet.formation("triangle", (0.0, 1.0, 1.0))

    with pytest.raises(FleetTaken, match="ada"):
        flight.wait_for(script())
    assert _orders(flight)["mav0"][-2:] == ["hold", "land"]
    assert not flight.state.vehicles["mav0"].is_airborne


def test_a_script_that_ends_at_home_leaves_a_fleet_that_is_taken_on_its_way(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    ada = second_ground(flight)

    async def script() -> None:
        async with Fleet.connect("paper", at_end="home") as fleet:
            await fleet.takeoff(1.0)
            await fleet.move((0.0, 1.5, 1.0))
            flight.at(flight.time_s + 2.0, lambda: ada.submit_now("hold all"))
            flight.at(flight.time_s + 12.0, lambda: ada.submit_now("land all"))

    said: list[str] = []
    flight.say = said.append
    flight.wait_for(script())
    assert "ada (ground-2) has ordered hold mav0,mav1,mav2: that stays" in "\n".join(said)
    for name in NAMES:
        assert _orders(flight)[name][-2:] == ["hold", "land"]


def test_a_mission_is_not_begun_over_a_flying_fleet_and_nobody_lands(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    flight.wait_for(flight.fleet.ready())
    flight.wait_for(flight.fleet.takeoff(1.0))
    verdict = flight.fly(crossing(paper))
    assert verdict.exit_status == 2
    assert "its first order to mav0, mav1, mav2, takeoff, begins on the ground" in verdict.summary
    flight.run(3.0)
    for name in NAMES:
        assert _orders(flight)[name] == ["takeoff"]
        assert flight.state.vehicles[name].is_airborne


@pytest.mark.parametrize(
    "seconds",
    [
        pytest.param(0.0, marks=pytest.mark.long),
        0.2,
        pytest.param(0.4, marks=pytest.mark.long),
    ],
)
def test_disarm_in_the_first_centimetres_lands_at_once(
    lockstep: Any, paper: FleetConfig, seconds: float
) -> None:
    flight = lockstep(paper, seed=3)
    flight.wait_for(flight.fleet.ready())
    order = flight.client.submit_now("takeoff mav1 1.0")

    def height_m() -> float:
        return float(flight.state.vehicles["mav1"].truth.position_enu_m[2])

    while height_m() < 0.005:
        flight.run(0.02)
    flight.run(seconds)
    before_m = height_m()
    sent = flight.client.submit_now("disarm mav1")
    flight.run(0.1)
    highest_m = before_m
    for _ in range(100):
        flight.run(0.1)
        highest_m = max(highest_m, height_m())
    assert order.results["mav1"].phase == "superseded"
    assert sent.results["mav1"].is_done, sent.results
    assert highest_m < before_m + 0.3
    assert not flight.state.vehicles["mav1"].is_armed


@pytest.mark.parametrize("verb", ["move", "land"])
def test_a_step_sent_into_a_silence_does_not_replace_an_order_that_came_in_it(
    lockstep: Any, paper: FleetConfig, verb: str
) -> None:
    flight = lockstep(paper, seed=3)
    ada = second_ground(flight)
    flight.takeoff(1.0)
    flight.fleet.ground.watch.begin()
    begin_s = flight.time_s
    flight.bus.partition([GROUND])
    flight.at(begin_s + 2.5, lambda: ada.submit_now("hold all"))
    flight.at(begin_s + 3.5, flight.bus.heal)

    step = flight.fleet.land() if verb == "land" else flight.fleet.move((0.0, 1.2, 1.2))
    with pytest.raises(FleetTaken, match="ada"):
        flight.wait_for(step)

    flight.run(3.0)
    for name in NAMES:
        assert flight.state.vehicles[name].telemetry.taken_order_kind == "hold", name


@pytest.mark.long
def test_a_vehicle_that_falls_silent_in_a_taken_fleet_is_not_waited_for_beyond_its_battery(
    lockstep: Any, paper: FleetConfig
) -> None:
    hover_s = 40.0
    vehicles = {
        name: replace(vehicle, hover_time_s=hover_s) for name, vehicle in paper.vehicles.items()
    }
    said: list[str] = []
    flight = lockstep(replace(paper, vehicles=vehicles), seed=3, say=said.append)
    ada = second_ground(flight)
    taken_s: list[float] = []

    def take() -> None:
        taken_s.append(flight.time_s)
        ada.submit_now("hold all")
        flight.inject(Fault("agent_dead", "mav1", at_s=flight.time_s + 1.0))
        flight.at(flight.time_s + 5.0, lambda: ada.submit_now("land all"))
        flight.at(flight.time_s + hover_s + 20.0, lambda: flight.run_under_way.interrupt())

    at_moment(flight, "crossing", take)
    verdict = flight.fly(crossing(paper), stays=True)
    assert verdict.exit_status == 1
    assert verdict.landed == {"mav0": True, "mav1": False, "mav2": True}
    assert "ada (ground-2) has the fleet for 30 s; up: mav1." in "\n".join(said)
    assert flight.time_s - taken_s[0] == pytest.approx(hover_s, abs=5.0)


@pytest.mark.parametrize("is_own", [False, True])
def test_a_mission_is_not_begun_with_a_vehicle_that_was_killed_while_it_waited(
    lockstep: Any, paper: FleetConfig, is_own: bool
) -> None:
    flight = lockstep(paper, seed=3)
    killer = second_ground(flight)
    if is_own:
        killer = flight.client
    flight.at(0.6, lambda: killer.submit_now("kill mav1"))

    verdict = flight.fly(crossing(paper))

    assert verdict.exit_status == 2
    assert "crossing.toml was not begun" in verdict.summary
    assert "has killed mav1 while it waited" in verdict.summary
    assert _orders(flight) == {"mav0": [], "mav1": ["kill"], "mav2": []}


@pytest.mark.parametrize("line", ["land all", "hold mav1"])
def test_a_mission_is_not_begun_after_a_persons_order_to_stop_that_nobody_in_the_air_could_take(
    lockstep: Any, paper: FleetConfig, line: str
) -> None:
    flight = lockstep(paper, seed=3)
    flight.client.has_person = True
    flight.at(0.6, lambda: flight.client.submit_now(line))

    verdict = flight.fly(crossing(paper))

    assert verdict.exit_status == 2
    assert "has ordered to land, to hold or to kill here while it waited" in verdict.summary
    assert _orders(flight) == {name: [] for name in NAMES}
