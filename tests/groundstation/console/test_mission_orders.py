"""Missions started, stepped through and ended by written orders."""

from __future__ import annotations

import asyncio
import datetime
import json
from pathlib import Path
from typing import Any

import pytest

from groundstation.mission_files.loading import load_mission
from groundstation.mission_files.names import mission_names
from groundstation.mission_files.wall_time import local_now
from groundstation.missions.mission_orders import MissionOrders
from groundstation.missions.mission_words import are_of_mission
from groundstation.missions.runner import MissionRun
from groundstation.recording.writer import RecordWriter
from groundstation.verdict.final_verdict import final_verdict
from groundstation.verdict.verdict import Verdict
from tests.groundstation.missions.wall_clocks import MovableClock

MISSION = """
schema = 1
fleet = "paper"
[[step]]
do = "takeoff"
[[step]]
do = "formation"
name = "triangle"
position_enu_m = [0.0, 0.0, 1.0]
[[step]]
do = "land"
"""


class Worker:
    """Flies what it is given, one at a time."""

    def __init__(self) -> None:
        self.task: asyncio.Task[Any] | None = None
        self.line: Any = None  # returns the line for the title

    def begin(self, mission: Any, progress: Any) -> bool:
        if self.task is not None and not self.task.done():
            return False
        self.task = asyncio.create_task(mission())
        self.line = progress
        return True


def begun(client: Any, folder: Path, text: str, *words: str) -> tuple[MissionOrders, Worker]:
    """Write a mission and start it."""
    path = folder / "m.toml"
    path.write_text(text, encoding="utf-8")
    worker = Worker()
    orders = MissionOrders(client, worker.begin)
    assert orders.take(["mission", str(path), *words]) == ""
    return orders, worker


def waits_before(verb: str, count: int = 1) -> Any:
    """Return whether so many orders whose words begin so have waited."""

    def has_waited(state: Any) -> bool:
        sentences = [one.event.sentence for one in state.events]
        return sum(told.startswith(f"Waits before: {verb}") for told in sentences) == count

    return has_waited


async def test_a_mission_is_stepped_through_and_judged(
    client: Any, bus: Any, tmp_path: Path
) -> None:
    worker = Worker()
    path = tmp_path / "m.toml"
    path.write_text(MISSION, encoding="utf-8")
    orders = MissionOrders(client, worker.begin)
    assert "No mission flies" in orders.take(["step"])
    assert orders.take(["pause"]).endswith("For the vehicles write: pause all.")
    assert "Which mission" in orders.take(["mission"])
    assert "no such" in orders.take(["mission", str(tmp_path / "none.toml")]).lower()
    assert "only Python" in orders.take(["mission", str(path), "height_m=1"])
    assert orders.take(["mission", str(path), "stepping"]) == ""
    assert "flies already" in orders.take(["mission", str(path)])

    assert await client.wait_for(waits_before("takeoff"), 5.0)
    assert not bus.orders
    assert orders.take(["step"]) == ""
    assert await client.wait_for(waits_before("formation"), 5.0)
    assert {order.kind for _, order in bus.orders} == {"takeoff"}
    orders.take(["continue"])
    assert worker.task is not None
    verdict = await asyncio.wait_for(worker.task, 5.0)
    assert verdict.passed, verdict.summary
    assert [order.kind for name, order in bus.orders if name == "mav0"] == [
        "takeoff",
        "move",
        "land",
    ]


async def test_a_mission_is_paused_and_an_order_of_it_left_out(
    client: Any, bus: Any, tmp_path: Path
) -> None:
    orders, worker = begun(client, tmp_path, MISSION)
    assert "No order of the mission waits" in orders.take(["skip"])
    assert orders.take(["pause"]) == ""
    assert "the present step is still under way" in orders.take(["skip"])

    assert await client.wait_for(waits_before("takeoff"), 5.0)
    assert orders.take(["step"]) == ""
    assert await client.wait_for(waits_before("formation"), 5.0)
    assert orders.take(["skip"]) == ""
    assert worker.task is not None
    verdict = await asyncio.wait_for(worker.task, 5.0)

    assert [order.kind for name, order in bus.orders if name == "mav0"] == ["takeoff", "land"]
    assert verdict.passed, verdict.summary
    assert "The operator left out: formation triangle" in verdict.summary


PARALLEL = """
schema = 1
fleet = "paper"
[[step]]
do = "takeoff"
[[step]]
do = "parallel"
branches = [
  [{do = "goto", goals = {mav0 = [-1.5, 1.0, 1.0]}}],
  [{do = "goto", goals = {mav1 = [0.5, 1.0, 1.0]}}],
]
[[step]]
do = "land"
"""


async def test_orders_of_parallel_steps_wait_one_after_the_other(
    client: Any, bus: Any, tmp_path: Path
) -> None:
    orders, worker = begun(client, tmp_path, PARALLEL, "stepping")

    assert await client.wait_for(waits_before("", 1), 5.0)
    assert orders.take(["step"]) == ""
    assert await client.wait_for(waits_before("", 2), 5.0)
    assert orders.take(["skip"]) == ""
    assert await client.wait_for(waits_before("", 3), 5.0)
    assert orders.take(["continue"]) == ""
    assert worker.task is not None
    verdict = await asyncio.wait_for(worker.task, 5.0)

    assert verdict.passed, verdict.summary
    moved = [name for name, order in bus.orders if order.kind == "move"]
    assert moved == ["mav1"], "the first of the two was skipped, and only that one"


