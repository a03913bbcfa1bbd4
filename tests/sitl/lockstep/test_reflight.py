"""A flight in lockstep that is flown again: the same bytes, and the same flight up to a change."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader

from groundstation.cli import main
from groundstation.flights.changes import parse_change
from groundstation.flights.recorded_flight import DIGESTS_NAME, open_recorded
from groundstation.flights.simulation_settings import SIMULATION_NAME
from onboard.config.fleet import ConfigError
from sitl.lockstep.reflight import AnotherFlightError, fly_again

_MISSION = """\
schema = 1
fleet = "paper"

[[step]]
do = "takeoff"
height_m = 1.0

[[step]]
do = "wait"
duration_s = 2.0

[[step]]
do = "land"
"""

_PYTHON_MISSION = """\
FLEET = "paper"


async def mission(fleet):
    await fleet.takeoff(0.6)
    await fleet.land()
"""

Row = tuple[str, int, bytes]


def rows(folder: Path) -> list[Row]:
    """Return topic, time and bytes of every message, in the order of the file."""
    with (folder / "flight.mcap").open("rb") as stream:
        messages = make_reader(stream).iter_messages(log_time_order=False)
        return [(channel.topic, message.log_time, message.data) for _, channel, message in messages]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a flight with gusts, which make every random number count."""
    folder = tmp_path_factory.mktemp("flown")
    mission = folder / "up_and_down.toml"
    mission.write_text(_MISSION)

    words = ["fly", str(mission), "--lockstep", "--seed", "4", "--record", str(folder / "flight")]
    assert main([*words, "--wind-m-s", "1,-1", "--gust-m-s", "0.2", "--bus-loss", "0.05"]) == 0
    return folder / "flight"


def test_flown_again_unchanged_every_message_has_the_same_topic_time_and_bytes(
    flown: Path, tmp_path: Path
) -> None:
    again = tmp_path / "again"

    assert main(["replay", str(flown), "--resume-at", "6", "--record", str(again)]) == 0

    assert rows(again) == rows(flown)
    assert (again / DIGESTS_NAME).read_text() == (flown / DIGESTS_NAME).read_text()


@pytest.mark.long
def test_a_change_in_flight_leaves_all_before_it_as_it_was(flown: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    resume_s = 7.0

    fly_again(
        open_recorded(flown),
        folder=again,
        resume_at_s=resume_s,
        changes=[parse_change("wind=3,0")],
    )

    begin_ns = min(stamp_ns for _, stamp_ns, _ in rows(flown))
    change_ns = begin_ns + round((resume_s - 0.1) * 1e9)

    def before(folder: Path) -> list[Row]:
        return [row for row in rows(folder) if row[1] < change_ns]

    assert before(again) == before(flown)
    assert rows(again) != rows(flown)


@pytest.mark.long
def test_a_flight_that_is_another_one_before_its_change_is_ended(
    flown: Path, tmp_path: Path
) -> None:
    digests = (flown / DIGESTS_NAME).read_text().splitlines()
    second, _, _ = digests[1].partition(" ")

    falsified = tmp_path / "falsified"
    falsified.mkdir()
    for file in flown.iterdir():
        (falsified / file.name).write_bytes(file.read_bytes())
    digests[1] = f"{second} {'0' * 24}"
    (falsified / DIGESTS_NAME).write_text("\n".join(digests) + "\n")

    with pytest.raises(AnotherFlightError, match=r"differs from the recorded one from 4\.0 s on"):
        fly_again(open_recorded(falsified), resume_at_s=6.0, changes=[parse_change("wind=3,0")])


def test_an_order_of_another_ground_that_is_refused_is_told(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    mission = tmp_path / "up_and_down.toml"
    mission.write_text(_MISSION)
    words = ["fly", str(mission), "--lockstep", "--record", str(tmp_path / "flight")]
    assert main([*words, "--order", "6 home mav1"]) == 0
    assert "Order 'home mav1' of ground-2: mav1 refused: " in capsys.readouterr().out


def test_an_order_of_another_ground_comes_at_its_time(flown: Path) -> None:
    reflown = fly_again(
        open_recorded(flown), resume_at_s=6.0, changes=[parse_change("order=land all")]
    )
    assert reflown.equal_until_s == 6.0
    assert not reflown.verdict.passed


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("law", "write KEY=VALUE"),
        ("law.kappa=3", "unknown key 'law.kappa'"),
        ("types.ardrone.mass_kg=1", "cannot change in flight"),
        ("law=off", "cannot change in flight"),
        ("bus.speed=1", "The bus has no 'speed'"),
        ("bus.loss=2", "between 0 and 1"),
        ("without_fault=1", "this flight has 0 faults"),
        ("fault=mav7 motor_dead motor=2", "'mav7' is not emulated"),
        ("wind=strong", "--what-if wind is 'strong'; write it as EAST,NORTH"),
        ("gust=-1", "Gusts of -1 m/s cannot be simulated"),
    ],
)
def test_an_impossible_change_is_refused_before_anything_flies(
    flown: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, sentence: str
) -> None:
    words = ["replay", str(flown), "--resume-at", "6", "--record", str(tmp_path / "again")]
    assert main([*words, "--what-if", text]) == 2
    printed = capsys.readouterr()
    assert sentence in printed.err
    assert printed.out == ""


def test_a_change_after_the_end_of_the_flight_is_refused(
    flown: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    again = tmp_path / "again"
    words = ["replay", str(flown), "--resume-at", "99", "--what-if", "wind=1,0"]
    assert main([*words, "--record", str(again)]) == 2
    assert "the recorded flight ended at" in capsys.readouterr().err
    assert not (again / "flight.mcap").exists()


def test_a_fault_whose_time_was_not_reached_is_named(
    flown: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    words = ["replay", str(flown), "--what-if", "fault=mav1 motor_dead motor=2 at=99"]
    assert main([*words, "--record", str(tmp_path / "again")]) == 0
    assert "motor=2 at=99' never happened" in capsys.readouterr().out


@pytest.mark.long
def test_a_python_mission_keeps_its_name_when_it_is_flown_again(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    mission = tmp_path / "hop.py"
    mission.write_text(_PYTHON_MISSION)
    first, second, third = (str(tmp_path / name) for name in ("first", "second", "third"))
    assert main(["fly", str(mission), "--lockstep", "--record", first]) == 0
    mission.unlink()

    assert main(["replay", first, "--what-if", "seed=2", "--record", second]) == 0
    assert main(["replay", second, "--what-if", "seed=3", "--record", third]) == 0
    assert capsys.readouterr().out.count("PASSED: mission 'hop'") == 3


def test_a_flight_without_its_settings_cannot_be_flown_again(flown: Path, tmp_path: Path) -> None:
    for name in ("flight.mcap", "fleet.toml", "mission.toml"):
        (tmp_path / name).write_bytes((flown / name).read_bytes())
    with pytest.raises(ConfigError, match=f"there is no {SIMULATION_NAME}"):
        open_recorded(tmp_path)
