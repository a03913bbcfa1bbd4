"""A vehicle that stands in for another one has that one's place; otherwise it says why not."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from onboard import agent_inputs
from onboard.bus.schema import Telemetry
from onboard.config.fleet import FleetConfig, Origin, fleet_from_mapping
from onboard.config.stand_in import stand_in_refusal
from tests.onboard.agent.rig import Rig, hovering_rig, ready_rig

ON_SPOT = (0.1, 0.0, 0.0)  # of mav0 of `two`


def told(rig: Rig) -> Telemetry:
    assert rig.telemetry is not None
    return rig.telemetry


def carried() -> Rig:
    """A vehicle that was carried to the spot of mav1."""
    rig = Rig()
    rig.carry(1.4, 0.0, 0.0)
    rig.run(3.0)
    return rig


def test_a_spare_on_the_spot_of_another_vehicle_takes_its_place() -> None:
    rig = carried()
    assert "on the take-off spot of mav1" in " ".join(told(rig).not_ready)

    rig.order("disable", order_id="off")
    assert rig.order("stand_in", order_id="swap", stands_in_for="mav1").is_accepted
    rig.run(1.5)
    assert rig.outcomes()["swap"] == "done"
    assert told(rig).stands_in_for == "mav1"
    assert not told(rig).disabled_by
    assert not told(rig).not_ready

    # and back, once it stands there
    away = rig.order("stand_in", stands_in_for="mav0")
    assert "mav0 stands 1.4 m from its own spot" in away.reason
    rig.carry(0.0, 0.0, 0.0)
    rig.run(3.0)
    assert rig.order("stand_in", stands_in_for="mav0").is_accepted
    rig.run(0.3)
    assert told(rig).stands_in_for == ""


def test_a_vehicle_away_from_the_spot_or_of_no_known_place_is_refused() -> None:
    rig = ready_rig()
    away = rig.order("stand_in", stands_in_for="mav1")
    assert not away.is_accepted
    assert "mav0 stands 1.5 m from the spot of mav1" in away.reason
    unknown = rig.order("stand_in", stands_in_for="mav9")
    assert not unknown.is_accepted
    assert "mav9 is not a vehicle of fleet 'rig'" in unknown.reason


def test_a_vehicle_in_the_air_stands_in_for_nobody() -> None:
    reply = hovering_rig().order("stand_in", stands_in_for="mav1")
    assert not reply.is_accepted
    assert "on the ground only, disarmed: it is flying" in reply.reason


def test_a_neighbour_that_stands_in_for_nobody_of_the_fleet_disturbs_no_preflight() -> None:
    rig = ready_rig()
    lie = replace(told(rig), vehicle="mav1", boot_id=3, stands_in_for="../etc")
    rig.core.handle(agent_inputs.NeighbourReceived(lie, rig.now_ns), rig.now_ns)
    rig.run(1.0)
    assert not told(rig).not_ready
    assert not any("Internal error" in event.sentence for event in rig.events)


def two(**of_spare: object) -> FleetConfig:
    """Return a fleet whose spare has values of its own."""
    common = {"agent": "tcp/127.0.0.1:7460", "autopilot": "udpin://127.0.0.1:14540"}
    other = {"agent": "tcp/127.0.0.1:7461", "autopilot": "udpin://127.0.0.1:14541"}
    geofence_m = {"x": [-4.0, 4.0], "y": [-4.0, 4.0], "z": [0.0, 3.0]}
    return fleet_from_mapping(
        {
            "schema": 1,
            "fleet": {"name": "two", "geofence_m": geofence_m},
            "vehicles": {
                "mav0": {"system_id": 1, "start_enu_m": [0, 0, 0], "hover_time_s": 600} | common,
                "mav1": {"system_id": 2, "start_enu_m": [2, 0, 0]} | other | of_spare,
            },
        }
    )


@pytest.mark.parametrize(
    ("of_spare", "words"),
    [
        ({"max_speed_m_s": 0.8}, "its max_speed_m_s is 0.8 m/s, and the mission was checked with"),
        ({"max_acceleration_m_s2": 1.0}, "its max_acceleration_m_s2 is 1 m/s²"),
        ({"max_tilt_deg": 20.0}, "its max_tilt_deg is 20 °"),
        (
            {"hover_time_s": 300.0},
            "its hover_time_s is 300 s, and the mission was checked with",
        ),
        ({"mocap_required": False}, "one flies by the mocap, and the other one does not"),
        ({"max_speed_m_s": 2.0, "mass_kg": 0.6}, ""),
    ],
)
def test_a_spare_has_to_do_what_the_mission_was_checked_with(
    of_spare: dict[str, object], words: str
) -> None:
    sentence = stand_in_refusal(two(**of_spare), "mav1", "mav0", ON_SPOT)
    assert words in sentence
    assert bool(sentence) == bool(words)


@pytest.mark.parametrize(
    ("by_mocap", "spot_m", "words"),
    [
        (False, 0.1, ""),
        (False, 0.11, "its own spot, which the fleet file puts at 0 m, and the spot of mav0 lies"),
        (False, -5.0, "lies at -5 m. Write that height there: vehicles.mav1.start_enu_m"),
        (True, 5.0, ""),
    ],
)
def test_a_spare_without_mocap_has_a_spot_of_the_same_height(
    by_mocap: bool, spot_m: float, words: str
) -> None:
    fleet = two()
    on_earth = replace(fleet.fleet, origin=Origin(47.0, 8.0, 400.0))
    vehicles = {
        name: replace(vehicle, mocap_required=by_mocap) for name, vehicle in fleet.vehicles.items()
    }
    vehicles["mav0"] = replace(vehicles["mav0"], start_enu_m=(0.0, 0.0, spot_m))
    fleet = replace(fleet, fleet=on_earth, vehicles=vehicles)

    sentence = stand_in_refusal(fleet, "mav1", "mav0", ON_SPOT)

    assert words in sentence
    assert bool(sentence) == bool(words)


def test_a_spare_by_vision_needs_its_own_spot_in_a_fleet_with_an_origin_too() -> None:
    fleet = two()
    on_earth = replace(fleet.fleet, origin=Origin(47.0, 8.0, 400.0))
    vehicles = {
        name: replace(vehicle, mocap_required=False, px4_position="vision")
        for name, vehicle in fleet.vehicles.items()
    }
    fleet = replace(fleet, fleet=on_earth, vehicles=vehicles)
    assert "its frame begins where the fleet file says" in str(
        stand_in_refusal(fleet, "mav1", "mav0", ON_SPOT)
    )
