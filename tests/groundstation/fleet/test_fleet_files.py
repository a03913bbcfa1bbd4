"""A vehicle with another fleet file than this ground's: told from one with this file, alarmed, not
flown, and brought down all the same.
"""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from groundstation.alarms.alarm_table import AlarmSeverity, GroundCondition
from groundstation.alarms.alarms import Alarms, conditions
from groundstation.client.client import FleetClient
from groundstation.fleet import state as fleet_state
from groundstation.fleet.fleet_files import has_other_file, with_other_file
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions.runner import MissionRun
from onboard.bus.schema import PathOrder, Telemetry
from onboard.config.fleet import FleetConfig
from onboard.exit_status import EXIT_FAILED
from tests.groundstation.conftest import telemetry

OTHER = "another file"


def told(fleet: FleetConfig, name: str = "mav0", **changes: Any) -> Telemetry:
    return telemetry(name, **{"config_hash": fleet.config_hash, **changes})


async def hear_other_file(client: FleetClient, bus: Any) -> None:
    """Let mav1 report another file, and the ground hear it."""
    bus.tell("mav1", config_hash=OTHER)

    def is_heard(state: fleet_state.FleetState) -> bool:
        heard = state.telemetry_of("mav1")
        return heard is not None and heard.config_hash == OTHER

    assert await client.wait_for(is_heard, 5.0)


def test_another_hash_is_another_file_and_a_law_of_its_own_is_none(fleet: FleetConfig) -> None:
    assert not has_other_file(told(fleet), fleet)
    assert has_other_file(told(fleet, config_hash=OTHER), fleet)

    under_paper = fleet.with_law("paper").config_hash
    assert not has_other_file(told(fleet, law="paper", config_hash=under_paper), fleet)
    assert has_other_file(told(fleet, law="paper", config_hash=OTHER), fleet)

    # a law that this ground would have to load counts as none
    assert not has_other_file(told(fleet, law="my_law:evade", config_hash=OTHER), fleet)


def test_a_value_of_the_file_is_enough_and_the_place_of_the_file_is_not(fleet: FleetConfig) -> None:
    wider = msgspec.structs.replace(
        fleet, fleet=msgspec.structs.replace(fleet.fleet, safety_distance_m=0.9)
    )
    assert has_other_file(told(wider), fleet)
    assert not has_other_file(told(msgspec.structs.replace(fleet, path="a copy.toml")), fleet)


def test_a_silent_vehicle_is_not_named(fleet: FleetConfig) -> None:
    state = fleet_state.initial(fleet)
    for name, sent_ns in (("mav0", 0), ("mav1", 5_000_000_000)):
        state = fleet_state.fold(state, told(fleet, name, config_hash=OTHER), sent_ns)
    assert with_other_file(state, state.vehicles, fleet, 5_000_000_000) == ("mav1",)


@pytest.mark.parametrize(
    ("changes", "severity"),
    [
        ({}, AlarmSeverity.WARNING),
        ({"is_armed": True}, AlarmSeverity.CRITICAL),
        ({"is_armed": True, "is_airborne": True}, AlarmSeverity.CRITICAL),
    ],
)
def test_it_raises_an_alarm_that_names_it_and_is_worse_in_flight(
    fleet: FleetConfig, changes: dict[str, Any], severity: AlarmSeverity
) -> None:
    heard = told(fleet, "mav1", config_hash=OTHER, position_enu_m=(0.0, 0.0, 1.0), **changes)
    state = fleet_state.fold(fleet_state.initial(fleet), heard, 0)
    alarms = Alarms(fleet)
    alarms.update(state, 0)
    (alarm,) = [
        line.alarm for line in alarms.lines if line.alarm.kind is GroundCondition.OTHER_FILE
    ]
    assert alarm.severity is severity
    assert alarm.sentence == "mav1: has another fleet file than this ground"
    assert alarm.advice.startswith("Others may fly that LAND ALL does not reach.")
    assert "covey check vehicles" in alarm.advice

    # the file of a record may have had another hash under the version that recorded it
    replayed = Alarms(fleet, is_replay=True)
    replayed.update(state, 0)
    assert all(line.alarm.kind is not GroundCondition.OTHER_FILE for line in replayed.lines)


