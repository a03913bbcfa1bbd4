"""``covey identify``: a fleet file that is wrong about its vehicle is corrected by the manoeuvre it
flies.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from groundstation import cli
from groundstation.flights.flight_settings import prepare
from groundstation.flights.identification_flight import write_manoeuvre
from groundstation.identification.manoeuvre import manoeuvre, mission_text
from onboard.config.fleet import ConfigError, FleetConfig, Vehicle, fleet_from_mapping, load_fleet
from sitl import fleet_emulator

pytest_plugins = ["sitl.lockstep.testing"]

ROOT = Path(__file__).resolve().parents[3]
FLEETS = {"ardrone": ROOT / "configs/fleets/paper.toml", "sih": ROOT / "configs/fleets/sih.toml"}


def edited(kind: str, **types: float) -> FleetConfig:
    """A shipped fleet in which only mav0 flies, with other values for its type."""
    data = tomllib.loads(FLEETS[kind].read_text())
    for name in ("mav1", "mav2"):
        data["vehicles"][name]["enabled"] = False
    data["types"][kind] |= types
    return fleet_from_mapping(data, path=str(FLEETS[kind]))


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        ("ardrone", {"hover_thrust_frac": 0.81, "drag_1_s": 0.7, "attitude_wn_rad_s": 8.5}),
        pytest.param(
            "sih",
            {"hover_thrust_frac": 0.45, "drag_1_s": 0.4, "attitude_wn_rad_s": 7.0},
            marks=pytest.mark.long,
        ),
    ],
)
def test_a_vehicle_that_the_fleet_file_has_wrong_is_identified_from_its_flight(
    kind: str,
    wrong: dict[str, float],
    tmp_path: Path,
    lockstep: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    true = edited(kind).vehicles["mav0"]
    profile_of = fleet_emulator.profile_of
    # what really flies
    monkeypatch.setattr(fleet_emulator, "profile_of", lambda vehicle: profile_of(true))
    believed = edited(kind, **wrong)
    mission = tmp_path / "mission.py"
    mission.write_text(mission_text(FLEETS[kind], "mav0", manoeuvre(believed, "mav0", seed=1)))
    folder = tmp_path / "flight"
    flight = lockstep(believed, seed=4, folder=folder)
    bias_rad = flight.simulation.emulator.world.vehicles.tilt_bias_rad[0].copy()
    from groundstation.mission_files.loading import load_mission

    assert flight.fly(load_mission(mission, believed)).passed
    assert "lag-differs" in {event.code for event in flight.events}  # the agent has noticed as well
    flight.close()
    config = tmp_path / "fleet.toml"
    config.write_text(_with(FLEETS[kind], kind, wrong))

    assert (
        cli.main(["identify", str(folder), "--fleet", str(config), "--vehicle", "mav0", "--json"])
        == 0
    )
    found = json.loads(capsys.readouterr().out)[0]
    assert found["lag_s"]["value"] == pytest.approx(true.lag_s, abs=0.02)
    assert found["hover_thrust_frac"]["value"] == pytest.approx(true.hover_thrust_frac, rel=0.01)
    drag = found["drag_1_s"]
    assert drag["low"] <= true.drag_1_s <= drag["high"] or drag["value"] == pytest.approx(
        true.drag_1_s, rel=0.2
    )
    error_deg = [found["tilt_error_x_deg"]["value"], found["tilt_error_y_deg"]["value"]]
    assert math.hypot(*error_deg) == pytest.approx(math.degrees(math.hypot(*bias_rad)), abs=0.3)
    verdicts = {row["name"]: row["verdict"] for row in found["rows"]}
    assert verdicts["lag L [s]"].startswith("matters")
    assert verdicts["hover_thrust_frac"].startswith("matters")

    assert cli.main(["identify", str(folder), "--fleet", str(config)]) == 0
    out = capsys.readouterr().out
    proposed = tomllib.loads(out[out.index("# identified") :])["types"][kind]
    merged = msgspec.structs.replace(
        believed.vehicles["mav0"], **{k: v for k, v in proposed.items() if k != "sitl"}
    )
    assert isinstance(merged, Vehicle)
    assert merged.lag_s == pytest.approx(found["lag_s"]["value"], abs=0.002)

    pytest.importorskip("tomlkit")
    own = config.read_text().replace("\nmax_speed_m_s = 1.0\n", "\nmax_speed_m_s = 1.0  # safe\n")
    config.write_text(f"# of the lab\n{own}")
    before = config.read_text().splitlines()
    assert cli.main(["identify", str(folder), "--fleet", str(config), "--write"]) == 0
    assert load_fleet(config).vehicles["mav0"].lag_s == pytest.approx(merged.lag_s)
    left = config.read_text().splitlines()
    changed = [line for line in left if line not in before]
    assert {line.partition(" = ")[0] for line in changed} <= {*proposed, *proposed["sitl"]}
    assert "# of the lab" in left
    assert "max_speed_m_s = 1.0  # safe" in left


def _with(path: Path, kind: str, values: dict[str, float]) -> str:
    from groundstation.processes.free_ports import toml_text

    data = tomllib.loads(path.read_text())
    data["types"][kind] |= values
    return toml_text(data, "changed")


def test_the_manoeuvre_stays_in_its_box_inside_the_fence_and_clear_of_the_others() -> None:
    fleet = load_fleet(FLEETS["sih"])
    x, y, _ = fleet.vehicles["mav1"].start_enu_m
    steps = manoeuvre(fleet, "mav1", half_m=5.0)
    # 1.5 m to the next one
    assert max(max(abs(goal[0] - x), abs(goal[1] - y)) for goal, _ in steps) <= 0.5
    assert {duration > 0.0 for _, duration in steps} == {True, False}  # quick and slow
    assert manoeuvre(fleet, "mav1") == manoeuvre(fleet, "mav1")
    assert manoeuvre(fleet, "mav1", seed=1) != manoeuvre(fleet, "mav1")


def test_the_files_of_an_emulated_manoeuvre_are_those_of_a_flight(tmp_path: Path) -> None:
    fleet_path = write_manoeuvre(
        str(FLEETS["ardrone"]),
        "mav1",
        tmp_path,
        half_m=0.8,
        seed=1,
        is_simulated=True,
        is_headless=True,
    )
    settings = prepare(
        str(tmp_path / "mission.py"),
        tmp_path,
        fleet_path=str(fleet_path),
        law=None,
        is_simulated=True,
        has_free_ports=True,
        is_headless=True,
    )
    assert settings.mission.fleet.enabled_names == ("mav1",)
    assert load_fleet(tmp_path / "fleet.toml").enabled_names == ("mav1",)


def test_without_room_the_manoeuvre_is_refused() -> None:
    data = tomllib.loads(FLEETS["sih"].read_text())
    data["fleet"]["geofence_m"]["y"] = [-1.9, 4.0]
    with pytest.raises(ConfigError, match="Move the start"):
        manoeuvre(fleet_from_mapping(data), "mav0")


def test_below_a_ceiling_that_is_too_low_the_manoeuvre_is_refused() -> None:
    data = tomllib.loads(FLEETS["sih"].read_text())
    data["fleet"]["geofence_m"]["z"] = [0.0, 0.75]
    goal, _ = manoeuvre(fleet_from_mapping(data), "mav0")[0]
    assert goal[2] == pytest.approx(0.45)
    data["fleet"]["geofence_m"]["z"] = [0.0, 0.5]
    with pytest.raises(ConfigError, match=r"would fly at 0.20 m.*Raise the ceiling to 0.7 m"):
        manoeuvre(fleet_from_mapping(data), "mav0")


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["--fleet", str(FLEETS["sih"])],
        ["--fleet", str(FLEETS["sih"]), "--vehicle", "mav9", "--headless"],
        ["--fleet", str(FLEETS["sih"]), "--vehicle", "mav0"],  # without a terminal
        ["/nowhere"],
        ["/nowhere", "--sitl"],
        [
            "--fleet",
            str(FLEETS["sih"]),
            "--vehicle",
            "mav0",
            "--headless",
            "--sitl",
            "--seed",
            "-1",
        ],
        [
            "--fleet",
            str(FLEETS["sih"]),
            "--vehicle",
            "mav0",
            "--headless",
            "--sitl",
            "--box",
            "nan",
        ],
    ],
    ids=" ".join,
)
def test_wrong_input_is_a_sentence_and_status_two_and_nothing_starts(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["identify", *words]) == 2
    assert capsys.readouterr().err.startswith("covey: ")
    assert list(tmp_path.iterdir()) == []


def test_a_record_in_which_nobody_flew_is_status_one_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], lockstep: Callable[..., Any]
) -> None:
    fleet = edited("sih")
    flight = lockstep(fleet, folder=tmp_path)
    flight.ready()
    flight.close()
    assert (
        cli.main(["identify", str(tmp_path), "--fleet", str(FLEETS["sih"]), "--vehicle", "mav0"])
        == 1
    )
    assert "did not fly" in capsys.readouterr().err


def test_values_are_written_only_into_a_file_of_one_s_own(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for words in ([], ["--fleet", "paper"]):
        assert cli.main(["identify", "flights/first", "--write", *words]) == 2
        assert "--write needs --fleet FILE" in capsys.readouterr().err
