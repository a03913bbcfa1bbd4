"""``covey check``: what it prints, its exit status, and what a mission's own steps add."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from groundstation import cli
from groundstation.network.bus_findings import bus_findings
from onboard.config.fleet import load_fleet
from onboard.safety.failsafe_table import Condition
from onboard.supervision.condition_monitor import ConditionMonitor
from onboard.supervision.condition_table import LIVE_CHECKS
from onboard.supervision.tick_facts import TickFacts

ROOT = Path(__file__).resolve().parents[3]
PAPER, SIH = (ROOT / f"configs/fleets/{name}.toml" for name in ("paper", "sih"))
MISSION = ROOT / "configs/missions/paper.toml"


def edited(source: Path, folder: Path, *changes: tuple[str, str]) -> str:
    """A copy of a shipped file with some words changed."""
    text = source.read_text().replace("../fleets/", f"{ROOT}/configs/fleets/")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / source.name
    path.write_text(text)
    return str(path)


def rows(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, list[dict[str, object]]]:
    status = cli.main(["check", *words, "--json"])
    return status, json.loads(capsys.readouterr().out)


def test_shipped_files_can_be_flown(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", str(PAPER), str(SIH), str(MISSION)]) == 0
    assert capsys.readouterr().out.count("This can be flown") == 3


def test_the_findings_of_a_fleet_are_printed_once_for_it_and_its_mission(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["check", str(MISSION)]) == 0
    alone = capsys.readouterr().out
    assert cli.main(["check", str(PAPER), str(MISSION)]) == 0
    both = capsys.readouterr().out
    assert alone.count("thrust reserve") == both.count("thrust reserve") == 1
    assert both.count("ok       arrival") == 1  # the mission's own
    assert "findings about its fleet: see above." in both
    assert alone.splitlines()[-1] == both.splitlines()[-1]  # the verdict counts them all


@pytest.mark.parametrize("fleet", [PAPER, SIH])
def test_gps_with_the_papers_spacing_is_refused_with_status_one(
    fleet: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["check", str(fleet), "--errors", "gps"]) == 1
    out = capsys.readouterr().out
    assert "Do not fly this" in out
    assert out.splitlines()[1].startswith("REFUSED")  # the worst first


def test_json_has_value_bound_and_remedy_of_every_finding(
    capsys: pytest.CaptureFixture[str],
) -> None:
    status, found = rows(capsys, str(SIH), "--errors", "gps")
    assert status == 1
    for row in found:
        assert {
            "file",
            "name",
            "status",
            "value",
            "bound",
            "unit",
            "relation",
            "sentence",
            "remedy",
        } <= set(row)
        assert row["file"] == str(SIH)
    assert any(row["status"] == "refused" and row["name"] == "initial conditions" for row in found)


def test_a_wrong_file_is_status_two_and_the_other_is_still_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = edited(SIH, tmp_path, ("safety_distance_m", "safety_distanz_m"))
    status, found = rows(capsys, wrong, str(PAPER))
    assert status == 2
    assert [row["name"] for row in found if row["status"] == "wrong"] == ["file"]
    assert len({frozenset(row) for row in found}) == 1, "every object has the same keys"
    assert any(row["file"] == str(PAPER) for row in found)


@pytest.mark.parametrize(
    ("changes", "name", "status"),
    [
        ([("timeout_s = 30", "timeout_s = 3")], "time", "refused"),
        ([("timeout_s = 60", "timeout_s = 10")], "time", "warning"),
        ([("[0.3, 0.0, 1.2]", "[2.95, 0.0, 1.2]")], "fence", "warning"),
        ([("[0.3, 0.0, 1.2]", "[3.1, 0.0, 1.2]")], "fence", "refused"),
        ([("min_separation_m = 0.80", "min_separation_m = 0.95")], "expectation", "refused"),
        ([("arrived_within_m = 0.15", "arrived_within_m = 0.03")], "arrival", "warning"),
    ],
)
def test_each_finding_about_a_missions_steps_fails_on_purpose(
    changes: list[tuple[str, str]],
    name: str,
    status: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, found = rows(capsys, edited(MISSION, tmp_path, *changes))
    found = [row for row in found if str(row["name"]).partition(",")[0] == name]
    assert next(row["status"] for row in found) == status
    assert code == (1 if status == "refused" else 0)


def unread_status(*words: str) -> int:
    """The exit status of a command that writes to a pipe whose reader has ended."""
    reader, writer = os.pipe()
    os.close(reader)
    stream = os.fdopen(writer, "w", buffering=1, encoding="utf-8")
    with stream, contextlib.redirect_stdout(stream):
        return cli.main(list(words))


def test_a_command_whose_reader_ends_keeps_its_exit_status(tmp_path: Path) -> None:
    refused = edited(MISSION, tmp_path, ("[0.3, 0.0, 1.2]", "[3.1, 0.0, 1.2]"))
    assert unread_status("check", refused) == 1
    assert unread_status("check", str(MISSION)) == 0


def test_a_command_that_runs_until_it_is_stopped_ends_when_nobody_reads_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def run(_words: list[str]) -> int:
        print("ready")
        return 0

    monkeypatch.setattr(cli, "_run", run)
    assert unread_status("router") == 141


def test_a_vehicle_moved_close_to_another_that_stays_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = f"""schema = 1
fleet = "{SIH}"
[[step]]
do = "takeoff"
[[step]]
do = "move"
vehicles = ["mav0"]
position_enu_m = [-0.9, -1.5, 1.0]
"""
    path = tmp_path / "m.toml"
    path.write_text(text)
    status, found = rows(capsys, str(path))
    assert status == 1
    assert "step[1] (move)" in str(next(row for row in found if row["status"] == "refused")["name"])


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ('name = "motor_wek"', "'step[1]': there is no fault 'motor_wek'"),
        ('name = "motor_dead"', "'step[1]': motor_dead needs the parameter 'motor'"),
        ('name = "motor_dead"\nparameters = { motor = 9 }', "'step[1]': motor_dead: motor is 9"),
    ],
)
def test_a_fault_that_the_emulator_would_refuse_is_refused_before_the_flight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: str, words: str
) -> None:
    path = tmp_path / "m.toml"
    path.write_text(
        f"""schema = 1