@pytest.mark.parametrize("is_armed", [False, True])
def test_of_a_vehicle_out_of_service_it_is_alarmed_only_while_it_is_armed(
    fleet: FleetConfig, is_armed: bool
) -> None:
    heard = told(fleet, "mav1", config_hash=OTHER, disabled_by="ada", is_armed=is_armed)
    state = fleet_state.fold(fleet_state.initial(fleet), heard, 0)
    kinds = [alarm.kind for alarm in conditions(state, fleet, 0)]
    assert (GroundCondition.OTHER_FILE in kinds) is is_armed


@pytest.mark.parametrize(
    ("line", "is_sent"),
    [
        ("arm mav1", False),
        ("takeoff mav1 1.0", False),
        ("move mav1 0 0 1", False),
        ("goto mav1 0 0 1", False),
        ("formation triangle 0 0 1", False),
        ("rotate 30", False),
        ("yaw mav1 30", False),
        ("home mav1", False),
        ("bring home all", False),
        ("resume mav1", False),
        ("skip mav1", False),
        ("land mav1", True),
        ("hold mav1", True),
        ("pause mav1", True),
        ("kill mav1", True),
        ("disarm mav1", True),
        ("locate mav1", True),
        ("disable mav1", True),
    ],
)
async def test_it_gets_no_order_to_fly_and_those_that_need_no_spot(
    client: FleetClient, bus: Any, line: str, is_sent: bool
) -> None:
    for east_m, name in zip((-2.0, 0.0, 2.0), bus.vehicles, strict=True):
        here = (east_m, 0.0, 1.0)
        bus.tell(
            name,
            state="flying",
            is_airborne=True,
            position_enu_m=here,
            goal_position_enu_m=here,
        )
    await hear_other_file(client, bus)
    planned = client.plan(line)
    if is_sent:
        assert "mav1" in planned.orders, planned.refusals
        return
    assert planned.orders == {}, "with it nobody flies in an order for several"
    sentence = planned.refusals["mav1"]
    assert sentence.startswith("mav1 flies with another fleet file than this ground's: spots,")
    assert sentence.endswith(f"this ground's file is {client.fleet.path}.")


async def test_an_order_and_paths_that_were_planned_before_are_not_sent_either(
    client: FleetClient, bus: Any
) -> None:
    planned = client.plan("takeoff all 1.0")
    assert planned.orders.keys() == bus.vehicles.keys()
    await hear_other_file(client, bus)
    assert client.check_again(planned).orders == {}

    part = PathOrder(path_id="p", part=0, parts=1, data=b"")
    sent = client.order_paths("load_path", {"mav0": part, "mav1": part})
    assert sent.results["mav1"].phase == "refused"
    assert "another fleet file" in sent.results["mav1"].sentence
    assert sent.results["mav0"].phase == "sent"


async def test_a_mission_does_not_begin_with_it(
    fleet: FleetConfig, client: FleetClient, bus: Any
) -> None:
    bus.tell("mav1", config_hash=OTHER)
    steps = [{"do": "takeoff", "vehicles": "mav0"}, {"do": "land"}]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="test.toml", fleet=fleet)
    verdict = await MissionRun(mission, client).run()
    assert verdict.exit_status == EXIT_FAILED
    assert "mav1 flies with another fleet file than this ground's" in verdict.summary
    assert bus.orders == []


async def test_a_mission_with_a_formation_of_its_own_has_no_other_file(
    fleet: FleetConfig, client: FleetClient
) -> None:
    shape = {"shape": "line", "spacing_m": 1.5}
    mission = mission_from_mapping(
        {
            "schema": 1,
            "formations": {"triangle": shape},
            "step": [{"do": "takeoff"}, {"do": "land"}],
        },
        path="test.toml",
        fleet=fleet,
    )
    verdict = await MissionRun(mission, client).run()
    assert verdict.passed, verdict.summary
