"""``covey demo``: the paper's experiment in simulation.

Examples:
  covey demo
  covey demo --law off
  covey demo --headless --record flights/first
  covey demo --lockstep --bus-loss 0.1

Exit status: 0 all came true; 1 an expectation failed; 2 wrong input, nothing started; 130 interrupted. Ctrl-C lands;
a second one ends the processes that were started.
"""

from __future__ import annotations

from groundstation.commands.fly import fly_mission
from groundstation.commands.parameters import BusOptions, File, FlightOptions

_OPTIONS, _BUS = FlightOptions(), BusOptions()


def demo(*, mission: File | None = None, options: FlightOptions = _OPTIONS, bus: BusOptions = _BUS) -> int:
    """Fly the paper's experiment: emulator, agents and console of three weak drones, on free ports.

    Args:
        mission: fly this mission instead
    """
    return fly_mission(mission or "paper", options, bus, is_simulated=True, has_free_ports=True)
