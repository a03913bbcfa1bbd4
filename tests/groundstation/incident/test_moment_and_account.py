"""What an incident is about, and what the record says of the seconds before it."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import msgspec
import pytest

from groundstation.cli import main
from groundstation.incident.account import account_of
from groundstation.incident.moment import Moment, find_moment, vehicles_of
from groundstation.recording.replay import open_flight
from groundstation.recording.timeline import Timeline
from groundstation.recording.writer import RecordFiles
from onboard.bus.schema import Event, Severity, Truth
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from tests.groundstation.recorded import FLEET, LEVEL, SECOND, ZERO, record, tick

_MISSION = """\
schema = 1
fleet = "paper"

[[step]]
do = "takeoff"
height_m = 1.0

[[step]]
do = "move"
vehicles = "mav0"
position_enu_m = [1.5, 0.0, 1.0]

[[step]]
do = "land"

[expect]
min_separation_m = 0.8
"""


def test_the_fleet_file_of_a_record_without_one_is_given_as_the_refusal_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = record(tmp_path / "flight", 4.0)
    (folder / "fleet.toml").unlink()

    assert main(["incident", str(folder), "--quick"]) == 2
    assert "Give the fleet file with --fleet." in capsys.readouterr().err
    assert main(["incident", str(folder), "--quick", "--fleet", str(FLEET)]) == 0
    assert "The 5 s before it" in capsys.readouterr().out


def test_the_account_says_how_hard_a_vehicle_fell_also_of_an_older_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = record(tmp_path / "flight", 4.0)
    fall = {
        "vehicle": "mav1",
        "time_s": 14.6,
        "speed_m_s": 4.938,
        "limit_m_s": 1.6,
        "had_thrust": False,
    }
    verdict = {"passed": False, "summary": "FAILED: PX4 rebooted.", "touchdowns": [fall]}
    (folder / "verdict.json").write_text(json.dumps(verdict))

    assert main(["incident", str(folder), "--quick"]) == 0
    told = capsys.readouterr().out
    assert told.startswith(
        "FAILED: PX4 rebooted.\nFell: mav1, and hit the ground with 4.9 m/s, at 14.6 s.\n"
    )


def test_a_promise_is_kept_only_as_far_as_a_record_goes_that_ends_in_the_air(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = record(tmp_path / "flight", 4.0)

    assert main(["incident", str(folder), "--quick"]) == 0
    told = capsys.readouterr().out
    assert told.startswith("There is no verdict")
    assert "The promise of 0.80 m was kept as far as the record goes: nearest were" in told
    assert "The record ends with 3 vehicles in the air." in told


@pytest.fixture(scope="module")
def too_near(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a flight in which mav0 passes mav1 too near, since nobody avoids."""
    folder = tmp_path_factory.mktemp("too_near")
    mission = folder / "past_mav1.toml"
    mission.write_text(_MISSION)
    words = ["fly", str(mission), "--lockstep", "--law", "off", "--record", str(folder / "flight")]
    assert main(words) == 1
    return folder / "flight"


@pytest.mark.long
def test_the_moment_is_the_smallest_distance_where_the_promise_was_broken(too_near: Path) -> None:
    fleet, timeline = open_flight(too_near, None)
    with contextlib.closing(timeline):
        moment = find_moment(too_near, fleet, timeline)
    assert moment.kind == "distance"
    assert moment.vehicles == ("mav0", "mav1")
    assert "0.80 m were promised" in moment.sentence


@pytest.mark.long
def test_the_account_says_what_each_knew_of_the_other_and_whose_law_acted(too_near: Path) -> None:
    fleet, timeline = open_flight(too_near, None)
    with contextlib.closing(timeline):
        moment = find_moment(too_near, fleet, timeline)
        account = account_of(timeline, fleet, moment, 5.0)
    facts = "\n".join(account.facts)
    assert "mav0: it took mav1 to be" in facts
    assert "mav0: its law let the thrust of the trajectory pass unchanged." in facts
    told = "\n".join(line.sentence for line in account.lines)
    assert "mav0: notices 'separation breached'" in told
    assert "mav0: is ordered: move of" in told


@pytest.mark.long
def test_the_cause_is_named_with_the_distance_that_would_have_been_kept(
    too_near: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["incident", str(too_near)]) == 0
    told = capsys.readouterr().out
    assert told.startswith("FAILED: ")
    assert "1. The flight would have passed with Covey's law in place of 'off'" in told


@pytest.fixture
def said_to_have_failed(tmp_path: Path) -> Path:
    """The folder of a flight in wind, in which nobody takes off, and whose record has failed."""
    mission = tmp_path / "idle.py"
    mission.write_text('FLEET = "paper"\n\n\nasync def mission(fleet):\n    pass\n')
    folder = tmp_path / "flight"
    words = ["fly", str(mission), "--lockstep", "--wind-m-s", "1,0", "--record", str(folder)]
    assert main(words) == 0
    verdict = folder / "verdict.json"
    verdict.write_text(verdict.read_text().replace('"passed": true', '"passed": false'))
    return folder


