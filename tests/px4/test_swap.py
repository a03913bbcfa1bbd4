"""Service between two flights of real PX4s by satellites, while agents and one ground go on: the
place of a vehicle goes to a spare, and the PX4s of the others start anew.
"""

from __future__ import annotations

import asyncio
import math
import re
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from groundstation import BlockingFleet
from groundstation.fleet.state import FleetState
from groundstation.missions.api import Fleet, OrderFailed
from groundstation.missions.mission_orders import MissionCall, MissionOrders
from groundstation.verdict.verdict import Verdict
from onboard.autopilot import Version
from onboard.config.fleet import FleetConfig
from tests.px4.build import Px4Build
from tests.px4.flight import Flight, standing, written
from tests.px4.table import Table

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]

_FLEET = Path(__file__).parents[2] / "configs/fleets/px4-sitl.toml"
_SPARE_ENU_M = [8.0, -4.0, 0.0]
_OFF_M = 3.0  # of a spare that was put down beside the spot
_SLOT_ENU_M = (2.6, 0.5)  # of mav2 in the formation
_MISSION = """
schema = 1
fleet = "fleet.toml"
[[step]]
do = "takeoff"
height_m = 2.5
timeout_s = 60
[[step]]
do = "formation"
name = "triangle"
position_enu_m = [0.0, 2.0, 2.5]
timeout_s = 90
[[step]]
do = "home"
timeout_s = 120
[expect]
min_separation_m = 1.20
arrived_within_m = 1.2
all_landed = true
[on_failure]
do = "land"
"""
_PROMISE_M = 1.20
_AT_SLOT_M = 1.2
_AT_SPOT_M = 0.9  # satellites err by 0.3 m, and for seconds by more
_READY_S = 90.0
_ANSWER_S = 5.0


def _with_a_spare(
    count: int, folder: Path, instances: list[int], version: Version | None
) -> FleetConfig:
    """Write the fleet file of configs/fleets/px4-sitl.toml with a spare, mav3, in no formation."""
    data = tomllib.loads(_FLEET.read_text(encoding="utf-8"))
    if version == (1, 18):
        data["defaults"]["type"] = "sih118"
    data["vehicles"]["mav3"] = {
        "start_enu_m": _SPARE_ENU_M,
        "agent": "tcp/127.0.0.1:7463",
        "autopilot": "udpin://127.0.0.1:14543",
        "direct": "udpout://127.0.0.1:18573",
        "enabled": "scan",
    }
    assert len(data["vehicles"]) == count
    for table, number in zip(data["vehicles"].values(), instances, strict=True):
        table["system_id"] = number + 1
    return written(data, folder, instances)


def _fly(ground: BlockingFleet, mission: Path) -> Verdict:
    """Fly a mission by the order of that name, which the console and the live page take as well."""

    async def fly(fleet: Fleet) -> Verdict:
        flown: list[asyncio.Task[object]] = []

        def begin(call: MissionCall, _: object) -> bool:
            flown.append(asyncio.ensure_future(call()))
            return True

        refusal = MissionOrders(fleet.client, begin).take(["mission", str(mission)])
        assert not refusal, refusal
        verdict = await flown[0]
        assert isinstance(verdict, Verdict)
        return verdict

    return ground.run(fly)


def _is_heard(state: FleetState) -> bool:
    return state.vehicles["mav3"].telemetry is not None


def _is_placed(state: FleetState) -> bool:
    telemetry = state.vehicles["mav3"].telemetry
    return telemetry is not None and telemetry.is_position_valid


def _is_nowhere(state: FleetState) -> bool:
    return not _is_placed(state)


def _put_down_spare(
    flight: Flight, ground: BlockingFleet, place_enu_m: tuple[float, float]
) -> None:
    """Start the spare's PX4 at a place, and wait until the ground hears where it is.

    It is off until the ground has no place of it: nothing is said of the place of before.
    """
    assert ground.run(lambda fleet: fleet.client.wait_for(_is_nowhere, _READY_S))
    flight.start_px4("mav3", place_enu_m)
    assert ground.run(lambda fleet: fleet.client.wait_for(_is_placed, _READY_S))


