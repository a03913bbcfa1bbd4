"""Settings of a simulated flight that its end came before."""

from __future__ import annotations

from groundstation.flights.simulation_settings import SimulationSettings
from sitl.lockstep.simulated_flight import never_happened


def test_what_was_planned_for_after_the_end_is_said() -> None:
    settings = SimulationSettings(
        faults=("mav1 motor_weak at=12", "mav0 motor_weak at=90"),
        orders=("3 hold all", "40.5 land all"),
        changes=("200 wind=3,0",),
    )
    assert never_happened(settings, 40.0) == [
        "The fault 'mav0 motor_weak at=90' never happened: the flight ended at 40.0 s.",
        "The order '40.5 land all' never happened: the flight ended at 40.0 s.",
        "The change '200 wind=3,0' never happened: the flight ended at 40.0 s.",
    ]
    assert never_happened(settings, 300.0) == []
