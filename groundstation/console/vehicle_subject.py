"""The vehicle that a page shows, with everything that its blocks are drawn from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from groundstation.alarms.alarms import AlarmLine
from groundstation.fleet.state import FleetState, VehicleView
from onboard.bus.schema import Telemetry, TickSample
from onboard.config.fleet import FleetConfig

Text = list[tuple[str, str]]  # pieces and their colours
_FRESH_S = 2.0


@dataclass(frozen=True, slots=True)
class VehicleSubject:
    """One vehicle now."""

    view: VehicleView
    index: int  # in the fleet file
    state: FleetState
    fleet: FleetConfig
    now_ns: int
    tick_samples: Sequence[TickSample]  # of its pipeline, oldest first
    alarms: Sequence[AlarmLine] = ()
    # Words for the time at which something was received, in nanoseconds.
    time_text: Callable[[int], str] = field(default=str)
    chart_rows: int = 5  # height of a chart

    @property
    def telemetry(self) -> Telemetry | None:
        """The last telemetry, however old."""
        return self.view.telemetry

    @property
    def tick(self) -> TickSample | None:
        """The newest tick; None once the vehicle has fallen silent."""
        is_silent = self.telemetry is None or self.view.age_s(self.now_ns) > _FRESH_S
        if is_silent or not self.tick_samples:
            return None
        return self.tick_samples[-1]