fleet = "{SIH}"
[[step]]
do = "takeoff"
[[step]]
do = "fault"
vehicles = "mav0"
{fault}
[[step]]
do = "land"
"""
    )
    for command in (["check", str(path)], ["fly", str(path), "--record", str(tmp_path / "out")]):
        assert cli.main(command) == 2
        assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_speed_above_a_vehicles_limit_is_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "m.toml"
    path.write_text(
        f"""schema = 1
fleet = "{SIH}"
[[step]]
do = "takeoff"
[[step]]
do = "move"
position_enu_m = [0.0, 0.0, 1.0]
speed_m_s = 9.0
[[step]]
do = "land"
"""
    )
    status, found = rows(capsys, str(path))
    speed = next(row for row in found if str(row["name"]).startswith("speed, step[1]"))
    assert status == 0
    assert speed["status"] == "warning"
    assert "it asks for 9 m/s" in str(speed["sentence"])


def test_a_file_with_a_fleet_and_no_steps_is_a_mission_without_steps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "m.toml"
    path.write_text(f'schema = 1\nfleet = "{SIH}"\n')
    assert cli.main(["check", str(path)]) == 2
    assert "Add at least one [[step]]" in capsys.readouterr().err


@pytest.mark.realtime
def test_findings_are_the_same_whatever_the_order_of_sets_is(tmp_path: Path) -> None:
    told = set()
    for seed in ("1", "2", "3"):
        ended = subprocess.run(
            [sys.executable, "-m", "groundstation", "check", str(MISSION)],
            env={**os.environ, "PYTHONHASHSEED": seed},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        told.add(ended.stdout)
    assert len(told) == 1


def test_who_has_landed_is_in_nobodys_way(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "m.toml"
    path.write_text(
        f"""schema = 1
