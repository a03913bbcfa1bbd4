"""Pilots and other grounds that take vehicles from a mission, at chosen moments of a flight."""

from __future__ import annotations

from collections.abc import Callable

from groundstation.client.client import FleetClient
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission import Mission
from onboard.config.fleet import FleetConfig
from onboard.flight.types import FlightStep
from sitl.faults.catalogue import Fault
from sitl.lockstep.flight import Lockstep

# moment of a flight -> steps of mav1 in which it is, and how long it has been in one of them [s]
MOMENTS: dict[str, tuple[tuple[FlightStep, ...], float]] = {
    "climb": ((FlightStep.CLIMB,), 0.5),
    "crossing": ((FlightStep.LEG,), 1.5),
    "hover": ((FlightStep.ARRIVED, FlightStep.HOLDING), 1.0),
    "landing": ((FlightStep.DESCENT,), 0.6),
}
_LOOK_S = 0.02


def crossing(fleet: FleetConfig, **more: object) -> Mission:
    """Up, a step aside in formation, two seconds of rest, and down."""
    values: dict[str, object] = {
        "schema": 1,
        "step": [
            {"do": "takeoff", "height_m": 1.0},
            {"do": "formation", "name": "triangle", "position_enu_m": [0.0, 1.2, 1.0]},
            {"do": "wait", "duration_s": 3.0},
            {"do": "land"},
        ],
        **more,
    }
    return mission_from_mapping(values, path="crossing.toml", fleet=fleet)


def second_ground(
    flight: Lockstep, author: str = "ada", fleet: FleetConfig | None = None
) -> FleetClient:
    """Another ground, of another person, who does not operate yet; perhaps with another file."""
    client = FleetClient(
        flight.config if fleet is None else fleet,
        author=author,
        operates=False,
        bus=flight.simulation.bus.node("ground-2"),
        clock_ns=flight.simulation.clock_ns,
    )
    flight.wait_for(client.start())
    return client


def at_moment(flight: Lockstep, moment: str, act: Callable[[], object], name: str = "mav1") -> None:
    """Act once, as soon as a vehicle's flight is in a moment of ``MOMENTS``."""
    steps, since_s = MOMENTS[moment]

    def look() -> None:
        context = flight.agents[name].core.flight
        in_step_s = (flight.simulation.now_ns - context.step_ns) * 1e-9
        has_moved = moment != "hover" or context.leg_count > 0
        if context.step in steps and in_step_s >= since_s and has_moved:
            act()
        else:
            flight.at(flight.time_s + _LOOK_S, look)

    flight.at(flight.time_s + _LOOK_S, look)


def pilot_takes(
    flight: Lockstep, mode: str = "posctl", sticks: str = "heard", name: str = "mav1"
) -> None:
    """Let a pilot take a vehicle now, for good."""
    parameters: dict[str, float | str] = {"mode": mode, "sticks": sticks}
    flight.inject(Fault("pilot", name, at_s=flight.time_s, parameters=parameters))


def landings_by_command(flight: Lockstep, name: str = "mav1") -> list[float]:
    """Return a list that gets the times at which an agent commands its PX4 to land [s]."""
    link = flight.agents[name].link
    land = link.land
    times_s: list[float] = []

    def noted() -> None:
        times_s.append(flight.time_s)
        land()

    link.land = noted  # type: ignore[method-assign]
    return times_s
