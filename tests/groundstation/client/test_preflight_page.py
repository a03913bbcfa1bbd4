"""The preflight page, and what a mission makes of it and of the law's findings."""

from __future__ import annotations

import asyncio
import json
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest

from groundstation.cli import main
from groundstation.client import preflight_page
from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState, NodeSeen, fold, fold_nodes, initial
from groundstation.mission_files.loading import load_mission, mission_from_mapping
from groundstation.mission_files.mission_findings import refuse_unflyable
from groundstation.missions.runner import MissionRun
from groundstation.processes.free_ports import toml_text, with_free_ports
from onboard.bus.schema import PreflightReport, Truth
from onboard.bus.topics import Topic
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping, load_fleet

SECOND = 1_000_000_000
ADVICE = ("record", True, "Nobody records this flight.", "Fly it with covey fly.")
FINE = ("battery", True, "Battery at 87 %.", "")
SHORT = ("frame", True, "The take-off spots do not show it.", "Put vehicles down further apart.")
BAD = ("battery", False, "Battery at 12 %, take-off needs 30 %.", "Charge or change it.")


def report(vehicle: str, *checks: tuple[str, bool, str, str], sequence: int = 1) -> PreflightReport:
    return PreflightReport(vehicle=vehicle, boot_id=1, sequence=sequence, stamp_ns=0, checks=checks)


def heard(
    fleet: FleetConfig, make_telemetry: Any, checks: dict[str, Any], **changes: Any
) -> FleetState:
    state = initial(fleet)
    for name, found in checks.items():
        told = make_telemetry(name, config_hash=fleet.config_hash, **changes)
        state = fold(
            fold(fold_nodes(state, [NodeSeen(name, True)]), told, 0), report(name, *found), 0
        )
    return state


