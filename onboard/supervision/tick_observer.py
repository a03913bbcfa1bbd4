"""Collects the facts of a tick from all parts of an agent, as one value of :class:`TickFacts`.

Some facts need a memory, for example a frozen clock of PX4, a falling battery, or an attitude that
does not follow. Each of these has a monitor, which this module updates and reads.
"""

from __future__ import annotations

import math

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.flight_space import flight_space_of
from onboard.config.ground import lowest_ground_m
from onboard.control.allocation import MAX_THRUST_FRAC
from onboard.control.climb_duration import climb_duration_s
from onboard.corrections import fix
from onboard.flight import contact
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightStep, FlightView
from onboard.localization.own_state import OwnState
from onboard.neighbours.table import NeighbourTable
from onboard.safety.autopilot_monitor import AutopilotMonitor
from onboard.safety.battery_monitor import BatteryMonitor
from onboard.safety.condition_timer import ConditionTimer, Recurring
from onboard.safety.failsafe_table import Situation
from onboard.safety.geofence import FenceStatus, fence_of
from onboard.safety.limits import (
    DOWN_HEIGHT_M,
    FLICKER_FORGOTTEN_SHARE,
    LARGEST_FLICKER_S,
    POSITION_STALE_S,
)
from onboard.safety.report_confirmation import ReportConfirmation
from onboard.safety.tracking_monitor import TrackingMonitor
from onboard.supervision.neighbour_monitor import NeighbourMonitor
from onboard.supervision.offboard_monitor import OffboardMonitor
from onboard.supervision.tick_context import TickContext
from onboard.supervision.tick_facts import CorrectionsFacts, ModeLoss, SlowFacts, TickFacts
from onboard.supervision.wind_monitor import WindMonitor
from onboard.types import LawStatus

_SLOW_TICKS = 5  # number of ticks between two collections of the slow facts
# The mocap has swapped two bodies if _SWAP_JUMPS impossible samples in a row lie within
# _SWAP_RADIUS_M of another vehicle.
_SWAP_JUMPS = 2
_SWAP_RADIUS_M = 0.3

# Below these heights, the ground may carry the vehicle, which then cannot follow its commanded
# attitude.
_TRACKED_ABOVE_M = 0.2
_TRACKED_BLIND_ABOVE_M = 0.5  # by dead reckoning: the estimated height may be too large
# in a landing without a mocap, because PX4's height from satellites has an error of 0.7 m
_TRACKED_SATELLITES_ABOVE_M = 1.0
_RISES_M = 0.02  # a low vehicle that reaches a height greater by this climbs
_LONGEST_TICK_S = 0.1  # the monitors limit a longer tick to this

_LOAD_KNOWN_S = 1.0  # the battery's reports show the load of flight after this time of a climb

_HEARTBEAT_DUE_NS = 1_300_000_000  # a heartbeat at 1 Hz is lost if none has arrived for longer

_TAKING_OFF = (Situation.ARMED, Situation.LIFTOFF)
_WITHOUT_POSITION = FenceStatus(is_near=False, is_outside=False, is_above=False)


