"""Missions in lockstep: repeatable byte by byte, with the record, figures, verdict and status of a
real flight.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import math
import tomllib
import zlib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from groundstation import cli
from groundstation.shows.gallery import ACCIDENTS, GALLERY
from groundstation.verdict.verdict import Verdict
from sitl.lockstep.flight import Lockstep
from tests.groundstation.recorded import read

ROOT = Path(__file__).resolve().parents[3]
CONFIGS = ROOT / "configs"
# test_gallery flies them
IN_GALLERY = [CONFIGS / "missions" / f"{name}.toml" for name in GALLERY if name != "paper"]
# test_accidents flies them: without their defence somebody is harmed
OF_ACCIDENTS = [CONFIGS / "missions" / f"{name}.toml" for name in ACCIDENTS]
FLOWN = {
    Path(tomllib.loads(path.read_text())["fleet"]).stem for path in IN_GALLERY if path.exists()
} - {"paper", "sih"}
FLEETS = [path for path in sorted((CONFIGS / "fleets").glob("*.toml")) if path.stem not in FLOWN]


def _hash(folder: Path) -> str:
    return hashlib.sha256((folder / "flight.mcap").read_bytes()).hexdigest()


def _agents(folder: Path) -> list[tuple[str, int, dict]]:
    """Everything that agents said, whatever the order in the file."""
    return [
        (s.channel, s.stamp_ns, s.values)
        for s in read(folder, ("state", "tick", "telemetry", "event"))
    ]


def _flat(value: Any) -> list:
    """All numbers and words of a message in their order; words become numbers that are equal only
    for equal words.
    """
    if isinstance(value, dict):
        return [leaf for key in value for leaf in _flat(value[key])]
    if isinstance(value, list):
        return [leaf for item in value for leaf in _flat(item)]
    if isinstance(value, str):
        return [float(zlib.crc32(value.encode()))]
    if value is None:
        return [math.nan]
    return [float(value)]


@pytest.fixture(scope="module")
def flown(hop, tmp_path_factory) -> Path:
    """The folder of a hop with seed 3."""
    folder = tmp_path_factory.mktemp("hop")
    with Lockstep(hop.fleet, seed=3, folder=folder) as flight:
        assert flight.fly(hop).passed
    return folder


@pytest.mark.long
def test_a_repeated_flight_has_the_same_record_byte_by_byte(lockstep, hop, flown, tmp_path):
    assert lockstep(hop.fleet, seed=3, folder=tmp_path).fly(hop).passed
    assert _hash(tmp_path) == _hash(flown)


def test_another_seed_has_another_record(lockstep, hop, tmp_path):
    for seed in (3, 4):
        flight = lockstep(hop.fleet, seed=seed, folder=tmp_path / str(seed))
        flight.run(1.0)
        flight.close()
    assert _hash(tmp_path / "3") != _hash(tmp_path / "4")


@pytest.mark.long
def test_a_repeated_flight_over_a_bad_bus_has_the_same_record(lockstep, hop, tmp_path):
    from sitl.lockstep.connections import BusSettings

    bus = BusSettings(delay_s=0.003, jitter_s=0.004, loss=0.1, reorder=0.05, duplicate=0.05)
    for name in ("one", "two"):
        verdict = lockstep(hop.fleet, seed=1, bus=bus, folder=tmp_path / name).fly(hop)
        # an order that was sent again twice may have gone the direct way: its mission then fails,
        # but all land
        assert all(verdict.landed.values())
        assert not verdict.is_collision
    assert _hash(tmp_path / "one") == _hash(tmp_path / "two")


@pytest.mark.long
def test_interpreted_and_pipeline_rowss_fly_the_same(lockstep, hop, flown, tmp_path):
    lockstep(hop.fleet, seed=3, folder=tmp_path, is_compiled=False).fly(hop)
    for one, other in zip(_agents(flown), _agents(tmp_path), strict=True):
        assert one[:2] == other[:2]
        # which add up
        np.testing.assert_allclose(_flat(one[2]), _flat(other[2]), rtol=5e-10, atol=5e-10)


@pytest.mark.long
def test_the_fixture_takes_three_lines(lockstep):
    flight = lockstep(CONFIGS / "fleets" / "paper.toml", seed=3)
    assert flight.fly(CONFIGS / "missions" / "paper.toml").passed
    assert flight.min_separation_m > 0.8


@pytest.mark.long
def test_a_flight_can_be_flown_by_hand(lockstep):
    flight = lockstep(CONFIGS / "fleets" / "sih.toml", seed=1)
    flight.takeoff(1.0)
    assert flight.order("move mav1 0 0.5 1.0")["mav1"].phase == "done"
    before_s = flight.time_s
    flight.run(1.5)
    assert flight.time_s == pytest.approx(before_s + 1.5, abs=0.005)
    view = flight.state.vehicles["mav1"]
    assert view.truth is not None
    assert view.truth.position_enu_m == pytest.approx((0.0, 0.5, 1.0), abs=0.1)
    assert all(result.is_done for result in flight.land().values())


@pytest.mark.long
@pytest.mark.parametrize("fleet", FLEETS, ids=[path.stem for path in FLEETS])
def test_every_shipped_fleet_flies_a_shipped_mission_and_every_mission_is_flown_by_its_own_fleet(
    fleet, tmp_path, capsys
):
    from groundstation.mission_files.loading import load_mission
    from onboard.config.fleet import ConfigError, load_fleet

    fitting = []
    own = []
    flown_elsewhere = {*IN_GALLERY, *OF_ACCIDENTS}
    for path in sorted({*(CONFIGS / "missions").glob("*.toml")} - flown_elsewhere):
        try:
            mission = load_mission(path, load_fleet(fleet))
            config = load_fleet(fleet)
        except ConfigError:
            continue
        has_mocap = all(vehicle.mocap_required for vehicle in config.vehicles.values())
        if not has_mocap and (mission.expect.arrived_within_m or 1.0) < 0.5:
            continue  # satellites do not tell that well
        fitting.append(path)
        if Path(load_mission(path).fleet.path).stem == fleet.stem:
            own.append(path)
    assert fitting
    for path in own or fitting[:1]:
        folder = tmp_path / path.stem
        status = cli.main(
            ["fly", str(path), "--fleet", str(fleet), "--lockstep", "--record", str(folder)]
        )
        assert status == 0, capsys.readouterr().out


@pytest.mark.long
@pytest.mark.parametrize("seed", range(6))
def test_the_papers_law_keeps_the_papers_distance_where_its_assumptions_hold(lockstep, seed):
    flight = lockstep(CONFIGS / "fleets/ideal.toml", seed=seed)
    verdict = flight.fly(CONFIGS / "missions/paper.toml")
    assert verdict.passed
    assert flight.min_separation_m > 0.80


@pytest.mark.long
def test_the_folder_is_that_of_a_real_flight(hop, tmp_path, capsys):
    mission = tmp_path / "hop.py"
    mission.write_text(
        f'FLEET = "{CONFIGS}/fleets/paper.toml"\n'
        'EXPECT = {"min_separation_m": 0.8, "all_landed": True}\n'
        "async def mission(fleet):\n"
        "    await fleet.takeoff(0.6)\n"
        "    await fleet['mav1'].move((0.0, -0.7, 0.6))\n"
        "    await fleet.wait(0.5)\n"
        "    await fleet.land()\n"
    )
    folder = tmp_path / "flight"
    assert (
        cli.main(["fly", str(mission), "--lockstep", "--record", str(folder), "--seed", "5"]) == 0
    )
    assert {path.name for path in folder.iterdir()} >= {
        "flight.mcap",
        "events.txt",
        "orders.txt",
        "fleet.toml",
        "mission.py",
        "verdict.json",
    }
    verdict = json.loads((folder / "verdict.json").read_text())
    assert set(verdict) == set(Verdict.__struct_fields__)
    whole = msgspec.convert(verdict, Verdict)
    assert whole.passed
    assert whole.closest is not None
    assert whole.closest.source == "truth"
    assert set(whole.loop) == {"mav0", "mav1", "mav2"}
    assert {step.step.split()[0] for step in whole.steps} == {"takeoff", "move", "land"}
    channels = {sample.channel for sample in read(folder)}
    kinds = ("state", "telemetry", "tick", "mocap", "truth", "event", "order", "reply")
    assert {f"{kind}/mav1" for kind in kinds} <= channels
    assert "times real time" in capsys.readouterr().out
    assert cli.main(["plot", str(folder)]) == 0


@pytest.mark.long
def test_without_the_law_they_collide_and_the_exit_status_says_so(tmp_path, capsys):
    words = ["demo", "--lockstep", "--law", "off", "--record", str(tmp_path / "off")]
    assert cli.main(words) == 1
    assert "COLLIDED" in capsys.readouterr().out


def test_wrong_input_is_refused_before_anything_starts(tmp_path, capsys):
    assert cli.main(["demo", "--headless", "--bus-loss", "0.1"]) == 2
    assert "--lockstep" in capsys.readouterr().err
    assert (
        cli.main(["demo", "--lockstep", "--bus-loss", "1.5", "--record", str(tmp_path / "x")]) == 2
    )
    assert "between 0 and 1" in capsys.readouterr().err
    assert cli.main(["fly", str(tmp_path / "none.toml"), "--lockstep"]) == 2


@pytest.mark.long
def test_an_operator_who_lands_all_during_a_mission_sees_that_order_done_and_not_replaced(
    lockstep, hop
):
    flight = lockstep(hop.fleet, seed=1)
    handles = []

    async def land_all() -> None:
        handles.append(await flight.client.submit("land all"))

    flight.at(10.0, lambda: asyncio.ensure_future(land_all()))
    assert flight.fly(hop).exit_status == 1  # the mission did not come to its end
    assert {result.phase for result in handles[0].results.values()} == {"done"}