def _restart(flight: Flight, ground: BlockingFleet, *names: str) -> None:
    """Order a reboot. A PX4 that is simulated refuses it, and starts anew by hand meanwhile."""

    def is_taken(state: FleetState) -> bool:
        told = [state.vehicles[name].telemetry for name in names]
        return all(one is not None and one.taken_order_kind == "reboot" for one in told)

    with ThreadPoolExecutor(1) as beside:
        rebooted = beside.submit(ground.reboot, names)
        assert ground.run(lambda fleet: fleet.client.wait_for(is_taken, _ANSWER_S))
        for name in names:
            flight.stop_px4(name)
        for name in names:
            flight.start_px4(name)
        results = rebooted.result()
    assert all(result.is_done for result in results.values()), results


def _refusal(ground: BlockingFleet) -> str:
    """Order the swap, and return why it is refused."""
    with pytest.raises(OrderFailed) as refused:
        ground.swap("mav2", "mav3")
    assert {result.phase for result in refused.value.results.values()} == {"refused"}
    return str(refused.value)


def test_a_spare_flies_at_the_place_of_a_vehicle_that_was_carried_away(
    build: Px4Build, table: Table, tmp_path: Path
) -> None:
    """Refused while mav2 is on its spot, and while the spare is beside it."""
    mission = tmp_path / "mission.toml"
    mission.write_text(_MISSION, encoding="utf-8")
    (tmp_path / "cut").touch()  # truth is wanted here, and no poses
    with (
        standing(build, 4, tmp_path, _with_a_spare, switched_off=["mav3"]) as flight,
        BlockingFleet(flight.fleet, ready_timeout_s=0.0) as ground,
    ):
        spots = {name: vehicle.start_enu_m for name, vehicle in flight.fleet.vehicles.items()}
        east_m, north_m, _ = spots["mav2"]

        assert ground.run(lambda fleet: fleet.client.wait_for(_is_heard, _READY_S))
        ground.disable("mav3")
        ground.ready(_READY_S)
        before = _fly(ground, mission)
        assert before.passed, before.sentences
        assert "mav2 still stands on the spot" in _refusal(ground)

        flight.stop_px4("mav2")
        _put_down_spare(flight, ground, (east_m, north_m - _OFF_M))
        assert re.search(r"mav3 stands [23]\.\d m from the spot of mav2", _refusal(ground))

        flight.stop_px4("mav3")
        _put_down_spare(flight, ground, (east_m, north_m))
        ground.swap("mav2", "mav3")
        _restart(flight, ground, "mav0", "mav1")
        ground.ready(_READY_S)
        after = _fly(ground, mission)

        tracks = flight.tracks()
        at_slot_m = min(math.dist(place, _SLOT_ENU_M) for place in tracks["mav3"][:, 1:3])
        from_spots_m = {
            name: math.dist(tracks[name][-1, 1:3], spots[place][:2])
            for name, place in {"mav0": "mav0", "mav1": "mav1", "mav3": "mav2"}.items()
        }
        closest_m = flight.closest_m()
        worst_m = max(from_spots_m.values())
        table.add(
            "two flights by satellites, and service between them: a spare has the place of mav2, "
            "the PX4s of the others start anew",
            f"refused while mav2 was there and while the spare was {_OFF_M:g} m off; closest "
            f"{closest_m:.2f} m; down {worst_m:.2f} m from the spots at most, the spare "
            f"{from_spots_m['mav3']:.2f} m from that of mav2",
        )
        assert after.passed, after.sentences
        assert {arrival.vehicle for arrival in after.arrivals} == {"mav0", "mav1", "mav3"}
        assert at_slot_m < _AT_SLOT_M
        assert closest_m >= _PROMISE_M
        assert worst_m < _AT_SPOT_M, from_spots_m