class TickObserver:
    """Collects the facts of one vehicle; call :meth:`update` at every tick.

    Args:
        fleet: the fleet file.
        vehicle: the vehicle, from that file.
        own: estimate of its motion.
        flight: its flight, which is only read.
        neighbours: table of the other vehicles.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        vehicle: Vehicle,
        own: OwnState,
        flight: FlightContext,
        neighbours: NeighbourTable,
    ) -> None:
        self.reports = ReportConfirmation()
        self._limits = fleet.fleet
        self._law_name = fleet.law.name
        self._vehicle = vehicle
        self._lowest_ground_m = lowest_ground_m(fleet)
        self._highest_low_m = -math.inf  # greatest height since the vehicle is low
        self._own = own
        self._flight = flight
        self._fence = fence_of(fleet.fleet.geofence_m, vehicle)
        self._areas = flight_space_of(fleet).areas
        # Two bodies nearer than this touch. A collision is suspected only while the safety distance
        # is breached, so this is not larger than that distance.
        self._touching_m = min(fleet.fleet.body_diameter_m, fleet.fleet.safety_distance_m)

        self._stale = ConditionTimer()
        self._flicker = Recurring(FLICKER_FORGOTTEN_SHARE, largest_s=LARGEST_FLICKER_S)
        self._autopilot = AutopilotMonitor()
        self._offboard = OffboardMonitor()
        self._tracking = TrackingMonitor(vehicle.lag_s, MAX_THRUST_FRAC)
        self._battery = BatteryMonitor()
        self._wind = WindMonitor(fleet, vehicle)
        self._neighbours = NeighbourMonitor(fleet, vehicle, neighbours, flight)

        self._slow = SlowFacts()
        self._tick_count = 0

    def update(self, view: FlightView, context: TickContext) -> TickFacts:
        """Return the facts of this tick."""
        now_ns = view.now_ns
        snapshot = view.snapshot
        own = context.own
        neighbours = self._neighbours
        flight = self._flight
        step = flight.step
        _, _, z_m = view.position_enu_m
        height_m = z_m - flight.expected_ground.z_m
        height_above_lowest_ground_m = z_m - self._lowest_ground_m

        # PX4
        self._autopilot.update(
            now_ns,
            packet_ns=snapshot.last_packet_ns,
            attitude_ns=snapshot.attitude_ns,
            heartbeat_ns=snapshot.heartbeat_ns,
            boot_ms=snapshot.px4_boot_ms,
        )
        has_landed_report = view.has_landed_report
        is_on_ground = has_landed_report and view.was_on_ground
        mode_loss = self._offboard.update(now_ns, snapshot, flight, is_on_ground=is_on_ground)

        # own motion
        self._update_position_age(view)
        if mode_loss is ModeLoss.NONE:
            self._update_tracking(view, context, height_m)
        else:  # the vehicle does not fly the setpoints
            self._tracking.reset()
        self._update_wind(context)
        jumped_onto = ""  # name of the vehicle whose position it has jumped to
        if own.jumps >= _SWAP_JUMPS:
            jumped_onto = self._jumped_onto(now_ns)

        # geofence
        fence = _WITHOUT_POSITION
        if view.has_position:
            fence = self._fence_status(view)

        # the order, and the other vehicles
        overdue = flight.overdue(view)
        overdue_reason = ""
        if overdue is not None:
            overdue_reason = overdue.reason
            if not overdue_reason:
                overdue_reason = neighbours.kept_off_by(flight.goal_position_enu_m, view)
        if step is FlightStep.LEG:
            neighbours.count_avoided(context.active_neighbour)
        silence = neighbours.update(now_ns)

        law_refusal = ""
        if context.law_refusal:
            law_refusal = f"{self._law_name} {context.law_refusal}"

        self._tick_count += 1
        is_slow_tick = self._tick_count % _SLOW_TICKS == 0
        if is_slow_tick:
            self._slow = self._slow_facts(view, context, height_m)

        return TickFacts(
            now_ns=now_ns,
            limits=self._limits,
            is_slow_tick=is_slow_tick,
            slow=self._slow,
            # the flight
            is_flying=step.situation is Situation.FLYING,
            is_under_law=step.is_under_law,
            is_airborne=context.is_airborne,
            is_taking_off=step.situation in _TAKING_OFF,
            is_in_contact=step is FlightStep.CONTACT,
            is_overdue=overdue is not None,
            overdue_reason=overdue_reason,
            # own motion
            has_position=view.has_position,
            position_age_s=view.position_age_s,
            position_stale_s=self._stale.seconds(now_ns),
            position_flicker_s=self._flicker.seconds,
            height_above_lowest_ground_m=height_above_lowest_ground_m,
            has_risen=self._has_risen(height_above_lowest_ground_m),
            height_m=height_m,
            is_standing=contact.has_ground_contact_by_thrust(flight.contact, view),
            is_stuck=contact.is_stuck(flight.contact, view, flight.goal_position_enu_m[2]),
            mocap_required=self._vehicle.mocap_required,
            jumps=own.jumps,
            jumped_onto=jumped_onto,
            is_mocap_frozen=own.is_mocap_frozen,
            is_mocap_late=own.is_mocap_late,
            # PX4
            is_px4_silent=self._autopilot.is_silent,
            px4_nonsense=self.reports.impossible(now_ns),
            is_px4_frozen=self._autopilot.is_frozen,
            is_heartbeat_late=self._autopilot.is_heartbeat_late,
            is_px4_rebooted=self._autopilot.is_rebooted,
            is_px4_back=self._autopilot.is_back,
            has_contradiction=self.reports.has_contradiction(now_ns),
            contradicted_s=self.reports.contradicted_s(now_ns),
            contradicted=self.reports.contradicted,
            has_landed_report=has_landed_report,
            is_on_ground=is_on_ground,
            mode_loss=mode_loss,
            px4_mode=snapshot.mode,
            is_attitude_lost=self._is_attitude_lost(now_ns, snapshot.heartbeat_ns),
            is_thrust_saturated=self._tracking.is_saturated,
            is_sinking=self._tracking.is_sinking,
            # own process
            period_s=context.period_s,
            is_last_tick_finite=context.is_last_tick_finite,
            law_refusal=law_refusal,
            is_stopping=context.is_stopping,
            has_duplicate=context.has_duplicate,
            is_disk_full=context.is_disk_full,
            # bus and ground
            bus_age_s=context.bus_age_s,
            has_ground=context.has_ground,
            # geofence
            is_fence_near=fence.is_near,
            is_outside=fence.is_outside,
            is_above_ceiling=fence.is_above,
            # other vehicles
            nearest_m=context.nearest_m,
            nearest_person=context.nearest_person,
            nearest_person_m=context.nearest_person_m,
            touched=self._touched(view, context),
            is_law_infeasible=context.law_status == LawStatus.INFEASIBLE,
            silent=silence.silent,
            unseen=(*silence.unseen, *context.unseen_people),
            heard_again=silence.heard_again,
        )

    def _update_position_age(self, view: FlightView) -> None:
        """Update for how long the position is stale, and how often it has been."""
        is_stale = view.position_age_s > POSITION_STALE_S
        self._flicker.update(view.now_ns, is_stale)
        if is_stale:
            self._stale.see(view.now_ns)
        else:
            self._stale.end()

    def _update_tracking(self, view: FlightView, context: TickContext, height_m: float) -> None:
        """Update how the attitude follows its setpoints, while nothing but the motors carries it.

        Args:
            view: what the flight sees in this tick.
            context: what other parts of the agent know.
            height_m: height above the ground at the vehicle's place.
        """
        step = self._flight.step
        is_tracked = step.is_under_law and step is not FlightStep.LIFTOFF
        if not is_tracked or height_m < self._tracked_above_m(view):
            self._tracking.reset()
            return

        _, _, climb_m_s = view.velocity_enu_m_s
        self._tracking.update(
            context.commanded_wxyz,
            view.attitude_wxyz,
            context.thrust_frac,
            below_m=context.below_m,
            climb_m_s=climb_m_s,
            dt_s=_tick_length_s(context),
        )

    def _update_wind(self, context: TickContext) -> None:
        """Update the wind that pushes the vehicle, which is measured while it holds a position."""
        step = self._flight.step
        if step is FlightStep.ARRIVED or step is FlightStep.HOLDING:
            self._wind.update(context, _tick_length_s(context))
        else:
            self._wind.reset()

    def _touched(self, view: FlightView, context: TickContext) -> str:
        """Return the name of the neighbour that the vehicle touches in the air; empty: none."""
        if not context.is_airborne or context.nearest_m >= self._touching_m:
            return ""
        return self._neighbours.nearest_to(
            view.position_enu_m, self._limits.body_diameter_m, view.now_ns
        )

    def _has_risen(self, height_m: float) -> bool:
        """Return whether a low vehicle has reached a greater height than before in this flight.

        Args:
            height_m: height above the lowest ground.
        """
        if height_m >= DOWN_HEIGHT_M or not self._flight.step.is_under_law:
            self._highest_low_m = -math.inf
            return False
        if height_m < self._highest_low_m + _RISES_M:
            return False
        self._highest_low_m = height_m
        return True

    def _is_attitude_lost(self, now_ns: int, heartbeat_ns: int) -> bool:
        """Return whether the attitude does not follow its setpoints, and a pilot is not the reason.

        A pilot who takes over tilts the vehicle at will, and only a heartbeat reports the new mode.
        So the attitude counts as lost only after a requested heartbeat, which lets
        `OffboardMonitor` recognise a pilot, or if no heartbeat arrives. For an upset vehicle, no
        heartbeat is awaited.
        """
        self.reports.is_heartbeat_wanted = False
        if self._tracking.is_upset:
            return True
        if not self._tracking.is_attitude_lost:
            return False

        began_ns = now_ns - int(1e9 * self._tracking.missed_s)
        is_mode_known = heartbeat_ns >= began_ns
        is_silent = now_ns - heartbeat_ns > _HEARTBEAT_DUE_NS
        self.reports.is_heartbeat_wanted = not is_mode_known
        return is_mode_known or is_silent

    def _fence_status(self, view: FlightView) -> FenceStatus:
        """Return where the vehicle is relative to the box, and to the fleet's areas if any."""
        if not self._areas:
            return self._fence.status(view.position_enu_m, view.velocity_enu_m_s)
        return self._fence.status_in(self._areas, view.position_enu_m, view.velocity_enu_m_s)

    def _jumped_onto(self, now_ns: int) -> str:
        """Return the name of the vehicle near the newest impossible sample; empty: none."""
        jumped_to_enu_m = self._own.jumped_to_enu_m
        if jumped_to_enu_m is None:
            return ""
        return self._neighbours.nearest_to(jumped_to_enu_m, _SWAP_RADIUS_M, now_ns)

    def _tracked_above_m(self, view: FlightView) -> float:
        """Return the height below which the ground may carry the vehicle [m]."""
        is_landing = self._flight.step.situation is Situation.LANDING
        if is_landing and not self._vehicle.mocap_required:
            return _TRACKED_SATELLITES_ABOVE_M
        if view.is_dead_reckoned:
            return _TRACKED_BLIND_ABOVE_M
        return _TRACKED_ABOVE_M

    def _corrections_facts(self, view: FlightView, context: TickContext) -> CorrectionsFacts:
        """Return the facts about satellites of a vehicle that uses corrections."""
        corrections = self._own.corrections
        status = context.corrections
        if corrections is None or status is None:
            return CorrectionsFacts()

        snapshot = view.snapshot
        fix_below = ""
        if fix.is_below(snapshot, corrections, view.now_ns):
            fix_below = fix.words_of(snapshot.fix_type)
        worst_m = max(snapshot.accuracy_m(view.now_ns), snapshot.fix_accuracy_m)

        # the age is infinite before the first corrections, but that does not count as too old
        old_s = 0.0
        if math.isfinite(status.age_s) and status.age_s > corrections.max_age_s:
            old_s = status.age_s
        return CorrectionsFacts(
            fix_below=fix_below,
            is_position_coarse=worst_m > corrections.hold_accuracy_m,
            base_fault=status.base.words,
            old_s=old_s,
        )

    def _carries_its_weight(self, view: FlightView) -> bool:
        """Return whether the motors carry the vehicle, and the battery reports that load.

        The voltage falls from its idle value when the vehicle takes off.
        """
        step = self._flight.step
        if step.situation in (Situation.GROUND, Situation.ARMED, Situation.LIFTOFF):
            return False
        return step is not FlightStep.CLIMB or self._flight.seconds(view) > _LOAD_KNOWN_S

    def _slow_facts(self, view: FlightView, context: TickContext, height_m: float) -> SlowFacts:
        now_ns = view.now_ns
        neighbours = self._neighbours.update_slowly(view)
        battery_frac, battery_voltage_v = view.snapshot.battery(now_ns)

        if not self._carries_its_weight(view):
            self._battery.reset()
        else:
            self._battery.update(
                now_ns * 1e-9,
                battery_frac,
                battery_voltage_v,
                land_frac=0.01 * self._limits.battery_land_pct,
                descent_s=climb_duration_s(height_m, self._vehicle.max_speed_m_s),
                floor_frac=context.battery_floor_frac,
            )

        px4_height_accuracy_m = 0.0
        if self._own.uses_heights:
            px4_height_accuracy_m = view.snapshot.height_accuracy_m

        return SlowFacts(
            px4_accuracy_m=view.snapshot.accuracy_m(now_ns),
            px4_height_accuracy_m=px4_height_accuracy_m,
            has_lost_satellites=self._own.has_lost_satellites,
            is_position_late=self._own.fit.is_late,
            position_miss_m=self._own.fit.miss_m,
            corrections=self._corrections_facts(view, context),
            battery_frac=battery_frac,
            is_battery_falling=self._battery.is_falling,
            wind=self._wind.facts(self._own, context),
            clock_jump_ns=max(self._own.validator.clock_jump_ns, context.clock_jump_ns),
            without_position=neighbours.without_position,
            blind=neighbours.blind,
            late=neighbours.late,
            other_files=neighbours.other_files,
            implausible=neighbours.implausible,
            uncooperative=neighbours.uncooperative,
            too_windy_for=neighbours.too_windy_for,
            endangered=neighbours.endangered,
        )


def _tick_length_s(context: TickContext) -> float:
    """Return the time since the last tick [s], within bounds also when the clock jumps."""
    return min(max(context.period_s, 0.0), _LONGEST_TICK_S)
