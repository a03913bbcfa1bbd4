"""Conditions of the failsafe table that hold now.

A process that was not scheduled for a while finds every message old at its first tick, although
nothing else is wrong. Therefore a silence counts only after several ticks in a row have noticed it.
Conditions that can do harm within a tenth of a second are checked at every tick, the others ten
times a second.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from onboard.autopilot import Vec4
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.control.allocation import MAX_THRUST_FRAC
from onboard.control.vertical import vertical_s
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightStep, FlightView
from onboard.localization.own_state import OwnState
from onboard.neighbours.table import NeighbourTable
from onboard.safety.autopilot_monitor import AutopilotMonitor
from onboard.safety.battery_monitor import BatteryMonitor
from onboard.safety.failsafe_table import Condition, Situation
from onboard.safety.geofence import Fence
from onboard.safety.limits import LARGEST_PX4_ACCURACY_M, POSITION_STALE_S, RECKONING_S
from onboard.safety.report_confirmation import CONTRADICTED_LONG_S, ReportConfirmation
from onboard.safety.tracking_monitor import TrackingMonitor
from onboard.supervision.neighbour_conditions import NeighbourMonitor
from onboard.types import GRAVITY_M_S2, TICK_S, LawStatus

STALE_FOR_S = 0.4  # a position that stays this old is lost, however regularly it comes
_LOST_S = 0.58  # with the live ticks: whoever has poses again after 0.6 s does not land
# PX4 lands after COM_OF_LOSS_T = 0.3 s without setpoints
LATE_S, STALLED_S, STALLED_LONG_S = 0.005, 0.2, 0.3
BUS_LOST_S = 1.0
JUMPS, SWAP_JUMPS, SWAP_RADIUS_M = 3, 2, 0.3
CLOCK_JUMP_REPORTED_S = 5.0
_DOWN_HEIGHT_M, _DOWN_LONG_S = 0.12, 1.0
_TRACKING_ABOVE_M, _TRACKING_BLIND_ABOVE_M = 0.2, 0.5  # of a height that reads too high
# in a landing: PX4's height by satellites errs by 0.7 m, and the ground comes early
_TRACKING_SATELLITES_ABOVE_M = 1.0
_CLEARLY_UP_M, _LANDED_WRONG_S = 0.5, 0.5
_FENCE_LONG_S = 2.0
_NOT_FINITE_LONG_S = 0.5
_INFEASIBLE_S = 0.1
_INACCURATE_S = 0.5
# PX4's own accuracy, beyond which it flies level rather than after such a position
_UNUSABLE_M = 3.0
_DETAILS = {
    Condition.POSITION_STALE: "it brakes and sinks by dead reckoning",
    Condition.POSITION_LOST: "by dead reckoning",
}
_LIVE_TICKS = 5
_SLOW_TICKS = 5
_BATTERY_UNKNOWN_S = 5.0  # and 5 s until a report counts as old
_BRAKE_SHARE = 0.6  # of the acceleration at the largest tilt, assumed for braking before the fence


@dataclass(slots=True)
class TickContext:
    """State of the agent itself at one tick."""

    period_s: float = TICK_S  # since the last tick
    is_last_tick_finite: bool = True
    law_refusal: str = ""  # why Covey's law flies in the place of the one that the fleet file names
    is_airborne: bool = False
    is_stopping: bool = False  # the agent is asked to end
    has_ground: bool = False  # a ground station is on the bus
    has_duplicate: bool = False  # another agent publishes for this vehicle
    is_disk_full: bool = False
    # charge at which a simulated battery stops emptying; 0 for a real one
    battery_floor_frac: float = 0.0
    bus_age_s: float = 0.0  # since the last message of any neighbour
    nearest_m: float = math.inf  # separation from the nearest vehicle
    law_status: int = 0  # of the last tick
    active_neighbour: int = -1  # index of the neighbour that the law keeps it from; -1 for none
    commanded_wxyz: Vec4 = (1.0, 0.0, 0.0, 0.0)  # attitude setpoint sent last, in the fleet frame
    thrust_frac: float = 0.0  # throttle sent last
    below_m: float = 0.0  # height of the trajectory above the vehicle
    clock_jump_ns: int = 0  # time of the last jump of a clock; 0 never


@dataclass(slots=True)
class ConditionMonitor:
    """Memory of how long each condition has lasted."""

    fleet: FleetConfig
    vehicle: Vehicle
    own: OwnState
    flight: FlightContext
    neighbours: NeighbourTable
    reports: ReportConfirmation = field(default_factory=ReportConfirmation)
    autopilot: AutopilotMonitor = field(default_factory=AutopilotMonitor)
    tracking: TrackingMonitor = field(init=False)
    battery: BatteryMonitor = field(default_factory=BatteryMonitor)
    other_vehicles: NeighbourMonitor = field(init=False)
    # vehicles or numbers for a condition's sentence
    details: dict[Condition, str] = field(init=False)
    _since_ns: dict[Condition, int] = field(default_factory=dict)
    _tick_counts: dict[Condition, int] = field(default_factory=dict)
    _slow: set[Condition] = field(default_factory=set)  # found by the last slow check
    _count: int = 0
    _offboard_since_ns: int = 0
    _has_landing_mode: bool = False
    _fence: Fence = field(init=False)

    def __post_init__(self) -> None:
        self.details = dict(_DETAILS)
        self.tracking = TrackingMonitor(self.vehicle.lag_s, MAX_THRUST_FRAC)
        self.other_vehicles = NeighbourMonitor(
            self.fleet, self.vehicle, self.neighbours, self.flight, self.details
        )
        fence = self.fleet.fleet.geofence_m
        brake = _BRAKE_SHARE * GRAVITY_M_S2 * math.tan(math.radians(self.vehicle.max_tilt_deg))
        (west, east), (south, north), (floor, top) = fence.x, fence.y, fence.z
        brakes = (brake, brake, 0.5 * GRAVITY_M_S2)
        self._fence = Fence((west, south, floor), (east, north, top), brakes, self.vehicle.lag_s)

    def lasting(self, condition: Condition, holds: bool, now_ns: int) -> tuple[int, float]:
        """Return for how many ticks in a row and how many seconds a condition has held; (0, 0) when
        it does not.
        """
        if not holds:
            if self._tick_counts:
                self._since_ns.pop(condition, None)
                self._tick_counts.pop(condition, None)
            return 0, 0.0
        since = self._since_ns.setdefault(condition, now_ns)
        tick_count = self._tick_counts[condition] = self._tick_counts.get(condition, 0) + 1
        return tick_count, (now_ns - since) * 1e-9

    def conditions(self, view: FlightView, context: TickContext) -> set[Condition]:
        """Return all conditions that hold at this tick."""
        active: set[Condition] = set()
        self._check_own_motion(active, view)
        self._check_px4(active, view)
        self._check_mode(active, view)
        self._check_landed_state(active, view)
        self._check_tick(active, view, context)
        self._check_process(active, view, context)
        self._check_space(active, view)
        self._check_tracking(active, view, context)
        self.other_vehicles.check(
            active, view, context.nearest_m, context.is_airborne, context.active_neighbour
        )
        _, infeasible_s = self.lasting(
            Condition.LAW_INFEASIBLE,
            context.law_status == LawStatus.INFEASIBLE and self.flight.is_under_law,
            view.now_ns,
        )
        if infeasible_s > _INFEASIBLE_S:
            active.add(Condition.LAW_INFEASIBLE)
        self._count += 1
        if self._count % _SLOW_TICKS == 0:
            self._slow = self._check_slowly(view, context)
        return active | self._slow if self._slow else active

    def _check_own_motion(self, active: set[Condition], view: FlightView) -> None:
        c, now_ns, own = Condition, view.now_ns, self.own
        stale, stale_s = self.lasting(c.POSITION_STALE, own.age_s > POSITION_STALE_S, now_ns)
        if stale:
            active.add(c.POSITION_STALE)
        is_lost = own.age_s > _LOST_S or stale_s > STALE_FOR_S
        if self.lasting(c.POSITION_LOST, is_lost, now_ns)[0] >= _LIVE_TICKS:
            active.add(c.POSITION_LOST)
            # on the ground PX4 would lift it off
            if own.age_s > RECKONING_S and self.flight.step is not FlightStep.CONTACT:
                active.add(c.POSITION_LOST_LONG)
        jumps = own.jumps
        if jumps >= SWAP_JUMPS:
            jumped_to = own.jumped_to_enu_m
            other = (
                self.other_vehicles.nearest_to(jumped_to, SWAP_RADIUS_M, now_ns)
                if jumped_to is not None
                else ""
            )
            if other:
                self.details[c.MOCAP_SWAPPED] = other
                active.add(c.MOCAP_SWAPPED)
            elif jumps >= JUMPS:
                active.add(c.POSITION_JUMPED)
        if own.validator.is_frozen:
            active.add(c.MOCAP_FROZEN)
        if own.validator.is_late:
            active.add(c.MOCAP_LATE)

    def _check_px4(self, active: set[Condition], view: FlightView) -> None:
        c, now_ns, snapshot, px4 = Condition, view.now_ns, view.snapshot, self.autopilot
        px4.update(
            now_ns,
            packet_ns=snapshot.last_packet_ns,
            attitude_ns=snapshot.attitude_ns,
            heartbeat_ns=snapshot.heartbeat_ns,
            boot_ms=snapshot.px4_boot_ms,
        )
        impossible = self.reports.impossible(now_ns)
        if px4.is_silent and impossible:
            self._add(active, c.AUTOPILOT_IMPOSSIBLE, impossible.removesuffix("."))
        elif px4.is_silent:
            active.add(c.AUTOPILOT_SILENT)
        if px4.is_frozen:
            active.add(c.AUTOPILOT_FROZEN)
        if px4.is_heartbeat_lost:
            active.add(c.HEARTBEAT_LOST)
        if px4.is_rebooted:
            active.add(c.REBOOTED)
        if px4.is_back:
            active.add(c.AUTOPILOT_BACK)
        contradicted_s = self.reports.contradicted_s(now_ns)
        if contradicted_s:
            self._add(active, c.REPORTS_CONTRADICT, self.reports.contradicted)
            if contradicted_s > CONTRADICTED_LONG_S:
                self._add(active, c.REPORTS_CONTRADICT_LONG, self.reports.contradicted)

    def _check_landed_state(self, active: set[Condition], view: FlightView) -> None:
        c, now_ns = Condition, view.now_ns
        if self.lasting(c.LANDED_UNKNOWN, not view.has_landed_report, now_ns)[0] >= _LIVE_TICKS:
            active.add(c.LANDED_UNKNOWN)
        is_up = (
            view.has_position and view.position_enu_m[2] - self.flight.ground_z_m > _CLEARLY_UP_M
        )
        is_wrong = self.flight.situation is Situation.FLYING and is_up and view.is_on_ground
        if self.lasting(c.LANDED_WRONG, is_wrong, now_ns)[1] > _LANDED_WRONG_S:
            active.add(c.LANDED_WRONG)

    def _check_mode(self, active: set[Condition], view: FlightView) -> None:
        c, now_ns, snapshot, flight = Condition, view.now_ns, view.snapshot, self.flight
        if flight.step is FlightStep.PX4_LANDING:
            self._offboard_since_ns = now_ns
            is_landing = snapshot.mode == "LAND"
            if (
                self._has_landing_mode
                and not is_landing
                and not view.is_on_ground
                and not snapshot.is_failsafe
            ):
                self._add(active, c.LEFT_OFFBOARD, f"now {snapshot.mode}")
            self._has_landing_mode |= is_landing
            return
        self._has_landing_mode = False
        if not flight.must_be_offboard:
            self._offboard_since_ns = now_ns
        elif snapshot.heartbeat_ns > self._offboard_since_ns:
            if not snapshot.is_armed and flight.must_be_armed:
                active.add(c.DISARMED)
            elif not snapshot.is_offboard:
                condition = c.PX4_FAILSAFE if snapshot.is_failsafe else c.LEFT_OFFBOARD
                self._add(active, condition, f"now {snapshot.mode}")

    def _check_tick(self, active: set[Condition], view: FlightView, context: TickContext) -> None:
        c = Condition
        bad, bad_s = self.lasting(c.NOT_FINITE, not context.is_last_tick_finite, view.now_ns)
        if bad:
            active.add(c.NOT_FINITE)
            if bad_s > _NOT_FINITE_LONG_S:
                active.add(c.NOT_FINITE_LONG)
        if context.law_refusal:
            self._add(active, c.OWN_LAW_REFUSED, f"{self.fleet.law.name} {context.law_refusal}")

    def _check_process(
        self, active: set[Condition], view: FlightView, context: TickContext
    ) -> None:
        c, now_ns, period_s = Condition, view.now_ns, context.period_s
        if period_s > TICK_S + LATE_S:
            active.add(c.LOOP_LATE)
            if period_s > STALLED_S:
                active.add(c.LOOP_STALLED)
            if period_s > STALLED_LONG_S:
                active.add(c.LOOP_STALLED_LONG)
        bus, bus_s = self.lasting(c.BUS_LOST, context.bus_age_s > BUS_LOST_S, now_ns)
        if bus >= _LIVE_TICKS:
            active.add(c.BUS_LOST)
            if bus_s > self.fleet.fleet.bus_lost_land_s:
                active.add(c.BUS_LOST_LONG)
        ground, ground_s = self.lasting(c.GROUND_LOST, not context.has_ground, now_ns)
        if ground >= _LIVE_TICKS:
            active.add(c.GROUND_LOST)
            if ground_s > self.fleet.fleet.ground_lost_land_s:
                active.add(c.GROUND_LOST_LONG)
        if context.is_stopping:
            active.add(c.SHUTDOWN)
        if context.has_duplicate:
            active.add(c.TWIN)
        if context.is_disk_full:
            active.add(c.DISK_FULL)
        overdue = self.flight.overdue(view)
        if overdue is not None:
            self._add(
                active,
                c.ORDER_OVERDUE,
                overdue or self.other_vehicles.kept_off_by(self.flight.goal_position_enu_m, view),
            )

    def _check_space(self, active: set[Condition], view: FlightView) -> None:
        c = Condition
        is_near = is_over = is_above = False
        if view.has_position:
            is_near, is_over, is_above = self._fence.status(
                view.position_enu_m, view.velocity_enu_m_s
            )
        if is_near:
            active.add(c.FENCE_NEAR)
        if is_over:
            active.add(c.FENCE_BREACH)
        if is_above:
            active.add(c.CEILING)
        if self.lasting(c.FENCE_BREACH, is_over or is_above, view.now_ns)[1] > _FENCE_LONG_S:
            active.add(c.FENCE_BREACH_LONG)
        should_be_up = self.flight.situation is Situation.FLYING and view.has_position
        is_down = should_be_up and view.position_enu_m[2] < _DOWN_HEIGHT_M
        if self.lasting(c.FALLEN, is_down, view.now_ns)[1] > _DOWN_LONG_S:
            active.add(c.FALLEN)

    def _check_tracking(
        self, active: set[Condition], view: FlightView, context: TickContext
    ) -> None:
        c, tracking, flight = Condition, self.tracking, self.flight
        height_m = view.position_enu_m[2] - flight.ground_z_m
        lowest_m = _TRACKING_BLIND_ABOVE_M if view.is_blind else _TRACKING_ABOVE_M
        if flight.situation is Situation.LANDING and not self.vehicle.mocap_required:
            lowest_m = _TRACKING_SATELLITES_ABOVE_M
        if not flight.is_under_law or flight.step is FlightStep.LIFTOFF or height_m < lowest_m:
            tracking.reset()
            return
        tracking.update(
            context.commanded_wxyz,
            self.own.attitude_wxyz(view.snapshot),
            context.thrust_frac,
            below_m=context.below_m,
            climb_m_s=view.velocity_enu_m_s[2],
            dt_s=min(context.period_s, 0.1),
        )
        if tracking.is_attitude_lost:
            active.add(c.ATTITUDE_NOT_FOLLOWED)
        if tracking.is_saturated:
            active.add(c.THRUST_SATURATED)
        if tracking.is_sinking:
            active.add(c.NOT_CLIMBING)

    def _check_slowly(self, view: FlightView, context: TickContext) -> set[Condition]:
        c, snapshot, limits = Condition, view.snapshot, self.fleet.fleet
        active = self.other_vehicles.check_slowly(view)
        accuracy_m = snapshot.accuracy_m(view.now_ns)
        is_covered = 0.0 < accuracy_m <= LARGEST_PX4_ACCURACY_M or self.vehicle.mocap_required
        if self.lasting(c.POSITION_INACCURATE, not is_covered, view.now_ns)[1] > _INACCURATE_S:
            told = (
                f"PX4 says {accuracy_m:.1f} m"
                if accuracy_m
                else "PX4 does not say how accurate it is"
            )
            self._add(
                active,
                c.POSITION_INACCURATE,
                f"{told}; distances cover {LARGEST_PX4_ACCURACY_M:.1f} m",
            )
        if self.own.has_lost_satellites:
            active.add(c.SATELLITES_LOST)
        is_unusable = (
            accuracy_m > _UNUSABLE_M
            and not self.vehicle.mocap_required
            and self.flight.step is not FlightStep.CONTACT
        )
        if self.lasting(c.POSITION_LOST_LONG, is_unusable, view.now_ns)[1] > _INACCURATE_S:
            self._add(active, c.POSITION_LOST_LONG, f"PX4 says {accuracy_m:.1f} m")
        else:  # the other cause, its age, has no detail
            self.details.pop(c.POSITION_LOST_LONG, None)
        battery_frac, battery_voltage_v = snapshot.battery(view.now_ns)
        battery_pct = 100.0 * battery_frac
        if (
            self.lasting(c.BATTERY_UNKNOWN, math.isnan(battery_frac), view.now_ns)[1]
            > _BATTERY_UNKNOWN_S
        ):
            active.add(c.BATTERY_UNKNOWN)
        if battery_pct < limits.battery_warning_pct:
            active.add(c.BATTERY_WARNING)
        if battery_pct < limits.battery_land_pct:
            active.add(c.BATTERY_LOW)
        if self.flight.situation in (Situation.GROUND, Situation.ARMED):
            self.battery.reset()
        else:
            self.battery.update(
                view.now_ns * 1e-9,
                battery_frac,
                battery_voltage_v,
                land_frac=0.01 * limits.battery_land_pct,
                descent_s=vertical_s(
                    view.position_enu_m[2] - self.flight.ground_z_m, self.vehicle.max_speed_m_s
                ),
                floor_frac=context.battery_floor_frac,
            )
        if self.battery.is_falling:
            active.add(c.BATTERY_FALLING)
        jump_ns = max(self.own.validator.clock_jump_ns, context.clock_jump_ns)
        if jump_ns and view.now_ns - jump_ns < CLOCK_JUMP_REPORTED_S * 1e9:
            active.add(c.CLOCK_JUMPED)
        return active

    def _add(self, active: set[Condition], condition: Condition, detail: str) -> None:
        active.add(condition)
        self.details[condition] = detail
