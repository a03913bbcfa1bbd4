"""``covey fly --lockstep`` and ``covey demo --lockstep``: a mission in simulated time."""

from __future__ import annotations

import time
from pathlib import Path

from groundstation.flights.left_tasks import leave_process
from groundstation.flights.simulation_settings import SimulationSettings
from groundstation.mission_files.mission import Mission
from groundstation.missions.lasting_output import lasting_output, termination_signals_as_ctrl_c
from onboard.bus.schema import Event
from onboard.plain_text import listed
from sitl.lockstep.reflight import record_digests
from sitl.lockstep.simulated_flight import (
    longest_stay_s,
    never_happened,
    open_flight,
)


@lasting_output()
def fly_mission(mission: Mission, folder: Path, simulation: SimulationSettings) -> int:
    """Fly a mission and print its progress; return the exit status of its verdict.

    Args:
        mission: a mission that has passed the checks.
        folder: the folder of the record.
        simulation: seed, weather, faults, orders of another ground, and quality of the bus.

    Raises:
        ConfigError: a fault or an order is impossible.
    """
    names = listed(mission.fleet.enabled_names)
    print(
        f"Lockstep: {names} in simulated time, without a console; everything goes to {folder}.",
        flush=True,
    )

    with termination_signals_as_ctrl_c(), open_flight(mission.fleet, simulation, folder) as flight:
        begin_s = time.perf_counter()
        record_digests(flight)

        def say(line: str) -> None:
            print(f"{flight.time_s:6.1f} s  {line}", flush=True)

        def on_event(event: Event) -> None:
            if event.severity in ("warning", "critical"):
                say(f"  [{event.vehicle}] {event.severity}: {event.sentence}")

        flight.say = say
        flight.client.add_event_listener(on_event)

        verdict = flight.fly(mission, stays=True, longest_stay_s=longest_stay_s(simulation))

        for line in verdict.sentences:
            say(line)
        for line in never_happened(simulation, flight.time_s):
            say(line)

        wall_s = time.perf_counter() - begin_s
        print(
            f"{flight.time_s:.1f} s flown in {wall_s:.1f} s: "
            f"{flight.time_s / wall_s:.1f} times real time.",
            flush=True,
        )

    if flight.has_stubborn_tasks:
        leave_process(verdict.exit_status)
    return verdict.exit_status
