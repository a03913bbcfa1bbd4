"""The slot owners of vehicles, when vehicles that stood in for others are silent."""

from __future__ import annotations

from groundstation.fleet import slot_owners
from groundstation.fleet import state as fleet_state
from groundstation.fleet.state import FleetState
from onboard.config.fleet import FleetConfig
from tests.groundstation.conftest import telemetry

SECOND = 1_000_000_000
DEAD_NS = 5 * SECOND  # when the first spare was heard last


def heard(state: FleetState, name: str, at_ns: int, **values: object) -> FleetState:
    """Return the state after a vehicle's telemetry."""
    message = telemetry(name, sequence=at_ns // SECOND, **values)
    return fleet_state.fold(state, message, at_ns)


def with_dead_spare(fleet: FleetConfig) -> FleetState:
    """mav1 stands in for mav2, which is disabled, and then nobody hears mav1 any more."""
    state = heard(fleet_state.initial(fleet), "mav2", SECOND, disabled_by="ada")
    return heard(state, "mav1", DEAD_NS, stands_in_for="mav2")


def test_a_silent_spare_keeps_its_slot_owner_until_another_vehicle_has_it(
    fleet: FleetConfig,
) -> None:
    state = heard(with_dead_spare(fleet), "mav0", 60 * SECOND)
    assert slot_owners.stand_ins(state) == {"mav2": "mav1"}
    assert slot_owners.out_of_service(state) == {"mav2"}
    assert slot_owners.unused_slot_owners(state) == {"mav1"}


def test_a_second_spare_has_the_slot_owner_of_a_silent_one(fleet: FleetConfig) -> None:
    # the dead one comes after the new one in the fleet file
    state = heard(with_dead_spare(fleet), "mav0", 60 * SECOND, stands_in_for="mav2")
    assert slot_owners.stand_ins(state) == {"mav2": "mav0"}
    assert slot_owners.slot_owner_of("mav0", state) == "mav2"
    assert slot_owners.vehicles_of_slots(["mav2"], state) == ("mav0",)
    assert slot_owners.out_of_service(state) == {"mav1", "mav2"}
    assert slot_owners.unused_slot_owners(state) == {"mav0", "mav1"}


def test_a_vehicle_uses_its_own_slots_again_after_its_spare_has_died(fleet: FleetConfig) -> None:
    state = heard(with_dead_spare(fleet), "mav2", DEAD_NS + 3 * SECOND)
    assert slot_owners.stand_ins(state) == {}
    assert slot_owners.out_of_service(state) == {"mav1"}
    assert slot_owners.unused_slot_owners(state) == {"mav1"}


def test_a_spare_that_falls_silent_in_the_air_keeps_its_slot(fleet: FleetConfig) -> None:
    state = with_dead_spare(fleet)
    state = heard(state, "mav1", DEAD_NS + SECOND, stands_in_for="mav2", is_airborne=True)
    state = heard(state, "mav2", DEAD_NS + 60 * SECOND)
    assert slot_owners.stand_ins(state) == {"mav2": "mav1"}
    assert slot_owners.out_of_service(state) == {"mav2"}


def test_a_vehicle_whose_agent_restarts_does_not_take_the_slots_from_its_spare(
    fleet: FleetConfig,
) -> None:
    state = heard(with_dead_spare(fleet), "mav2", DEAD_NS + SECOND)
    assert slot_owners.stand_ins(state) == {"mav2": "mav1"}
    assert slot_owners.out_of_service(state) == {"mav2"}