def test_the_page_says_go_or_names_who_is_not_and_why(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    state = heard(fleet, make_telemetry, {"mav0": [FINE, ADVICE], "mav1": [BAD], "mav2": [FINE]})
    pages = preflight_page.pages_of(state, fleet, fleet.enabled_names, SECOND)
    assert preflight_page.exit_status(pages) == 1
    text = preflight_page.as_text(pages)
    assert "mav0: go" in text
    assert "mav1: NO-GO" in text
    assert (
        "  NO-GO  battery      Battery at 12 %, take-off needs 30 %. Charge or change it." in text
    )
    assert "  advice record       Nobody records this flight. Fly it with covey fly." in text
    assert text.endswith("Do not fly: mav1 (battery).")

    told = preflight_page.as_mapping(pages)
    assert told["is_go"] is False
    assert told["vehicles"]["mav0"]["is_go"] is True
    assert told["vehicles"]["mav1"]["checks"][0]["status"] == "no-go"

    both = preflight_page.pages_of(state, fleet, ["mav0", "mav2"], SECOND)
    assert preflight_page.exit_status(both) == 0
    assert preflight_page.as_text(both).endswith("Go: mav0, mav2.")


def test_a_flight_begins_with_the_advice_about_the_frame_of_real_vehicles_only(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    state = heard(fleet, make_telemetry, {"mav0": [SHORT], "mav1": [SHORT]})
    emulated = Truth(
        vehicle="mav0",
        stamp_ns=0,
        position_enu_m=(0.0, 0.0, 0.0),
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
        is_on_ground=True,
        is_collided=False,
    )
    state = fold(state, emulated, 0)
    assert preflight_page.advice_of(state, ["mav0", "mav1"]) == {" ".join(SHORT[2:]): ["mav1"]}


def test_two_versions_of_px4_in_one_fleet_are_said_of_each_vehicle(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    state = heard(fleet, make_telemetry, {"mav0": [FINE], "mav1": [FINE], "mav2": [FINE]})
    for name, version in (("mav0", (1, 16)), ("mav1", (1, 18)), ("mav2", None)):
        state = fold(
            state, msgspec.structs.replace(report(name, FINE, sequence=2), px4_version=version), 0
        )

    pages = preflight_page.pages_of(state, fleet, fleet.enabled_names, SECOND)
    for page in pages:
        line = next(line for line in page.lines if line.name == "versions")
        assert line.status == "advice"
        assert "v1.16: mav0; v1.18: mav1." in line.sentence
        assert "covey px4 compare 1.16 1.18 --fleet" in line.remedy

    one = preflight_page.pages_of(state, fleet, ["mav0", "mav2"], SECOND)
    assert not any(line.name == "versions" for page in one for line in page.lines)


def test_silence_another_file_and_a_vehicle_in_the_air_are_no_go_in_words(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    assert (
        preflight_page.exit_status(
            preflight_page.pages_of(initial(fleet), fleet, fleet.enabled_names, SECOND)
        )
        == 10
    )

    state = heard(fleet, make_telemetry, {"mav0": [FINE]})
    pages = preflight_page.pages_of(state, fleet, fleet.enabled_names, SECOND)
    assert preflight_page.exit_status(pages) == 1
    assert "mav1's agent does not answer. Start it" in preflight_page.as_text(pages)

    late = preflight_page.pages_of(state, fleet, ["mav0"], 60 * SECOND)
    assert preflight_page.exit_status(late) == 10

    other = fold(state, make_telemetry("mav0", sequence=2, config_hash="another"), SECOND)
    assert "another fleet file" in preflight_page.as_text(
        preflight_page.pages_of(other, fleet, ["mav0"], SECOND)
    )

    law = {"law": "paper", "config_hash": fleet.with_law("paper").config_hash}
    under_paper = fold(state, make_telemetry("mav0", sequence=2, **law), SECOND)
    pages = preflight_page.pages_of(under_paper, fleet, ["mav0"], SECOND)
    assert preflight_page.exit_status(pages) == 0
    assert "mav0 flies the law 'paper' instead of the file's 'covey'." in preflight_page.as_text(
        pages
    )

    flying = fold(initial(fleet), make_telemetry("mav0", is_airborne=True, state="flying"), 0)
    assert preflight_page.has_reported(flying, ["mav0"], SECOND)
    page = preflight_page.page_of(flying.vehicles["mav0"], fleet, SECOND)
    assert not page.is_go
    assert any("Wait until it has landed." in line.remedy for line in page.lines)


def test_a_vehicle_without_a_second_way_is_advised_to_have_one(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    bare = msgspec.structs.replace(fleet.vehicles["mav0"], direct=None)
    alone = msgspec.structs.replace(fleet, vehicles={**fleet.vehicles, "mav0": bare})
    state = heard(alone, make_telemetry, {"mav0": [FINE]})

    (line,) = [
        one
        for one in preflight_page.page_of(state.vehicles["mav0"], alone, 0).lines
        if one.name == "direct path"
    ]

    assert line.status == "advice"
    assert "vehicles.mav0.direct" in line.remedy


async def test_asking_waits_for_the_reports_and_not_longer(
    fleet: FleetConfig, bus: Any, client: FleetClient
) -> None:
    for name in fleet.enabled_names:
        bus.tell(name, config_hash=fleet.config_hash)
        bus.on_message[Topic.PREFLIGHT](Topic.PREFLIGHT, name, report(name, FINE))

    pages = await preflight_page.ask(client, fleet.enabled_names, 5.0)
    assert preflight_page.exit_status(pages) == 0


async def test_asking_may_wait_until_all_are_go(
    fleet: FleetConfig, bus: Any, client: FleetClient
) -> None:
    for name in fleet.enabled_names:
        bus.tell(name, config_hash=fleet.config_hash)
        bus.on_message[Topic.PREFLIGHT](Topic.PREFLIGHT, name, report(name, BAD))

    assert (
        preflight_page.exit_status(await preflight_page.ask(client, fleet.enabled_names, 5.0, 0.05))
        == 1
    )

    asked = asyncio.ensure_future(preflight_page.ask(client, fleet.enabled_names, 5.0, 30.0))
    await asyncio.sleep(0.0)
    assert not asked.done()

    for name in fleet.enabled_names:
        bus.on_message[Topic.PREFLIGHT](Topic.PREFLIGHT, name, report(name, FINE, sequence=2))
    assert preflight_page.exit_status(await asked) == 0


async def test_a_mission_says_each_advice_once_with_whom_it_concerns(
    fleet: FleetConfig, bus: Any, client: FleetClient
) -> None:
    for name in fleet.enabled_names:
        bus.on_message[Topic.PREFLIGHT](Topic.PREFLIGHT, name, report(name, FINE, ADVICE))

    said: list[str] = []
    mission = mission_from_mapping(
        {"schema": 1, "step": [{"do": "wait", "duration_s": 0.01}]}, path="wait.toml", fleet=fleet
    )
    await MissionRun(mission, client, say=said.append, ready_timeout_s=2.0).run()

    lines = [line for line in said if line.startswith("Preflight")]
    assert lines == [
        "Preflight, mav0, mav1, mav2: Nobody records this flight. Fly it with covey fly."
    ]


def test_wrong_input_of_the_command_has_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paper = "configs/fleets/paper.toml"
    assert main(["preflight", "--fleet", str(tmp_path / "none.toml")]) == 2
    assert main(["preflight", "--fleet", paper, "--vehicles", "nobody"]) == 2
    assert main(["preflight", "--fleet", paper, "--exclude", "all"]) == 2
    assert main(["preflight", "--fleet", paper, "--timeout", "0"]) == 2

    assert "No vehicle is selected" in capsys.readouterr().err


def test_nobody_there_has_status_10_and_is_json_on_request(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (
        Path("configs/fleets/paper.toml")
        .read_text(encoding="utf-8")
        .replace('name = "paper"', 'name = "nobody"')
    )

    path = tmp_path / "fleet.toml"
    path.write_text(text.replace(":746", ":17"), encoding="utf-8")
    assert main(["preflight", "--fleet", str(path), "--timeout", "0.3", "--json"]) == 10

    told = json.loads(capsys.readouterr().out)
    assert told["is_go"] is False
    assert list(told["vehicles"]) == ["mav0", "mav1", "mav2"]
    assert not any(vehicle["answers"] for vehicle in told["vehicles"].values())


def test_a_mission_that_the_law_refuses_does_not_start_and_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = Path("configs/missions/paper.toml").read_text(encoding="utf-8")
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text(encoding="utf-8"))

    fleet = tmp_path / "fleet.toml"
    fleet.write_text(toml_text(with_free_ports(data, fleet_from_mapping(data))), encoding="utf-8")
    near = tmp_path / "near.toml"
    near.write_text(
        text.replace("position_enu_m = [0.0, 1.2, 1.0]", "position_enu_m = [0.0, 3.0, 1.0]"),
        encoding="utf-8",
    )

    folder = tmp_path / "flight"
    command = [
        "fly",
        str(near),
        "--fleet",
        str(fleet),
        "--sitl",
        "--headless",
        "--record",
        str(folder),
    ]

    assert main(command) == 2
    said = capsys.readouterr().err
    assert "the law says that this cannot be flown" in said
    assert "mav0 is 0.08 m from the fence" in said
    assert not folder.joinpath("flight.mcap").exists()

    refuse_unflyable(load_mission("configs/missions/paper.toml", str(fleet)), is_simulated=False)

    weak = load_fleet(fleet)
    strong = weak.vehicles["mav1"]
    vehicles = {**weak.vehicles, "mav1": msgspec.structs.replace(strong, hover_thrust_frac=0.89)}
    weak = msgspec.structs.replace(weak, vehicles=vehicles)

    with pytest.raises(ConfigError, match="mav1 at its max_tilt_deg"):
        refuse_unflyable(load_mission("configs/missions/paper.toml", weak), is_simulated=True)

    off = msgspec.structs.replace(weak, law=msgspec.structs.replace(weak.law, name="off"))
    # to see what it does
    refuse_unflyable(load_mission("configs/missions/paper.toml", off), is_simulated=True)