fleet = "{SIH}"
[[step]]
do = "takeoff"
[[step]]
do = "wait"
duration_s = 1.0
[[step]]
do = "fault"
name = "arming_refused"
vehicles = ["mav1"]
[[step]]
do = "land"
vehicles = ["mav1", "mav2"]
[[step]]
do = "move"
vehicles = ["mav0"]
position_enu_m = [-0.9, -1.5, 1.0]
"""
    )
    assert cli.main(["check", str(path)]) == 0
    assert "REFUSED" not in capsys.readouterr().out


def test_a_fleet_whose_take_off_is_refused_is_refused_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # 1.00 m: the law keeps it, and cannot park there
    near = ("[0.0, -1.5, 0.0]", "[-0.5, -1.5, 0.0]")
    fleet = edited(PAPER, tmp_path, near)
    mission = tmp_path / "m.toml"
    mission.write_text(
        f'schema = 1\nfleet = "{fleet}"\n[[step]]\ndo = "takeoff"\n[[step]]\ndo = "land"\n'
    )
    for path in (fleet, str(mission)):
        status, found = rows(capsys, path)
        assert status == 1
        assert "spacing" in str(next(row["name"] for row in found if row["status"] == "refused"))


def test_a_mission_that_leaves_vehicles_in_the_air_is_warned_about(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "m.toml"
    path.write_text(f'schema = 1\nfleet = "{SIH}"\n[[step]]\ndo = "takeoff"\n')
    status, found = rows(capsys, str(path))
    assert status == 0
    assert "mav0, mav1, mav2 in the air" in next(
        str(row["sentence"]) for row in found if row["name"] == "ending"
    )


def test_a_python_mission_is_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "m.py"
    path.write_text(
        f'import nobody_has_this\nFLEET = "{SIH}"\nasync def mission(fleet):\n    pass\n'
    )
    assert cli.main(["check", str(path)]) == 2
    assert "No module named 'nobody_has_this'" in capsys.readouterr().err


def test_a_python_mission_with_a_verb_that_does_not_exist_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "m.py"
    path.write_text(f'FLEET = "{SIH}"\nasync def mission(fleet):\n    await fleet.takof()\n')
    for command in (
        ["check", str(path)],
        ["fly", str(path), "--lockstep", "--record", str(tmp_path / "out")],
    ):
        assert cli.main(command) == 2
        words = "line 3: fleet.takof does not exist. Did you mean 'takeoff'?"
        assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_narrow_terminal_breaks_lines_and_loses_no_words(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main(["check", str(SIH)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines[1:])) <= 80


def test_poses_over_routers_are_warned_about_unless_vehicles_read_the_motion_capture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = PAPER.read_text(encoding="utf-8")
    text = text.replace("[fleet]", '[fleet]\nrouters = ["tcp/127.0.0.1:7500"]')
    for more, is_warned in (
        ("", True),
        (
            '\n[mocap]\nsource = "motioncapture"\ntype = "vrpn"\nhostname = "127.0.0.1"\ndirect '
            "= true\n",
            False,
        ),
    ):
        (tmp_path / "fleet.toml").write_text(text + more, encoding="utf-8")
        assert cli.main(["check", str(tmp_path / "fleet.toml")]) == 0
        assert ("poses over routers" in capsys.readouterr().out) is is_warned


def test_poses_over_routers_are_compared_with_the_time_after_which_a_vehicle_lands(
    tmp_path: Path,
) -> None:
    text = PAPER.read_text(encoding="utf-8")
    text = text.replace("[fleet]", '[fleet]\nrouters = ["tcp/127.0.0.1:7500"]')
    (tmp_path / "fleet.toml").write_text(text, encoding="utf-8")
    fleet = load_fleet(tmp_path / "fleet.toml")
    (finding,) = (one for one in bus_findings(fleet) if one.name == "poses over routers")

    def lands(position_age_s: float) -> bool:
        monitor = ConditionMonitor(fleet.fleet)
        for tick in range(LIVE_CHECKS):
            facts = TickFacts(
                now_ns=tick * 20_000_000, limits=fleet.fleet, position_age_s=position_age_s
            )
            conditions = monitor.update(facts)
        return Condition.POSITION_LOST in conditions

    assert lands(finding.bound + 0.01)
    assert not lands(finding.bound - 0.01)


def test_an_unknown_accuracy_is_status_two(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", str(SIH), "--errors", "radar"]) == 2
    assert "radar" in capsys.readouterr().err


def test_in_a_narrow_terminal_a_sentence_has_room_below_its_name(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    assert cli.main(["check", "paper"]) == 0
    headline, *lines, _ = capsys.readouterr().out.splitlines()

    assert "a valid mission" in headline
    assert max(len(line) for line in lines) <= 60
    assert "warning  kappas" in lines
    assert max(len(line) - len(line.lstrip()) for line in lines) == 9