def test_a_flight_that_passes_unchanged_has_no_cause(
    said_to_have_failed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["incident", str(said_to_have_failed)]) == 0
    told = capsys.readouterr().out
    assert "Flying it again unchanged: no two vehicles were in the air\n" in told
    assert "Unchanged it passes, so no change can show a cause." in told
    assert "calm air" not in told


def test_ctrl_c_ends_the_flights_that_explain_an_incident(
    said_to_have_failed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    interrupted = """\
import asyncio
import signal


async def mission(fleet):
    signal.raise_signal(signal.SIGINT)
    await asyncio.sleep(1.0)
"""
    (said_to_have_failed / "mission.py").write_text(interrupted)
    capsys.readouterr()
    assert main(["incident", str(said_to_have_failed)]) == 130
    assert "with one thing changed" not in capsys.readouterr().out


@pytest.mark.long
def test_a_flight_that_passed_is_not_flown_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mission = tmp_path / "past_mav1.toml"
    mission.write_text(_MISSION)
    folder = tmp_path / "flight"
    assert main(["fly", str(mission), "--lockstep", "--record", str(folder)]) == 0
    capsys.readouterr()

    assert main(["incident", str(folder)]) == 0
    told = capsys.readouterr().out
    assert told.startswith("PASSED: ")
    assert "The promise of 0.80 m was kept" in told
    assert "The flight passed, so it is not flown again" in told
    assert "did not pass" not in told


@pytest.mark.long
def test_a_record_of_another_kind_of_flight_gets_its_account_only(
    too_near: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("flight.mcap", "fleet.toml", "mission.toml"):
        (tmp_path / name).write_bytes((too_near / name).read_bytes())
    assert main(["incident", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "0.80 m were promised" in told
    assert "It cannot be flown again with one thing changed." in told


@pytest.mark.parametrize(
    ("vertical_separation_m", "separation"),
    [(None, "0.79 m"), (0.4, "1.60 m")],  # with a share, 0.8 m of height count as 1.60 m
)
def test_the_true_distance_is_a_separation_like_the_one_that_the_vehicle_knew(
    tmp_path: Path, fleet: FleetConfig, vertical_separation_m: float | None, separation: str
) -> None:
    section = msgspec.structs.replace(fleet.fleet, vertical_separation_m=vertical_separation_m)
    fleet = msgspec.structs.replace(fleet, fleet=section)
    now_ns = 5 * SECOND
    files = RecordFiles(
        tmp_path, (tmp_path / "flight.mcap").open("wb"), begin_ns=now_ns, begin="a test"
    )
    places_enu_m = {"mav0": (0.0, 0.0, 1.0), "mav1": (0.79, 0.0, 1.8)}
    for name, position_enu_m in places_enu_m.items():
        truth = Truth(
            vehicle=name,
            stamp_ns=now_ns,
            position_enu_m=position_enu_m,
            velocity_enu_m_s=ZERO,
            quaternion_enu_flu_wxyz=LEVEL,
            is_on_ground=False,
            is_collided=False,
        )
        files.write(Topic.TRUTH, name, truth, now_ns)
    files.write(Topic.TICK, "mav0", tick(now_ns), now_ns)
    files.finish()
    files.close()

    moment = Moment(kind="distance", stamp_ns=now_ns, vehicles=("mav0", "mav1"), sentence="")
    with contextlib.closing(Timeline(tmp_path)) as timeline:
        account = account_of(timeline, fleet, moment, 5.0)
    assert account.facts[0] == (
        f"mav0: it took mav1 to be 1.10 m away ({separation} in truth), by a state 20 ms old."
    )


def _said(vehicle: str, at_ns: int, severity: Severity, sentence: str) -> Event:
    return Event(vehicle=vehicle, stamp_ns=at_ns, severity=severity, code="x", sentence=sentence)


SILENT_NS = 8 * SECOND  # the last tick of mav1
_NEIGHBOUR = "Neighbour silent (mav1): going on."
_GROUND = "Nothing heard from mav1 for 2 s in flight: the agent hangs or is cut off."
_REPEATED = "mav1's agent did not answer within 0.3 s: land is sent again."


@pytest.fixture
def with_a_silent_agent(tmp_path: Path) -> Path:
    """The folder of a flight in which the agent of mav1 says nothing from SILENT_NS on."""
    begin_ns = 5 * SECOND
    (tmp_path / "fleet.toml").write_bytes(FLEET.read_bytes())
    files = RecordFiles(
        tmp_path, (tmp_path / "flight.mcap").open("wb"), begin_ns=begin_ns, begin="a test"
    )
    for at_ns in range(begin_ns, 12 * SECOND, SECOND // 10):
        files.write(Topic.TICK, "mav0", tick(at_ns), at_ns)
        if at_ns <= SILENT_NS:
            own_tick = msgspec.structs.replace(
                tick(at_ns),
                position_enu_m=(1.0, -2.0, 1.5),
                neighbour_distances_m={"mav2": 3.0, "mav0": 1.1},
            )
            files.write(Topic.TICK, "mav1", own_tick, at_ns)
    events = [
        _said("mav0", SILENT_NS + SECOND // 4, "warning", _NEIGHBOUR),
        _said("mav2", SILENT_NS + SECOND // 2, "warning", "Battery low: going on."),
        _said("ground", SILENT_NS + SECOND, "critical", "The record cannot be written: full."),
        _said("ground", SILENT_NS + 2 * SECOND, "critical", _GROUND),
        _said("mav1", SILENT_NS + 3 * SECOND, "warning", _REPEATED),
    ]
    for event in events:
        files.write(Topic.EVENT, event.vehicle, event, event.stamp_ns)
    files.finish()
    files.close()
    return tmp_path


def test_the_account_of_a_silent_vehicle_is_about_it_and_says_where_it_was_last_heard(
    with_a_silent_agent: Path,
) -> None:
    fleet, timeline = open_flight(with_a_silent_agent, None)
    with contextlib.closing(timeline):
        moment = find_moment(with_a_silent_agent, fleet, timeline)
        account = account_of(timeline, fleet, moment, 5.0)

    assert moment.stamp_ns == SILENT_NS + 2 * SECOND
    assert moment.vehicles == ("mav1",)
    assert moment.sentence == f"the ground said: {_GROUND}"
    assert account.facts == (
        "mav1: its agent was last heard at 3.00 s, at (1.00, -2.00, 1.50) m,"
        " 1.10 m from mav0, the nearest.",
    )
    told = [line.sentence for line in account.lines if "law begins" not in line.sentence]
    assert told == [
        f"mav0: {_NEIGHBOUR}",
        "ground: The record cannot be written: full.",
        f"ground: {_GROUND}",
        f"mav1: {_REPEATED}",
    ]


@pytest.mark.parametrize(
    ("speaker", "sentence", "vehicles"),
    [
        ("mav0", _NEIGHBOUR, ("mav0", "mav1")),
        ("mav0", "Neighbour silent (mav10): going on.", ("mav0",)),
        ("mav1", _REPEATED, ("mav1",)),
        ("ground", "Nothing heard from mav2, mav0 for 2 s.", ("mav0", "mav2")),
        ("ground", "The record cannot be written: full.", ()),
    ],
)
def test_an_event_is_about_who_says_it_and_whom_it_names(
    fleet: FleetConfig, speaker: str, sentence: str, vehicles: tuple[str, ...]
) -> None:
    assert vehicles_of(_said(speaker, 0, "warning", sentence), fleet) == vehicles


@pytest.mark.parametrize(
    ("speaker", "sentence", "vehicles"),
    [
        ("1", "Its position is lost for 3 s.", ("1",)),
        ("1", "A wind of 3.6 m/s.", ("1",)),
        ("ground", "The disk has 2 GB left.", ()),
        ("ground", "2 messages were refused.", ()),
        ("ground", "Nothing heard from 3, 1 for 2 s in flight: the agent hangs.", ("1", "3")),
        ("ground", "Nothing heard from 3 for 2 s in flight: the agent hangs.", ("3",)),
        ("ground", "2's agent did not answer within 3 s: land is sent again.", ("2",)),
        ("ground", "Pilots have 2, 3. The mission ends.", ("2", "3")),
        ("1", "Neighbour silent (3): going on.", ("1", "3")),
    ],
)
def test_a_quantity_is_no_vehicle_of_a_fleet_with_numbers_as_names(
    fleet: FleetConfig, speaker: str, sentence: str, vehicles: tuple[str, ...]
) -> None:
    named = dict(zip(("1", "2", "3"), fleet.vehicles.values(), strict=True))
    numbers = msgspec.structs.replace(fleet, vehicles=named)
    assert vehicles_of(_said(speaker, 0, "warning", sentence), numbers) == vehicles


@pytest.mark.parametrize(("neighbour", "end"), [("mav1", ", mostly for mav1."), ("", ".")])
def test_the_account_names_for_whom_the_law_acted_only_if_it_was_a_neighbour(
    tmp_path: Path, fleet: FleetConfig, neighbour: str, end: str
) -> None:
    now_ns = 5 * SECOND
    files = RecordFiles(
        tmp_path, (tmp_path / "flight.mcap").open("wb"), begin_ns=now_ns, begin="a test"
    )
    own_tick = msgspec.structs.replace(tick(now_ns), active_neighbour=neighbour)
    files.write(Topic.TICK, "mav0", own_tick, now_ns)
    files.finish()
    files.close()

    moment = Moment(kind="distance", stamp_ns=now_ns, vehicles=("mav0", "mav1"), sentence="")
    with contextlib.closing(Timeline(tmp_path)) as timeline:
        account = account_of(timeline, fleet, moment, 5.0)
    assert f"mav0: its law (saturated) changed the thrust by 1.0 m/s²{end}" in account.facts


def test_a_folder_without_a_record_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["incident", str(tmp_path)]) == 2
    assert "there is no flight.mcap" in capsys.readouterr().err


def test_a_folder_of_flights_is_refused_with_the_last_of_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("20260101-120000", "20260102-120000"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "flight.mcap").touch()

    assert main(["incident", str(tmp_path)]) == 2
    assert f"for instance {tmp_path}/20260102-120000." in capsys.readouterr().err
