"""Mission files, the runner on obedient and on disobedient vehicles, and the verdict."""

from __future__ import annotations

import asyncio
import errno
import gc
import itertools
import math
from collections.abc import Callable, Coroutine, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from msgspec.structs import replace

from groundstation.client.client import FleetClient
from groundstation.fleet.touchdown import Touchdown
from groundstation.mission_files.loading import load_mission, mission_from_mapping
from groundstation.mission_files.steps import FormationStep
from groundstation.missions.api import Fleet
from groundstation.missions.conditions import flying
from groundstation.missions.runner import MissionRun
from groundstation.orders.result import Results
from groundstation.recording.writer import RecordWriter
from groundstation.verdict.final_verdict import final_verdict
from groundstation.verdict.observations import collided_vehicles
from groundstation.verdict.verdict import Verdict, describe, judge
from onboard.bus.schema import PreflightReport
from onboard.bus.topics import Topic
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_NO_ANSWER

ROOT = Path(__file__).resolve().parents[3]
HOP: list[dict[str, Any]] = [
    {"do": "takeoff", "height_m": 1.0},
    {"do": "formation", "name": "triangle", "position_enu_m": [0, 1.2, 1.0]},
]
EXPECT = {"min_separation_m": 0.8, "arrived_within_m": 0.15, "all_landed": True}


def make(fleet: FleetConfig, steps: list[dict[str, Any]], **tables: Any) -> Any:
    return mission_from_mapping(
        {"schema": 1, "step": steps, **tables}, path="test.toml", fleet=fleet
    )


@pytest.mark.parametrize(
    "path", sorted((ROOT / "configs/missions").glob("*")), ids=lambda path: path.name
)
def test_every_mission_of_the_repository_is_valid_for_its_fleet_or_for_both_that_are_emulated(
    path: Path,
) -> None:
    for fleet in (None, "sih") if path.stem == "paper" else (None,):
        mission = load_mission(path, fleet)
        assert mission.steps or mission.is_python


