"""A fault of a source that a vehicle does not have is refused in a flight of Covey's."""

from __future__ import annotations

import msgspec
import pytest

from groundstation.cli import main
from onboard.bus.schema import FaultOrder
from onboard.config.fleet import CorrectionsConfig, FleetConfig, load_fleet
from sitl.bus_messages import answer_fault
from sitl.faults.catalogue import Fault, FaultError, check, parse
from sitl.fleet_emulator import emulator_of
from sitl.fleet_faults import refuse_absent_source
from sitl.lockstep.simulation import Simulation

MOCAP, VISION, GPS = "mav0", "mav1", "mav2"


@pytest.fixture
def mixed() -> FleetConfig:
    """Return a fleet whose vehicles fly by mocap, by vision and by satellites."""
    fleet = load_fleet("paper")
    changes = {
        VISION: {"mocap_required": False, "px4_position": "vision", "mocap_body": ""},
        GPS: {"mocap_required": False, "px4_position": "gps", "mocap_body": ""},
    }
    return _changed(fleet, changes)


def _changed(fleet: FleetConfig, changes: dict[str, dict[str, object]]) -> FleetConfig:
    vehicles = {
        name: msgspec.structs.replace(vehicle, **changes.get(name, {}))
        for name, vehicle in fleet.vehicles.items()
    }
    return msgspec.structs.replace(fleet, vehicles=vehicles)


def checked(line: str, fleet: FleetConfig) -> Fault:
    return check(parse(line), fleet.enabled_names)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"{GPS} vision_lost", "mav2 flies by satellites, and its PX4 hears no external position"),
        (f"{VISION} vision_swapped other={GPS}", "mav2 flies by satellites"),
        (f"{MOCAP} gps_loss", "mav0 flies by mocap, and its PX4 uses no satellites"),
        (f"{VISION} gps_drift", "mav1 flies by vision, and its PX4 uses no satellites"),
        (f"{GPS} rtk_lost", "its receiver gets no corrections"),
        (f"{GPS} corrections_lost", "its receiver gets no corrections"),
        (f"{GPS} base_moved", "the fleet has no corrections"),
        (f"{VISION} mocap_lost", "nobody hears a mocap body of it"),
        (f"{VISION} mocap_swapped other={GPS}", "nobody hears a mocap body of it"),
    ],
)
def test_a_fault_of_a_source_that_is_not_there_is_refused(
    mixed: FleetConfig, line: str, words: str
) -> None:
    with pytest.raises(FaultError, match="would break nothing") as refused:
        refuse_absent_source(checked(line, mixed), mixed)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    "line",
    [
        f"{MOCAP} vision_lost",  # its PX4 hears the poses of the mocap
        f"{VISION} vision_swapped other={MOCAP}",
        f"{GPS} gps_late",
        f"{MOCAP} mocap_lost",
        f"{VISION} mocap_swapped other={MOCAP}",  # the other has a body
        f"{GPS} motor_weak motor=1",
        f"{GPS} link_loss",
    ],
)
def test_a_fault_of_a_source_that_is_there_is_taken(mixed: FleetConfig, line: str) -> None:
    refuse_absent_source(checked(line, mixed), mixed)


def test_a_body_that_neighbours_watch_and_satellites_beside_a_mocap_can_break(
    mixed: FleetConfig,
) -> None:
    changes: dict[str, dict[str, object]] = {
        VISION: {"mocap_body": "seen"},
        MOCAP: {"px4_params": {"EKF2_GPS_CTRL": 7}},
    }
    fleet = _changed(mixed, changes)
    refuse_absent_source(checked(f"{VISION} mocap_lost", fleet), fleet)
    refuse_absent_source(checked(f"{MOCAP} gps_loss", fleet), fleet)


def test_corrections_can_break_where_a_fleet_has_them(mixed: FleetConfig) -> None:
    fleet = msgspec.structs.replace(mixed, corrections=CorrectionsConfig(source="mock"))
    refuse_absent_source(checked(f"{GPS} rtk_lost", fleet), fleet)
    refuse_absent_source(checked(f"{MOCAP} base_moved", fleet), fleet)
    with pytest.raises(FaultError, match="gets no corrections"):
        refuse_absent_source(checked(f"{MOCAP} rtk_lost", fleet), fleet)


@pytest.mark.parametrize("is_rehearsal", [True, False])
def test_an_order_on_the_bus_is_refused_and_nothing_is_planned(
    mixed: FleetConfig, is_rehearsal: bool
) -> None:
    emulator = emulator_of(mixed, list(mixed.vehicles.values()), seed=0)
    order = FaultOrder(
        order_id="1",
        author="test",
        stamp_ns=0,
        vehicle=VISION,
        fault="gps_loss",
        parameters={},
        is_rehearsal=is_rehearsal,
    )
    reply = answer_fault(emulator, mixed, order)
    assert not reply.is_accepted
    assert "its PX4 uses no satellites" in reply.reason
    assert emulator.disturbances.plan.next_s == float("inf")


def test_a_flight_in_lockstep_refuses_it_before_it_begins(mixed: FleetConfig) -> None:
    simulation = Simulation(mixed, is_compiled=False)
    with pytest.raises(FaultError, match="its PX4 uses no satellites"):
        simulation.inject(Fault("gps_loss", MOCAP, at_s=20.0))
    assert simulation.emulator.disturbances.plan.next_s == float("inf")


def test_a_flight_on_the_command_line_refuses_it_as_wrong_input(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["fly", "paper", "--lockstep", "--fault", "mav1 gps_loss at=14"]) == 2
    assert "gps_loss would break nothing: mav1 flies by mocap" in capsys.readouterr().err
