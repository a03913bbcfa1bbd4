"""Which conditions of the failsafe table hold now. Times are on the agent's clock, and count live ticks as well.

A process that was not scheduled for a while finds everything old at its first tick, although nothing is wrong but
itself. So a silence counts only after it has also been seen by several ticks in a row.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from onboard.agent.steps import View
from onboard.config import FleetConfig
from onboard.safety.failsafe import Condition

POSITION_STALE_S, POSITION_LOST_S = 0.2, 0.5
_DOWN_HEIGHT_M, _DOWN_LONG_S = 0.12, 1.0
AUTOPILOT_SILENT_S = 0.3
LATE_S, STALLED_S, STALLED_LONG_S = 0.005, 0.2, 0.3  # PX4 lands after COM_OF_LOSS_T = 0.3 s without setpoints
PERIOD_S = 0.02
BUS_LOST_S = 1.0
_FENCE_LONG_S = 2.0
_NOT_FINITE_LONG_S = 0.5
_LIVE_TICKS = 5


@dataclass(slots=True)
class Watch:
    """Memory of how long each condition has lasted."""

    fleet: FleetConfig
    _since_ns: dict[Condition, int] = field(default_factory=dict)
    _ticks: dict[Condition, int] = field(default_factory=dict)

    def lasting(self, condition: Condition, is_seen: bool, now_ns: int) -> tuple[int, float]:
        """How many ticks in a row and for how many seconds a condition has been seen; (0, 0) when it is not."""
        if not is_seen:
            if self._ticks:
                self._since_ns.pop(condition, None)
                self._ticks.pop(condition, None)
            return 0, 0.0
        since = self._since_ns.setdefault(condition, now_ns)
        ticks = self._ticks[condition] = self._ticks.get(condition, 0) + 1
        return ticks, (now_ns - since) * 1e-9

    def conditions(
        self,
        view: View,
        *,
        period_s: float,
        position_age_s: float,
        is_last_tick_finite: bool,
        must_be_offboard: bool,
        offboard_since_ns: int,
        bus_age_s: float,
        has_ground: bool,
        nearest_m: float,
        silent_neighbours: bool,
        should_be_up: bool,
        is_stopping: bool,
    ) -> set[Condition]:
        """All conditions that hold at this tick."""
        c, now_ns, snapshot, limits = Condition, view.now_ns, view.snapshot, self.fleet.fleet
        found: set[Condition] = set()

        stale, _ = self.lasting(c.POSITION_STALE, position_age_s > POSITION_STALE_S, now_ns)
        lost, _ = self.lasting(c.POSITION_LOST, position_age_s > POSITION_LOST_S, now_ns)
        silent_s = (now_ns - snapshot.last_packet_ns) * 1e-9
        silent, _ = self.lasting(c.AUTOPILOT_SILENT, silent_s > AUTOPILOT_SILENT_S, now_ns)
        outside = view.has_position and not limits.geofence_m.contains(view.position_enu_m)
        breach, breach_s = self.lasting(c.FENCE_BREACH, outside, now_ns)
        bad, bad_s = self.lasting(c.NOT_FINITE, not is_last_tick_finite, now_ns)
        bus, bus_s = self.lasting(c.BUS_LOST, bus_age_s > BUS_LOST_S, now_ns)
        is_down = should_be_up and view.has_position and view.position_enu_m[2] < _DOWN_HEIGHT_M
        _, down_s = self.lasting(c.FALLEN, is_down, now_ns)
        unheard, _ = self.lasting(c.NEIGHBOUR_SILENT, silent_neighbours, now_ns)
        battery_pct = 100.0 * snapshot.battery_frac
        taken = must_be_offboard and not snapshot.is_offboard and snapshot.heartbeat_ns > offboard_since_ns
        for condition, holds in (
            (c.POSITION_STALE, stale > 0),
            (c.POSITION_LOST, lost >= _LIVE_TICKS),
            (c.AUTOPILOT_SILENT, silent >= _LIVE_TICKS),
            (c.LEFT_OFFBOARD, taken),
            (c.LOOP_LATE, period_s > PERIOD_S + LATE_S),
            (c.LOOP_STALLED, period_s > STALLED_S),
            (c.LOOP_STALLED_LONG, period_s > STALLED_LONG_S),
            (c.BUS_LOST, bus >= _LIVE_TICKS),
            (c.BUS_LOST_LONG, bus >= _LIVE_TICKS and bus_s > limits.bus_lost_land_s),
            (c.GROUND_LOST, not has_ground),
            (c.BATTERY_WARNING, battery_pct < limits.battery_warning_pct),
            (c.BATTERY_LOW, battery_pct < limits.battery_land_pct),
            (c.FENCE_BREACH, breach > 0),
            (c.FENCE_BREACH_LONG, breach_s > _FENCE_LONG_S),
            (c.NOT_FINITE, bad > 0),
            (c.NOT_FINITE_LONG, bad_s > _NOT_FINITE_LONG_S),
            (c.SEPARATION_BREACHED, nearest_m < limits.safety_distance_m),
            (c.NEIGHBOUR_SILENT, unheard >= 2),
            (c.FALLEN, down_s > _DOWN_LONG_S),
            (c.SHUTDOWN, is_stopping),
        ):
            if holds:
                found.add(condition)
        return found