@pytest.mark.parametrize(
    ("steps", "tables", "words"),
    [
        ([], {}, "step"),
        ([{"do": "dance"}], {}, "step[0].do"),
        ([{"height_m": 1}], {}, "step[0].do"),
        ([{"do": "takeoff", "hight_m": 1.0}], {}, "step[0].hight_m"),
        ([{"do": "takeoff", "height_m": "high"}], {}, "step[0].height_m"),
        ([{"do": "takeoff", "height_m": 9.0}], {}, "step[0]"),
        ([{"do": "land", "vehicles": ["mav7"]}], {}, "mav7"),
        ([{"do": "land", "timeout_s": -1}], {}, "step[0].timeout_s"),
        ([{"do": "wait"}], {}, "duration_s"),
        ([{"do": "wait", "duration_s": 0.0}], {}, "duration_s above 0"),
        ([{"do": "wait", "duration_s": float("nan")}], {}, "step[0].duration_s"),
        ([{"do": "formation", "name": "star", "position_enu_m": [0, 0, 1]}], {}, "star"),
        ([{"do": "move", "position_enu_m": [3.9, 0, 1]}], {}, "outside the geofence"),
        ([{"do": "move", "position_enu_m": [0, 0]}], {}, "step[0].position_enu_m"),
        (HOP[1:], {}, "on the ground at this step"),
        ([*HOP, {"do": "land", "vehicles": "mav1"}, HOP[1]], {}, "mav1 would be on the ground"),
        ([*HOP, HOP[0]], {}, "would fly already"),
        ([{"do": "fault"}], {}, "vehicles"),
        (HOP, {"expect": {"min_distance_m": 1.0}}, "expect.min_distance_m"),
        (HOP, {"expect": {"min_separation_m": -1.0}}, "expect.min_separation_m"),
        (HOP, {"on_failure": {"do": "panic"}}, "on_failure.do"),
        (HOP, {"speed": 3}, "speed"),
        (HOP, {"schema": 2}, "schema"),
    ],
)
def test_a_wrong_mission_is_refused_with_file_and_key(
    fleet: FleetConfig, steps: list[dict[str, Any]], tables: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        make(fleet, steps, **tables)

    assert str(caught.value).startswith("test.toml")
    assert words in str(caught.value)


def test_python_missions_are_checked_without_being_run(tmp_path: Path, fleet: FleetConfig) -> None:
    for text, words in (
        ("def mission(", "Python"),
        ("x = 1\n", "async def mission"),
        (None, "no such"),
    ):
        path = tmp_path / "m.py"
        if text is None:
            path = tmp_path / "absent.py"
        else:
            path.write_text(text)
        with pytest.raises(ConfigError, match=words):
            load_mission(path, fleet)

    path = tmp_path / "ok.py"
    for expect in ("EXPECT", "EXPECT: dict[str, object]"):
        path.write_text(
            f"{expect} = {{'all_landed': True}}\nraise SystemExit\n"
            "async def mission(fleet):\n    pass\n"
        )
        assert load_mission(path, fleet).expect.all_landed is True


def test_the_papers_paths_cross_so_that_they_collide_without_the_law() -> None:
    """Straight quintics at the speed limit, each vehicle in its own shortest time, as guidance
    flies.
    """
    mission = load_mission(ROOT / "configs/missions/paper.toml")
    fleet = mission.fleet

    step = next(step for step in mission.steps if step.do == "formation")
    assert isinstance(step, FormationStep)
    assert step.position_enu_m is not None
    slots = fleet.formations[step.name]
    centre = np.array(step.position_enu_m)

    tracks = {}
    time_s = np.linspace(0.0, 12.0, 2400)[:, None]

    for name in fleet.enabled_names:
        vehicle = fleet.vehicles[name]
        start = np.array([*vehicle.start_enu_m[:2], 1.0])
        leg = centre + np.array(slots[name]) - start
        length = np.linalg.norm(leg)
        duration_s = max(
            1.875 * length / vehicle.max_speed_m_s,
            np.sqrt(5.77 * length / vehicle.max_acceleration_m_s2),
        )

        s = np.clip(time_s / duration_s, 0.0, 1.0)
        tracks[name] = start + (10 * s**3 - 15 * s**4 + 6 * s**5) * leg

    closest = min(
        np.linalg.norm((tracks[one] - tracks[two])[:, :2], axis=-1).min()
        for one, two in itertools.combinations(tracks, 2)
    )

    assert closest < fleet.fleet.body_diameter_m


async def test_an_obedient_fleet_passes_and_every_step_is_told_per_vehicle(
    fleet: FleetConfig, client: Any
) -> None:
    lines: list[str] = []
    verdict = await MissionRun(
        make(fleet, [*HOP, {"do": "land"}], expect=EXPECT), client, say=lines.append
    ).run()

    assert verdict.exit_status == 0, verdict.sentences
    assert [step.vehicles for step in verdict.steps] == [
        dict.fromkeys(fleet.enabled_names, "done")
    ] * 3

    assert len(verdict.arrivals) == 3
    assert verdict.worst_arrival_m is not None
    assert verdict.worst_arrival_m < 0.15
    assert all(verdict.landed.values())

    assert any("takeoff" in line for line in lines)
    assert verdict.sentences[-1].startswith("PASSED")


async def test_arrival_is_judged_by_truth_and_not_by_what_the_vehicle_says(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    bus.truth_error_m = 0.2
    verdict = await MissionRun(make(fleet, [*HOP, {"do": "land"}], expect=EXPECT), client).run()

    assert verdict.exit_status == 1
    assert [one.name for one in verdict.checks if not one.has_come_true] == ["arrived_within_m"]
    assert verdict.worst_arrival_m == pytest.approx(0.2, abs=0.01)


async def test_arrival_is_judged_when_the_vehicles_own_order_is_done_and_not_when_the_last_one_is(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    bus.misbehave["mav2"] = "late"

    async def push_mav0_away_once_it_has_arrived() -> None:
        goal = None
        while goal is None:
            await asyncio.sleep(0.01)
            moves = [order for name, order in bus.orders if name == "mav0" and order.kind == "move"]
            done = {logged.event.order_id for logged in client.state.events}
            if moves and moves[0].order_id in done:
                goal = moves[0].position_enu_m
        x, y, z = goal
        bus.tell("mav0", position_enu_m=(x + 0.5, y, z))

    push = asyncio.create_task(push_mav0_away_once_it_has_arrived())
    verdict = await MissionRun(make(fleet, [*HOP, {"do": "land"}], expect=EXPECT), client).run()
    await push

    assert verdict.exit_status == 0, verdict.sentences
    assert len(verdict.arrivals) == 3
    assert verdict.worst_arrival_m == pytest.approx(0.0, abs=0.01)


async def _fail_second_order_of_mav1(client: Any, bus: Any) -> None:
    """Let the order after its take-off fail; later ones, as the landing, succeed."""
    assert await client.wait_for(lambda state: len(state.airborne_names) == 3, 5.0)
    bus.misbehave["mav1"] = "fail"
    assert await client.wait_for(
        lambda _: [name for name, _ in bus.orders].count("mav1") == 2,
        5.0,
    )
    await asyncio.sleep(0.1)
    del bus.misbehave["mav1"]


async def test_only_who_has_arrived_counts_for_the_furthest_arrival(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    steps = [
        HOP[0],
        {"do": "wait", "duration_s": 0.5},
        {"do": "goto", "goals": {"mav1": [0.0, 1.0, 1.0]}},
        {"do": "land"},
    ]
    task = asyncio.create_task(MissionRun(make(fleet, steps), client).run())
    await _fail_second_order_of_mav1(client, bus)
    verdict = await asyncio.wait_for(task, 20.0)

    assert [(arrival.vehicle, arrival.is_done) for arrival in verdict.arrivals] == [("mav1", False)]
    assert verdict.worst_arrival_m is None
    assert not [line for line in verdict.sentences if "on arrival" in line]


async def test_a_vehicle_whose_landing_order_fails_is_waited_for_and_ordered_again(
    fleet: FleetConfig, client: Any, bus: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundstation.missions.landing.LAND_AGAIN_S", 0.1)
    run, task = await waiting_in_the_air(fleet, client)

    bus.misbehave["mav2"] = "fail"
    run.interrupt()
    assert await client.wait_for(
        lambda state: (
            [order.kind for name, order in bus.orders if name == "mav2"].count("land") >= 2
        ),
        5.0,
    )

    bus.misbehave.clear()
    verdict = await asyncio.wait_for(task, 5.0)

    assert all(verdict.landed.values())


async def test_a_vehicle_that_fails_ends_the_mission_mixed_and_everybody_lands(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    bus.misbehave["mav1"] = "fail"
    verdict = await MissionRun(make(fleet, HOP), client).run()

    assert verdict.exit_status == 50
    assert "The motor is weak." in verdict.summary

    assert [order.kind for name, order in bus.orders if name == "mav0"] == ["takeoff", "land"]
    assert verdict.landed["mav0"]


async def test_an_expectation_that_fails_is_exit_status_one_with_its_sentence(
    fleet: FleetConfig, client: Any
) -> None:
    mission = make(fleet, [*HOP, {"do": "land"}], expect={"min_separation_m": 3.0})
    verdict = await MissionRun(mission, client).run()

    assert verdict.exit_status == 1
    assert "3.00 m" in verdict.summary


async def test_a_fleet_left_in_the_air_fails_all_landed(fleet: FleetConfig, client: Any) -> None:
    verdict = await MissionRun(make(fleet, HOP, expect={"all_landed": True}), client).run()
    assert verdict.exit_status == 1
    assert not any(verdict.landed.values())


async def test_a_mission_that_leaves_vehicles_in_the_air_has_not_passed_unless_it_declares_so(
    fleet: FleetConfig, client: Any
) -> None:
    verdict = await MissionRun(make(fleet, HOP), client).run()

    assert verdict.exit_status == 1
    assert "mav0, mav1, mav2 are not down. End it with a step 'land'" in verdict.summary

    again = await MissionRun(make(fleet, HOP, expect={"all_landed": False}), client).run()
    assert again.exit_status == 2, "its take-off is refused while they fly"

    assert await MissionRun(make(fleet, HOP), client).fleet.land_all(math.inf)
    declared = await MissionRun(make(fleet, HOP, expect={"all_landed": False}), client).run()
    assert declared.passed, declared.summary


async def test_the_verdict_names_the_law_that_the_agents_flew(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    mission = make(fleet, [*HOP, {"do": "land"}])

    for name in fleet.enabled_names:
        bus.tell(name, law="off")
    verdict = await MissionRun(mission, client).run()

    assert verdict.law == "off"
    assert "with law 'off'" in verdict.summary

    bus.tell("mav1", law="covey")
    assert (await MissionRun(mission, client).run()).law == "off (mav0, mav2), covey (mav1)"


async def test_an_ending_from_outside_is_said_once_and_landing_again_is_not_repeated(
    fleet: FleetConfig, client: Any, bus: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundstation.missions.landing.LAND_AGAIN_S", 0.05)
    monkeypatch.setattr("groundstation.missions.runner.LAND_TIMEOUT_S", 1.0)
    lines: list[str] = []

    client.add_event_listener(
        lambda event: lines.append(event.sentence) if event.severity == "critical" else None
    )

    run = MissionRun(
        make(fleet, [HOP[0], {"do": "wait", "duration_s": 60.0}]), client, say=lines.append
    )
    task = asyncio.create_task(run.run())
    assert await client.wait_for(lambda state: len(state.airborne_names) == 3, 5.0)

    bus.misbehave["mav1"] = "fail"  # as with a PX4 that is dead
    reason = "mav1 was ended by signal 9."
    client.publish_event("critical", "process_ended", reason)
    run.abort(reason)

    verdict = await asyncio.wait_for(task, 10.0)
    assert sum(reason in line for line in lines) == 1, lines
    assert [order.kind for name, order in bus.orders if name == "mav1"].count("land") > 2
    assert lines.count("Landing mav1.") == 1, lines
    assert reason in verdict.summary


async def test_a_recording_ground_passes_on_no_advice_to_record(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    advice = ("record", True, "Nobody records this flight.", "Fly it with covey fly.")
    for name in fleet.enabled_names:
        report = PreflightReport(vehicle=name, boot_id=1, sequence=1, stamp_ns=0, checks=(advice,))
        bus.on_message[Topic.PREFLIGHT](Topic.PREFLIGHT, name, report)

    lines: list[str] = []
    mission = make(fleet, [HOP[0], {"do": "land"}])
    await MissionRun(mission, client, say=lines.append).run()
    assert any("Nobody records" in line for line in lines)

    lines.clear()
    client.announce_recording(True)
    await MissionRun(mission, client, say=lines.append).run()
    assert not any("Nobody records" in line for line in lines), lines


async def test_the_verdict_and_the_record_count_seconds_from_the_same_begin(
    fleet: FleetConfig, client: Any, tmp_path: Path
) -> None:
    writer = RecordWriter(tmp_path)
    writer.start()
    client.add_sink(writer.put)
    await asyncio.sleep(0.5)  # processes start, vehicles get ready

    run = MissionRun(make(fleet, [HOP[0], {"do": "land"}]), client)
    await run.run()
    client.publish_event("info", "mission", "This is the end.")
    writer.stop()

    verdict = final_verdict(run.flown(), run.mission.expect, tmp_path, writer.end)
    by_event = float((tmp_path / "events.txt").read_text().splitlines()[-1].split()[0])

    assert verdict.closest is not None
    assert by_event - verdict.duration_s - 0.5 < verdict.closest.time_s <= by_event
    assert verdict.closest.time_s >= 0.5


def _fail_to_read(_path: Path) -> NoReturn:
    raise OSError(errno.EIO, "Input/output error")


@pytest.mark.parametrize(
    "damage",
    ["none", "removed", "unreadable", "cut", "damaged", "ended early", "slow disk", "no verdict"],
)
async def test_a_flight_without_its_whole_record_or_its_verdict_has_not_passed(
    fleet: FleetConfig,
    client: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    damage: str,
) -> None:
    folder = tmp_path / "flight"
    writer = RecordWriter(folder)
    writer.start()
    client.add_sink(writer.put)
    run = MissionRun(make(fleet, [*HOP, {"do": "land"}], expect=EXPECT), client)
    assert (await run.run()).passed
    writer.stop()

    record = folder / "flight.mcap"
    end = writer.end
    if damage == "removed":
        record.unlink()
    elif damage == "unreadable":
        monkeypatch.setattr(Path, "is_file", _fail_to_read)
    elif damage == "cut":
        record.write_bytes(record.read_bytes()[: record.stat().st_size // 10])
    elif damage == "damaged":
        content = bytearray(record.read_bytes())
        content[len(content) // 10] ^= 1
        record.write_bytes(content)
    elif damage == "ended early":
        end = end._replace(failure="The record ended: disk full.")
    elif damage == "slow disk":
        end = end._replace(dropped=1240)
    elif damage == "no verdict":
        (folder / "verdict.part").mkdir()

    verdict = final_verdict(run.flown(), run.mission.expect, folder, end)
    words = {
        "none": "PASSED",
        "removed": "The record cannot be read.",
        "unreadable": "The record cannot be read (Input/output error).",
        "cut": "The record was cut off",
        "damaged": "messages that were written: the disk has lost the others or cannot read them,"
        f" or something has changed {folder} during the flight.",
        "ended early": "The record ended: disk full.",
        "slow disk": "The record lacks 1240 messages, because the disk was too slow",
        "no verdict": "verdict.json cannot be written",
    }
    assert words[damage] in verdict.summary
    assert verdict.exit_status == (0 if damage == "none" else 1)
    assert (folder / "verdict.json").exists() is (damage != "no verdict")


async def test_a_flight_in_which_nobody_was_heard_fails_for_that_and_not_for_its_empty_record(
    fleet: FleetConfig, bus: Any, tmp_path: Path
) -> None:
    client = FleetClient(fleet, author="tester", bus=bus)  # its vehicles send nothing
    await client.start()
    writer = RecordWriter(tmp_path)
    writer.start()
    client.add_sink(writer.put)
    run = MissionRun(make(fleet, [*HOP, {"do": "land"}]), client, ready_timeout_s=0.1)
    await run.run()
    writer.stop()
    await client.stop()

    assert writer.end.written == 0
    verdict = final_verdict(run.flown(), run.mission.expect, tmp_path, writer.end)
    reason = " ".join(f"{name} does not answer." for name in fleet.enabled_names)
    assert f"Not ready within 0.1 s. {reason} Start the agents" in verdict.summary
    assert "No vehicle was heard, so nothing is known of any." in verdict.sentences
    assert verdict.exit_status == EXIT_NO_ANSWER


async def test_only_those_that_have_touched_each_other_are_said_to_have_collided(
    fleet: FleetConfig, client: Any
) -> None:
    run = MissionRun(make(fleet, [*HOP, {"do": "land"}], expect=EXPECT), client)
    verdict = await run.run()

    assert verdict.closest is not None
    near = [verdict.closest.first, verdict.closest.second]
    third = next(name for name in fleet.enabled_names if name not in near)

    def words(*collided: str) -> str:
        judged = replace(verdict, is_collision=bool(collided), collided=list(collided))
        return "\n".join(describe(judged))

    assert "COLLIDED" not in words().upper()
    assert f"{verdict.closest.distance_m:.2f} m between centres" in words(*near)
    assert "THEY COLLIDED" in words(*near)
    assert "THEY COLLIDED" not in words(near[0], third)
    assert f"Collided: {near[0]}, {third}." in words(near[0], third)


async def test_a_collision_of_an_earlier_mission_does_not_count(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    async def collide(name: str) -> None:
        bus.collided.add(name)
        assert await client.wait_for(lambda state: name in collided_vehicles(state), 5.0)

    await client.wait_for(lambda state: state.is_simulated, 5.0)
    await collide("mav2")
    run = MissionRun(make(fleet, [*HOP, {"do": "land"}], expect=EXPECT), client)
    verdict = await run.run()
    assert verdict.passed
    assert verdict.collided == []

    await collide("mav1")
    flown = run.flown()
    flown.state = client.state
    assert judge(flown, run.mission.expect).collided == ["mav1"]


@pytest.mark.parametrize(("had_thrust", "speed_m_s"), [(True, 0.9), (False, 4.0)])
async def test_a_vehicle_that_hits_the_ground_in_its_landing_has_not_landed_as_ordered(
    fleet: FleetConfig, client: Any, had_thrust: bool, speed_m_s: float
) -> None:
    run = MissionRun(make(fleet, [*HOP, {"do": "land"}], expect=EXPECT), client)
    assert (await run.run()).passed

    hit = Touchdown("mav1", 1, speed_m_s, had_thrust=had_thrust)
    flown = run.flown()
    flown.state = replace(flown.state, touchdowns=(hit,))
    verdict = judge(flown, run.mission.expect)

    assert verdict.exit_status == 1
    assert hit.sentence(fleet.vehicles["mav1"]) in verdict.summary

    # what else has ended the flight of this vehicle does not hide it
    flown.other_ends = {"mav1": "mav1 is down: PX4 silent."}
    words = judge(flown, run.mission.expect).summary
    assert "mav1 is down: PX4 silent." in words
    assert hit.sentence(fleet.vehicles["mav1"]) in words

    flown.left_out = ("mav1",)
    assert judge(flown, run.mission.expect).passed is not had_thrust


async def test_a_hard_landing_before_a_mission_does_not_count_for_it(
    fleet: FleetConfig, client: Any
) -> None:
    client._state = replace(client.state, touchdowns=(Touchdown("mav1", 1, 0.9),))
    verdict = await MissionRun(make(fleet, [*HOP, {"do": "land"}], expect=EXPECT), client).run()

    assert verdict.passed
    assert not verdict.touchdowns


async def test_an_expect_step_stops_the_mission_where_it_fails(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    steps = [HOP[0], {"do": "expect", "min_separation_m": 3.0}, HOP[1]]
    verdict = await MissionRun(make(fleet, steps), client).run()

    assert verdict.exit_status == 1
    assert "move" not in {order.kind for _, order in bus.orders}
    assert all(verdict.landed.values())


async def waiting_in_the_air(
    fleet: FleetConfig, client: Any
) -> tuple[MissionRun, asyncio.Task[Verdict]]:
    """Begin a mission that waits for a minute in the air, and return it once all fly."""
    run = MissionRun(make(fleet, [HOP[0], {"do": "wait", "duration_s": 60.0}]), client)
    task = asyncio.create_task(run.run())
    assert await client.wait_for(lambda state: len(state.airborne_names) == 3, 5.0)
    return run, task


async def test_an_interruption_lands_everybody_and_says_so(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    run, task = await waiting_in_the_air(fleet, client)

    run.interrupt()
    verdict = await asyncio.wait_for(task, 5.0)

    assert verdict.exit_status == 130
    assert all(verdict.landed.values())
    assert [order.kind for name, order in bus.orders if name == "mav2"] == ["takeoff", "land"]


async def test_an_interruption_orders_no_landing_that_the_console_has_just_ordered(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    run, task = await waiting_in_the_air(fleet, client)

    bus.accept_only = {"land"}
    run.interrupt()
    order = client.submit_now("land all")
    await asyncio.sleep(0.02)
    for name in fleet.enabled_names:
        bus.tell(name, state="landing")
    await asyncio.sleep(0.02)
    for name in fleet.enabled_names:
        bus.tell(name, state="landed", is_airborne=False, is_armed=False)
    verdict = await asyncio.wait_for(task, 5.0)

    assert all(verdict.landed.values())
    assert {result.phase for result in order.results.values()} == {"accepted"}
    assert [order.kind for name, order in bus.orders if name == "mav2"] == ["takeoff", "land"]


async def test_an_interruption_just_after_the_order_to_take_off_ends_when_nothing_starts_any_more(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    run = MissionRun(make(fleet, HOP), client)

    task = asyncio.create_task(run.run())
    assert await client.wait_for(
        lambda _: any(order.kind == "takeoff" for _, order in bus.orders), 5.0
    )

    run.interrupt()  # no telemetry has shown the take-off yet
    verdict = await asyncio.wait_for(task, 5.0)

    assert verdict.exit_status == 130
    for name in fleet.enabled_names:
        assert [order.kind for ordered, order in bus.orders if ordered == name] == [
            "takeoff",
            "land",
        ], name
    assert not client.state.airborne_names


async def test_cancelling_the_run_lands_too(fleet: FleetConfig, client: Any) -> None:
    task = asyncio.create_task(
        MissionRun(make(fleet, [HOP[0], {"do": "wait", "duration_s": 60.0}]), client).run()
    )
    assert await client.wait_for(lambda state: len(state.airborne_names) == 3, 5.0)

    task.cancel()
    verdict = await asyncio.wait_for(task, 5.0)

    assert verdict.exit_status == 130
    assert not client.state.airborne_names


async def test_nobody_answering_is_exit_status_ten_with_names(fleet: FleetConfig, bus: Any) -> None:
    client = FleetClient(fleet, bus=bus)
    await client.start()

    verdict = await MissionRun(make(fleet, HOP), client, ready_timeout_s=0.1).run()
    await client.stop()

    assert verdict.exit_status == 10
    assert "mav1 does not answer" in verdict.summary


async def test_a_vehicle_that_is_not_ready_says_its_reason(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    bus.tell("mav1", state="waiting", not_ready=("no motion capture",))
    verdict = await MissionRun(make(fleet, HOP), client, ready_timeout_s=0.2).run()
    assert verdict.exit_status == 1
    assert "mav1 is waiting: no motion capture" in verdict.summary
    assert not bus.orders


async def test_a_mistake_in_a_python_mission_still_lands_everybody(
    fleet: FleetConfig, client: Any, tmp_path: Path
) -> None:
    path = tmp_path / "wrong.py"
    path.write_text(
        "async def mission(fleet):\n    await fleet.takeoff()\n    fleet.fly_to_the_moon()\n"
    )
    verdict = await MissionRun(load_mission(path, fleet), client).run()
    assert verdict.exit_status == 1
    assert f"{path}, line 3: AttributeError: " in verdict.summary
    assert "fly_to_the_moon" in verdict.summary
    assert "Traceback" not in verdict.summary
    assert all(verdict.landed.values())


async def test_an_error_of_steps_that_were_stopped_is_not_printed(
    fleet: FleetConfig, client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundstation.missions.runner._CANCEL_AGAIN_S", 0.01)
    printed: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: printed.append(context))
    path = tmp_path / "stopped.py"
    path.write_text(
        "import asyncio\n"
        "async def mission(fleet):\n"
        "    try:\n"
        "        await fleet.wait(60.0)\n"
        "    except asyncio.CancelledError:\n"
        "        raise ValueError('no') from None\n"
    )
    run = MissionRun(load_mission(path, fleet), client)
    flight = asyncio.create_task(run.run())
    await asyncio.sleep(0.1)
    run.abort("It was stopped.")
    verdict = await asyncio.wait_for(flight, 10.0)
    assert "It was stopped." in verdict.summary

    await asyncio.sleep(0.1)  # until nothing is to be cancelled again
    del run, flight
    gc.collect()
    assert not printed


@pytest.mark.parametrize(
    ("calls", "words"),
    [
        (["fleet['mav0'].hold()", "fleet['mav1'].hold()"], "'hold mav1' failed. mav1 refused: "),
        (["fleet['mav1'].hold()", "fleet['mav1'].yaw(9.0)"], "'hold mav1' failed. mav1 refused: "),
        (["fleet.wait(float('nan'))"], "wait: nan is no duration."),
        (["fly(fleet)"], "line 10: AttributeError: "),
    ],
)
async def test_a_failure_in_a_task_of_a_python_mission_is_said_as_outside_of_it(
    fleet: FleetConfig,
    client: Any,
    bus: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    calls: Sequence[str],
    words: str,
) -> None:
    monkeypatch.setattr("groundstation.missions.runner.LAND_TIMEOUT_S", 1.0)  # mav1 refuses to land
    lines = [
        "import asyncio",
        "async def mission(fleet):",
        "    await fleet.takeoff()",
        "    async with asyncio.TaskGroup() as tasks:",
        *(f"        tasks.create_task({call})" for call in calls),
        "    await fleet.home()",
        "",
        "",
        "async def fly(fleet):",
        "    fleet.fly_to_the_moon()",
        "",
    ]
    path = tmp_path / "tasks.py"
    path.write_text("\n".join(lines))

    def say(line: str) -> None:
        if "done in" in line:
            bus.misbehave["mav1"] = "refuse"

    verdict = await MissionRun(load_mission(path, fleet), client, say=say).run()
    assert words in verdict.summary
    assert "Traceback" not in verdict.summary


@pytest.mark.parametrize("duration_s", ["nan", "inf"])
async def test_a_python_mission_that_waits_for_no_time_fails_in_words(
    fleet: FleetConfig, client: Any, tmp_path: Path, duration_s: str
) -> None:
    path = tmp_path / "endless.py"
    path.write_text(f"async def mission(fleet):\n    await fleet.wait(float('{duration_s}'))\n")

    verdict = await MissionRun(load_mission(path, fleet), client).run()
    assert verdict.exit_status == 1
    assert f"{path}, line 2: wait: {duration_s} is no duration." in verdict.summary


@pytest.mark.parametrize(
    "order",
    [
        lambda flown: flown.takeoff("1.2"),
        lambda flown: flown.takeoff(1.0, by=2.5),
        lambda flown: flown.formation("triangle", rotation_deg=math.inf),
        lambda flown: flown.move((1.0, 2.0), "mav0"),
    ],
)
async def test_an_order_with_a_value_that_makes_no_sense_is_refused_in_words_and_not_sent(
    client: Any, bus: Any, order: Callable[[Fleet], Coroutine[Any, Any, Results]]
) -> None:
    with pytest.raises(ConfigError, match=r"it must be|is not finite"):
        await order(Fleet(client))
    assert not bus.orders


@pytest.mark.parametrize(
    "call",
    [
        lambda flown: flown.takeoff(1.0, timeout_s=math.nan),
        lambda flown: flown.takeoff(1.0, timeout_s="40"),
        lambda flown: flown.follow_path({}, timeout_s=math.nan),
        lambda flown: flown.ready(math.nan),
        lambda flown: flown.until(flying(), "40"),
        lambda flown: flown.land_all(math.nan),
        lambda flown: flown["mav0"].reached((0.0, 0.0, 1.0), timeout_s="40"),
        lambda flown: flown.wait("3"),
        lambda flown: flown.follow("mav0", "3"),
    ],
)
async def test_a_time_that_is_no_number_is_refused_in_words_and_nothing_is_sent(
    client: Any, bus: Any, call: Callable[[Fleet], Coroutine[Any, Any, object]]
) -> None:
    with pytest.raises(ConfigError, match=r": ('40'|nan|'3') is no (timeout|duration)\. Give"):
        await asyncio.wait_for(call(Fleet(client)), 2.0)
    assert not bus.orders


async def test_a_python_mission_uses_the_same_orders(
    fleet: FleetConfig, client: Any, bus: Any, tmp_path: Path
) -> None:
    path = tmp_path / "hop.py"
    path.write_text(
        "EXPECT = {'all_landed': True, 'arrived_within_m': 0.15}\n"
        "async def mission(fleet):\n"
        "    await fleet.takeoff(height_m=1.2)\n"
        "    await fleet['mav1'].move((0.0, -0.5, 1.2))\n"
        "    assert await fleet['mav1'].reached((0.0, -0.5, 1.2), timeout_s=1.0)\n"
        "    await fleet.formation('triangle', (0.0, 1.2, 1.0))\n"
        "    await fleet.land()\n"
    )
    verdict = await MissionRun(load_mission(path, fleet), client).run()
    assert verdict.exit_status == 0, verdict.sentences
    assert ("mav1", (0.0, -0.5, 1.2)) in [
        (name, order.position_enu_m) for name, order in bus.orders
    ]


def test_who_names_a_mission_that_is_not_there_is_shown_a_mission(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"the name of an example: .*paper"):
        load_mission(tmp_path / "absent.toml")


def test_the_examples_are_known_by_name_and_by_their_path_in_the_repository(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("paper", "configs/missions/paper.toml"):
        assert load_mission(name).fleet.fleet.name == "paper"
    (tmp_path / "mine.py").write_text("FLEET = 'sih'\nasync def mission(fleet):\n    pass\n")
    assert load_mission("mine.py").fleet.fleet.name == "sih"


def test_a_fleet_file_given_as_a_mission_and_a_mission_as_a_fleet_are_refused_with_a_command() -> (
    None
):
    with pytest.raises(ConfigError, match=r"is a fleet file.*covey fly MISSION --fleet"):
        load_mission(ROOT / "configs/fleets/paper.toml")
    with pytest.raises(ConfigError, match=r"is a mission file.*covey fly"):
        load_fleet(ROOT / "configs/missions/paper.toml")


async def test_a_mission_that_has_not_begun_lands_nobody_when_it_is_ended_from_outside(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    """Somebody else's vehicles fly, and one of them falls silent, while this mission waits."""
    for name in fleet.enabled_names:
        bus.tell(name, state="flying", is_airborne=True, is_armed=True, not_ready=("It flies.",))
    run = MissionRun(make(fleet, [HOP[0], {"do": "land"}]), client)
    task = asyncio.create_task(run.run())
    assert await client.wait_for(lambda state: len(state.airborne_names) == 3, 5.0)
    await asyncio.sleep(0.2)

    run.abort("Nothing heard from mav1.")
    verdict = await asyncio.wait_for(task, 10.0)
    assert bus.orders == []
    assert not verdict.passed
    assert "Nothing heard from mav1." in verdict.summary


async def test_ctrl_c_in_the_landing_after_an_end_from_outside_is_a_persons_landing(
    fleet: FleetConfig, client: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, task = await waiting_in_the_air(fleet, client)

    by_person: list[bool] = []
    land_all = run.fleet.land_all

    async def landing(timeout_s: float, *, is_by_person: bool = False) -> bool:
        by_person.append(is_by_person)
        if not is_by_person:
            await asyncio.sleep(60.0)  # the mission's own landing waits for a link
        return await land_all(timeout_s, is_by_person=is_by_person)

    monkeypatch.setattr(run.fleet, "land_all", landing)
    run.abort("The emulator ended.")
    await asyncio.sleep(0.1)
    run.interrupt()
    verdict = await asyncio.wait_for(task, 10.0)
    assert by_person == [False, True]
    assert verdict.exit_status == 130
    assert not client.state.airborne_names


async def test_a_mission_that_an_order_to_land_has_ended_is_judged_when_all_are_down(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    client.has_person = True
    steps = [HOP[0], {"do": "wait", "duration_s": 60.0}]
    run = MissionRun(make(fleet, steps, expect={"all_landed": True}), client)
    task = asyncio.create_task(run.run())
    assert await client.wait_for(lambda state: len(state.airborne_names) == 3, 5.0)

    bus.accept_only = {"land"}
    order = client.submit_now("land all")
    for name in fleet.enabled_names:  # each reports the order by itself
        bus.tell(
            name,
            state="landing",
            taken_order_id=order.results[name].order_id,
            taken_order_kind="land",
            taken_order_from="tester (ground-test)",
        )
        run.check()
        await asyncio.sleep(0.02)
    assert not (await asyncio.wait({task}, timeout=0.1))[0]

    for name in fleet.enabled_names:
        bus.tell(name, state="landed", is_airborne=False, is_armed=False)
    verdict = await asyncio.wait_for(task, 5.0)
    assert verdict.exit_status == 1
    assert all(verdict.landed.values())
    assert "Landed and disarmed: all." in [check.sentence for check in verdict.checks]
    assert "tester (ground-test) has ordered land mav0,mav1,mav2: that stays" in verdict.summary


async def test_a_mission_that_is_not_flown_changes_no_formation(
    fleet: FleetConfig, client: Any
) -> None:
    ring = {"ring": {"shape": "circle"}}
    MissionRun(make(fleet, [HOP[0], {"do": "land"}], formations=ring), client)
    assert "ring" not in client.fleet.shapes


async def test_a_mission_begins_with_the_first_formation_of_the_fleet(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    begins_with = client._held
    await client.order("takeoff all 1.0", 5.0)
    await client.order("formation triangle 0 0 1 turned 90", 5.0)
    await client.order("land all", 5.0)
    assert client._held != begins_with

    verdict = await MissionRun(make(fleet, [HOP[0], {"do": "land"}]), client).run()
    assert verdict.passed, verdict.summary
    assert client._held == begins_with


async def test_others_go_on_without_a_vehicle_whose_own_step_fails(
    fleet: FleetConfig, client: Any, bus: Any
) -> None:
    steps = [
        HOP[0],
        {"do": "wait", "duration_s": 0.5},
        {"do": "yaw", "vehicles": "mav1", "yaw_deg": 90.0},
        {"do": "goto", "goals": {"mav0": [-1.5, 1.0, 1.0]}},
        {"do": "land"},
    ]
    mission = make(fleet, steps, on_failure={"do": "go_on"})
    task = asyncio.create_task(MissionRun(mission, client).run())
    await _fail_second_order_of_mav1(client, bus)
    verdict = await asyncio.wait_for(task, 20.0)
    kinds = [order.kind for name, order in bus.orders if name == "mav0"]
    assert kinds == ["takeoff", "move", "land"], verdict.summary