async def test_the_mission_that_a_console_was_started_with_is_paused_as_well(
    client: Any, tmp_path: Path
) -> None:
    path = tmp_path / "m.toml"
    path.write_text(MISSION, encoding="utf-8")
    run = MissionRun(load_mission(path, client.fleet), client)
    orders = MissionOrders(client, Worker().begin, run=run)
    assert orders.take(["pause"]) == ""
    flown = asyncio.create_task(run.run())

    def waits(state: Any) -> bool:
        return any(one.event.sentence.startswith("Waits before") for one in state.events)

    run.fleet.ground.say = lambda line: client.publish_event("info", "mission", line)
    assert await client.wait_for(waits, 5.0)
    assert orders.take(["continue"]) == ""
    assert (await asyncio.wait_for(flown, 5.0)).passed


def test_missions_of_a_folder_and_examples_may_be_meant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "shows").mkdir()
    for name in ("square.toml", "notes.txt", "shows/first.py", "shows/two words.py"):
        (tmp_path / name).write_text("", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert mission_names("sq") == ["square.toml", "square-dance"]
    assert mission_names("shows/") == ["shows/first.py"]
    assert mission_names("nowhere/") == []


async def test_a_mission_that_is_stopped_lands_all(client: Any, bus: Any, tmp_path: Path) -> None:
    worker = Worker()
    path = tmp_path / "m.toml"
    path.write_text(
        MISSION.replace('do = "land"', 'do = "wait"\nduration_s = 600'), encoding="utf-8"
    )
    orders = MissionOrders(client, worker.begin)
    assert orders.take(["mission", str(path)]) == ""
    assert await client.wait_for(lambda state: len(state.airborne_names) == 3, 5.0)
    assert orders.take(["stop"]) == ""
    assert worker.task is not None
    verdict = await asyncio.wait_for(worker.task, 10.0)
    assert verdict.is_interrupted
    assert all(verdict.landed.values())
    assert "No mission flies" in orders.take(["stop"])


async def test_each_mission_is_judged_by_its_own_distances_and_all_stand_in_one_file(
    client: Any, bus: Any, tmp_path: Path
) -> None:
    """The second one's smallest distance is not the first one's, and a failure is kept."""
    record = RecordWriter(tmp_path / "flight")
    record.start()
    client.add_sink(record.put)
    verdicts: list[Verdict] = []

    async def judge(run: MissionRun) -> Verdict:
        end = await asyncio.to_thread(record.end_so_far)
        verdict = final_verdict(
            run.flown(), run.mission.expect, record.folder, end, earlier=tuple(verdicts)
        )
        verdicts.append(verdict)
        return verdict

    worker = Worker()
    orders = MissionOrders(client, worker.begin, judge)
    too_much = "[expect]\nmin_separation_m = 50.0\n"
    for number, expect in enumerate((too_much, "")):
        path = tmp_path / f"m{number}.toml"
        path.write_text(MISSION + expect, encoding="utf-8")
        assert orders.take(["mission", str(path)]) == ""
        assert worker.task is not None
        await asyncio.wait_for(worker.task, 10.0)
    record.stop()

    first, second = verdicts
    assert first.closest is not None
    assert second.closest is not None
    assert second.closest.time_s > first.closest.time_s
    assert (first.passed, second.passed) == (False, True)

    written = json.loads((record.folder / "verdict.json").read_text())
    assert written["passed"] is False
    assert [mission["passed"] for mission in written["missions"]] == [False, True]


def test_a_line_with_vehicles_is_for_them_and_one_word_is_for_the_mission() -> None:
    assert are_of_mission(["skip"])
    assert are_of_mission(["mission", "show.toml"])
    assert not are_of_mission(["skip", "all"])
    assert not are_of_mission(["pause", "mav1"])
    assert not are_of_mission(["land"])


async def test_a_mission_at_a_time_is_shown_first_counted_down_and_stopped(
    client: Any, bus: Any, tmp_path: Path
) -> None:
    path = tmp_path / "m.toml"
    path.write_text(MISSION, encoding="utf-8")
    asked: list[Any] = []
    worker = Worker()
    orders = MissionOrders(client, worker.begin, ask=lambda *both: asked.append(both))
    client.wall_clock = MovableClock(client.now_ns)
    now = local_now(client.wall_clock.wall_ns)
    later = (now + datetime.timedelta(minutes=20)).strftime("%Y-%m-%dT%H:%M:%S")

    assert "At which time?" in orders.take(["mission", str(path), "at"])
    assert "no time of day" in orders.take(["mission", str(path), "at", "noon"])
    ago = (now - datetime.timedelta(minutes=5)).strftime("%Y-%m-%dT%H:%M:%S")
    assert " ago: it is " in orders.take(["mission", str(path), "at", ago])
    assert "No countdown" in orders.stop_countdown()
    assert not asked

    assert orders.take(["mission", str(path), "at", later]) == ""
    question, begin = asked[0]
    shown = "\n".join(question().lines)
    assert "Begins in 20 min" in shown or "Begins in 19 min" in shown
    assert "in 3 steps" in shown
    assert "Same time within" in shown
    assert "mav0, mav1, mav2" in shown
    assert "weakest battery is mav0's, with 90 %" in shown
    assert not question().reasons
    client.wall_clock.ahead["mav1"] = (3.0, 0.01)
    assert "mav1's computer is 3.0 s ahead" in question().reasons[0]
    del client.wall_clock.ahead["mav1"]

    begin()
    assert worker.task is not None
    assert await client.wait_for(lambda _: "stops it" in worker.line(), 5.0)
    assert "nothing is started" in orders.stop_countdown()
    verdict = await asyncio.wait_for(worker.task, 5.0)
    assert "An operator has stopped the countdown" in verdict.summary
    assert not bus.orders
