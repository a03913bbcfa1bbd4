"""Files of parameters, and the comparison of versions, without any PX4."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
from msgspec.structs import replace

from groundstation.cli import main
from groundstation.commands.px4 import measured_px4
from groundstation.px4 import version_comparison
from groundstation.px4.parameter_file import read_file, write_file
from groundstation.px4.parameter_sets import differences
from groundstation.px4.vehicle_links import is_device_of_another_computer, opened
from groundstation.starter.starter_files import Answers, starter
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping, load_fleet


def compared(fleet: FleetConfig, old: str, new: str) -> version_comparison.Comparison:
    return version_comparison.compare(fleet, old, new, measured_px4())


def test_a_file_keeps_every_value_of_every_vehicle(tmp_path: Path) -> None:
    sets = {
        1: {"A": -1, "B": 0.1, "C": 1e-30, "D": 2147483647},
        20: {"A": 0, "B": -123456.78, "D": 3},
    }
    path = tmp_path / "all.params"
    write_file(path, {number: (f"mav{number}", values) for number, values in sets.items()})
    read = read_file(path)
    assert read.keys() == sets.keys()
    for number, values in sets.items():
        assert read[number] == pytest.approx(values, rel=1e-8)
        assert all(type(read[number][name]) is type(value) for name, value in values.items())
    with pytest.raises(ConfigError, match="exists already"):
        write_file(path, {})
    with pytest.raises(ConfigError, match="cannot be written"):
        write_file(tmp_path / "nowhere" / "all.params", {})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "holds no parameters"),
        ("# a remark only\n", "holds no parameters"),
        ("1\t1\tA\t0.5\n", "line 1"),
        ("1\t1\tA\t0.5\t9\n1\t1\tA\tnan\t9\n", "line 2"),
        ("1\t1\tA\t0.5\t6\n", "line 1"),
        ("1\t1\tA\t1\t2\n", "line 1"),
        pytest.param(f"1\t1\tA\t{10**309}\t6\n", "line 1", id="larger than any float"),
        pytest.param(f"1\t1\tA\t{2**31}\t6\n", "line 1", id="larger than INT32"),
        pytest.param("1\t1\tA\t1e39\t9\n", "line 1", id="larger than REAL32"),
        ("1\t1\ta name\t1\t6\n", "line 1"),
        ("1\t1\tA\t1\t6\n1\t1\tA\t2\t6\n", "has two values"),
        ("\x00\x01", "is no parameter"),
    ],
)
def test_another_file_is_refused_with_its_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "bad.params"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=words):
        read_file(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_file(path)


def test_parameters_of_other_components_of_a_vehicle_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "saved_by_qgroundcontrol.params"
    path.write_text("1\t1\tA\t1\t6\n1\t154\tA\t2\t6\n1\t154\tGMB_MODE\t3\t2\n", encoding="utf-8")
    assert read_file(path) == {1: {"A": 1}}


def test_values_of_one_vehicle_alone_are_no_difference() -> None:
    rows, left_out = differences(
        {"MAV_SYS_ID": 1, "CAL_ACC0_ID": 7, "A": 0.1, "B": 1, "NEW": 2.0},
        {"MAV_SYS_ID": 2, "A": 0.1 + 1e-8, "B": 2, "OLD": 3.0},
    )
    assert [row.split() for row in rows] == [
        ["B", "1,", "there", "2"],
        ["NEW", "2,", "there", "not", "known"],
        ["OLD", "not", "known,", "there", "3"],
    ]
    assert left_out == 2


@pytest.mark.parametrize(
    "words",
    [
        ["--dump", "a", "--apply"],
        ["--diff", "mav0", "--restore", "a"],
        ["--backup", "a"],
        ["--diff", "nobody"],
        ["--diff", "all"],
    ],
)
def test_options_that_contradict_each_other_are_refused(words: list[str], tmp_path: Path) -> None:
    assert main(["px4", "params", "--fleet", "paper", *words]) == 2


@pytest.mark.parametrize("diff", ["mav0", "0"])
def test_a_vehicle_is_not_compared_with_itself_alone(
    diff: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["px4", "params", "--fleet", "paper", "--vehicles", "mav0", "--diff", diff]
    assert main(command) == 2
    assert "no other vehicle to compare with mav0" in capsys.readouterr().err


def test_what_a_version_changes_is_said_for_this_fleet(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["px4", "compare", "1.16", "1.18", "--fleet", "sih"]) == 0
    text = capsys.readouterr().out
    assert "COM_RC_OVERRIDE = 0 is demanded no more." in text
    assert "MAN_OVERRIDE_SPD = -1 is demanded from now on" in text
    assert "MC_ROLL_P comes as 4 instead of 6.5; the fleet demands 6.5, so nothing changes." in text
    assert "stick.fast: OFFBOARD -> POSCTL" in text
    assert main(["px4", "compare", "1.16", "1.18", "--fleet", "paper", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    concerns = {fact["name"]: fact["concerns"] for fact in said["facts"]}
    assert concerns["loss.mode-after"] == []  # the fleet demands another action
    assert concerns["step.roll-10-t63"] == ["mav0", "mav1", "mav2"]
    assert "MC_ROLL_P comes as 4 instead of 6.5." in said["parameters"]


def test_changed_demands_are_said_in_the_order_of_their_names() -> None:
    said = compared(load_fleet("sih"), "1.17", "1.18").parameters
    ended = [row.split()[0] for row in said if "is demanded no more" in row]
    new = [row.split()[0] for row in said if "is demanded from now on" in row]
    assert len(ended) > 2
    assert len(new) > 3
    assert ended == sorted(ended)
    assert new == sorted(new)


def test_a_demand_concerns_nobody_and_a_parameter_that_is_gone_is_named() -> None:
    fleet = load_fleet("sih")
    own = {"COM_OBL_RC_ACT": 0, "EKF2_GPS_DELAY": 120.0}
    import tomllib

    data = tomllib.loads(fleet.text)
    data["vehicles"]["mav1"]["px4_params"] = own
    found = compared(fleet_from_mapping(data), "v1.17", "1.18.0")
    by_name = {fact.name: fact for fact in found.facts}
    assert by_name["loss.action-0"].concerns == ()
    assert any(
        row.startswith("mav1: EKF2_GPS_DELAY") and "gone in v1.18" in row
        for row in found.parameters
    )
    back = compared(fleet, "1.18", "1.16")
    assert any(row.startswith("MC_ROLL_P comes as 6.5 instead of 4") for row in back.parameters)
    same = compared(fleet, "1.17", "1.17")
    assert not same.parameters
    assert not same.facts
    assert "nothing changes." in version_comparison.as_text(same)


def test_versions_that_nobody_measured_are_named_and_nonsense_is_refused() -> None:
    fleet = load_fleet("sih")
    assert (
        "V1.19 was never measured: it is judged as v1.18." in compared(fleet, "1.18", "1.19").notes
    )
    for version in ("main", "1", "1.16-", ""):
        with pytest.raises(ConfigError, match="is no version of PX4"):
            compared(fleet, version, "1.18")


def test_every_changed_fact_has_a_meaning_and_every_row_a_group() -> None:
    found = compared(load_fleet("sih"), "1.16", "1.18")
    assert {fact.meaning for fact in found.facts if fact.meaning == "other behaviour"} == set()
    assert {fact.group for fact in found.facts} == {"failsafe", "attitude", "link"}


def test_the_serial_device_of_another_computer_is_refused_in_a_sentence() -> None:
    text = starter(Answers(vehicles=2, companions="198.51.100.7")).fleet_text
    fleet = fleet_from_mapping(tomllib.loads(text), path="fleet.toml", text=text)
    with opened([fleet.vehicles["mav0"]], {}) as links:
        (link,) = links
    assert link.trouble.startswith("Its PX4 is at /dev/ttyAMA0 of 198.51.100.7, another computer")
    assert "vehicles.mav0.direct" in link.trouble
    assert "stop" not in link.trouble

    here = replace(fleet.vehicles["mav0"], agent="tcp/127.0.0.1:7460")
    assert not is_device_of_another_computer(here)
