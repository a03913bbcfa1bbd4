"""The vehicle that a page shows, with all values that its blocks need."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from groundstation.alarms.alarms import AlarmLine
from groundstation.fleet.state import FleetState, VehicleView
from onboard.bus.schema import Telemetry, TickSample
from onboard.config.fleet import FleetConfig

Text = list[tuple[str, str]]  # pieces of a line with their colours
_FRESH_S = 2.0  # age of telemetry up to which ticks are shown


@dataclass(frozen=True, slots=True)
class VehicleSubject:
    """One vehicle in its present state."""

    view: VehicleView
    index: int  # index in the fleet file
    state: FleetState
    fleet: FleetConfig
    now_ns: int
    tick_samples: Sequence[TickSample]  # values of the vehicle's pipeline, oldest first
    alarms: Sequence[AlarmLine] = ()
    # function that returns the words for a time of reception [ns]
    time_text: Callable[[int], str] = field(default=str)
    chart_rows: int = 5  # height of a chart
    is_replay: bool = False  # whether it is shown from a record
    is_latched: bool = False  # whether it was killed from here, and not reset since

    @property
    def telemetry(self) -> Telemetry | None:
        """The last telemetry, however old."""
        return self.view.telemetry

    @property
    def tick(self) -> TickSample | None:
        """The newest tick; None if the vehicle is silent."""
        is_silent = self.telemetry is None or self.view.age_s(self.now_ns) > _FRESH_S
        if is_silent or not self.tick_samples:
            return None
        return self.tick_samples[-1]
