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

from pathlib import Path

from groundstation.commands.fly import fly_mission
from groundstation.commands.parameters import BusOptions, File, FlightOptions
from onboard.config.fleet import ConfigError

_OPTIONS, _BUS = FlightOptions(), BusOptions()


def demo(*, mission: File | None = None, options: FlightOptions = _OPTIONS, bus: BusOptions = _BUS) -> int:
    """Fly the paper's experiment: emulator, agents and console of three weak drones, on free ports.

    Args:
        mission: fly this mission instead
    """
    path = mission or str(_configs() / "missions" / "paper.toml")
    return fly_mission(path, options, bus, is_simulated=True, has_free_ports=True)


def _configs() -> Path:
    folder = Path(__file__).resolve().parents[2] / "configs"
    if not folder.is_dir():
        raise ConfigError(f"{folder}: the example configurations are missing. Run this from a clone, or use covey fly.")
    return folder
