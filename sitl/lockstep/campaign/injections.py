"""The table of injected faults: one row for each, with the conditions that vehicles have to notice.

Tests and ``covey evidence`` fly a mission once with each row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.safety.failsafe_table import Condition as C
from sitl.lockstep.campaign.breaking import (
    LIES,
    Inject,
    bad_bus,
    cut,
    cut_ground,
    fault,
    hang,
    hang_ground,
    hang_ground_for_long,
    kill,
    kill_and_start,
    kill_ground,
    landed_state,
    lies,
    nonsense,
    order,
    order_above,
    order_into_another,
    order_outside,
    pilot,
    repeated,
    slow_ground,
    some_wrong_report,
    starve_ground,
    stop_agent,
    stops,
    swap,
    tick_fails,
    to_all_vehicles,
    wind_rises,
    without_law,
    wrong_report,
)
from sitl.px4.modes import Mode


@dataclass(frozen=True, slots=True)
class Injection:
    """One fault, what has to be noticed of it, and what is excused because of it.

    Args:
        name: its name in reports.
        inject: injects it.
        own: conditions of which the vehicle itself has to notice at least one; empty: none.
        others: conditions of which at least one other vehicle has to notice at least one.
        is_silenced: whether the vehicle stops avoiding; distances to it are judged separately.
        is_cut_off: whether the ground may miss the events about it.
        may_leave_fence: whether the vehicle may leave the fence, because only PX4 flies it, or
            nothing controls it.
        is_falling: whether it falls faster than others can avoid it, so that bodies may touch.
        is_astray: whether it has less thrust than the law counts on, or follows a wrong position.
            Then no bodies may touch, but the law's distance is not promised.
        is_blind: whether all vehicles have lost their poses; they then keep BLIND_SHARE of the
            safety distance.
        has_false_height: whether its height may be false, so that it may touch down hard.
        rises_m: how much the vehicle may climb after the fault.
        needs: the fault is possible only for vehicles with ``poses`` of a motion capture, with
            ``satellites``, with a ``camera``, or with required ``corrections``; empty: for all.
        needs_global_position: whether PX4 has to know its place on Earth, as for its Hold mode.
            With a camera alone it does not.
        is_of_two: whether it needs another vehicle.
        is_of_all: whether it hits all vehicles, so that all of them have to be of that kind.
    """

    name: str
    inject: Inject
    own: frozenset[C] = frozenset()
    others: frozenset[C] = frozenset()
    is_silenced: bool = False
    is_cut_off: bool = False
    may_leave_fence: bool = False
    is_falling: bool = False
    is_astray: bool = False
    is_blind: bool = False
    has_false_height: bool = False
    rises_m: float = math.inf
    needs: str = ""
    needs_global_position: bool = False
    is_of_two: bool = False
    is_of_all: bool = False

    def excuses_touchdown(self, name: str, victim: str) -> bool:
        """Return whether a vehicle may touch down hard, because its height may be false.

        Args:
            name: name of the vehicle.
            victim: name of the vehicle that the fault hits.
        """
        is_hit = self.is_of_all or name == victim
        return is_hit and self.has_false_height


def _f(*conditions: C) -> frozenset[C]:
    """Return conditions as a set; the name is short, because the table is full of it."""
    return frozenset(conditions)


# conditions of a vehicle without poses, and of one that misses the messages of a neighbour
_POSITION = (C.POSITION_STALE, C.POSITION_LOST)
_SILENT = _f(C.NEIGHBOUR_SILENT, C.NEIGHBOUR_UNSEEN, C.NEIGHBOUR_STALE)

INJECTIONS: tuple[Injection, ...] = (
    Injection("mocap lost for good", fault("mocap_lost"), own=_f(*_POSITION), needs="poses"),
    Injection(
        "poses of all lost for good",
        to_all_vehicles(fault("mocap_lost")),
        own=_f(*_POSITION),
        is_blind=True,
        needs="poses",
        is_of_all=True,
    ),
    Injection(
        "poses of all lost for 0.5 s",
        to_all_vehicles(fault("mocap_lost", 0.5)),
        own=_f(C.POSITION_STALE),
        is_blind=True,
        needs="poses",
        is_of_all=True,
    ),
    Injection(
        "poses of all lost for 1.5 s",
        to_all_vehicles(fault("mocap_lost", 1.5)),
        own=_f(*_POSITION),
        is_blind=True,
        needs="poses",
        is_of_all=True,
    ),
    Injection(
        "mocap lost for 0.35 s", fault("mocap_lost", 0.35), own=_f(*_POSITION), needs="poses"
    ),
    Injection(
        "mocap jumps for 0.4 s",
        fault("mocap_jump", 0.4, east_m=1.0),
        own=_f(C.POSITION_JUMPED, C.MOCAP_SWAPPED),
        needs="poses",
    ),
    Injection(
        "mocap jumps for good",
        fault("mocap_jump", north_m=-0.8),
        own=_f(C.POSITION_JUMPED, C.MOCAP_SWAPPED, *_POSITION),
        needs="poses",
    ),
    Injection(
        "mocap swaps two",
        swap(1.0),
        own=_f(C.MOCAP_SWAPPED, C.POSITION_JUMPED, *_POSITION),
        is_silenced=True,
        may_leave_fence=True,
        is_astray=True,
        needs="poses",
        is_of_two=True,
    ),
    Injection(
        "mocap frozen for 0.3 s", fault("mocap_frozen", 0.3), own=_f(C.MOCAP_FROZEN), needs="poses"
    ),
    Injection(
        "mocap frozen for good", fault("mocap_frozen"), own=_f(C.MOCAP_FROZEN), needs="poses"
    ),
    Injection(
        "poses of all frozen for good",
        to_all_vehicles(fault("mocap_frozen")),
        own=_f(C.MOCAP_FROZEN),
        is_blind=True,
        needs="poses",
        is_of_all=True,
    ),
    Injection(
        "mocap 0.15 s late",
        fault("mocap_late", 2.0, delay_s=0.15),
        own=_f(C.MOCAP_LATE, *_POSITION),
        needs="poses",
    ),
    Injection(
        "PX4 silent",
        fault("link_loss", 1.0, share=1.0, direction="out"),
        own=_f(C.AUTOPILOT_SILENT),
        is_silenced=True,
        may_leave_fence=True,
    ),
    Injection(
        "PX4 deaf",
        fault("link_loss", share=1.0, direction="in"),
        # PX4's failsafe lands a vehicle that has just lifted off before anything else is noticed
        own=_f(
            C.ATTITUDE_NOT_FOLLOWED,
            C.PX4_FAILSAFE,
            C.LEFT_OFFBOARD,
            C.THRUST_SATURATED,
            C.FALLEN,
        ),
        is_silenced=True,
        may_leave_fence=True,
    ),
    Injection("a tenth of the link lost", fault("link_loss", share=0.1)),
    Injection(
        "PX4 hangs for 0.6 s",
        fault("autopilot_hang", 0.6),
        own=_f(C.AUTOPILOT_FROZEN, C.AUTOPILOT_SILENT, C.AUTOPILOT_BACK),
        is_silenced=True,
        may_leave_fence=True,
    ),
    Injection(
        "PX4 reboots",
        fault("autopilot_reboot"),
        own=_f(C.REBOOTED, C.DISARMED, C.AUTOPILOT_SILENT, C.AUTOPILOT_FROZEN),
        is_silenced=True,
        may_leave_fence=True,
    ),
    Injection("PX4's clock drifts", fault("clock_drift", ms_per_s=-8.0)),
    Injection(
        "PX4 ignores setpoints",
        fault("setpoints_ignored"),
        own=_f(C.ATTITUDE_NOT_FOLLOWED, C.NOT_CLIMBING, C.FALLEN, C.ORDER_OVERDUE),
        is_silenced=True,
        may_leave_fence=True,
    ),
    Injection(
        "a pilot takes over",
        pilot(Mode.LOITER),
        own=_f(C.LEFT_OFFBOARD),
        is_silenced=True,
        may_leave_fence=True,
        needs_global_position=True,
    ),
    Injection(
        "a pilot lands", pilot(Mode.LAND), own=_f(C.LEFT_OFFBOARD, C.PX4_FAILSAFE), is_silenced=True
    ),
    Injection("agent killed", kill, others=_SILENT, is_silenced=True, may_leave_fence=True),
    Injection(
        "agent killed and started",
        kill_and_start,
        others=_SILENT,
        is_silenced=True,
        may_leave_fence=True,
    ),
    Injection("agent hangs for 0.15 s", hang(0.15), own=_f(C.LOOP_STALLED, C.LOOP_LATE)),
    Injection(
        "agent hangs for 1 s",
        hang(1.0),
        own=_f(C.LOOP_STALLED, C.LOOP_STALLED_LONG, C.PX4_FAILSAFE),
        others=_SILENT,
        is_silenced=True,
        may_leave_fence=True,
    ),
    Injection(
        "agent hangs for good",
        hang(math.inf),
        others=_SILENT,
        is_silenced=True,
        may_leave_fence=True,
    ),
    Injection("agent is asked to stop", stop_agent, own=_f(C.SHUTDOWN)),
    Injection("ticks fail for 0.1 s", tick_fails(5), own=_f(C.NOT_FINITE)),
    Injection(
        "ticks fail for 1 s",
        tick_fails(50),
        own=_f(C.NOT_FINITE, C.NOT_FINITE_LONG),
        is_silenced=True,
        may_leave_fence=True,
    ),
    Injection(
        "cut off from all for 1 s",
        cut(1.0),
        own=_f(*_POSITION, C.BUS_LOST),
        others=_SILENT,
        is_silenced=True,
        is_cut_off=True,
        may_leave_fence=True,
        needs="poses",
    ),
    Injection(
        "cut off from all but the mocap",
        cut(1.0, keeps=("sitl",)),
        own=_SILENT,
        others=_SILENT,
        is_cut_off=True,
        is_of_two=True,
    ),
    Injection(
        "all cut apart, mocap stays",
        cut(6.0, keeps=("sitl",), all_agents=True),
        own=_f(C.BUS_LOST, C.BUS_LOST_LONG, *_SILENT),
        is_cut_off=True,
        is_of_two=True,
    ),
    Injection("ground lost", cut_ground(2.0), own=_f(C.GROUND_LOST), is_cut_off=True),
    Injection(
        "ground lost for good",
        cut_ground(math.inf),
        own=_f(C.GROUND_LOST_LONG),
        others=_f(C.GROUND_LOST_LONG),
        is_cut_off=True,
        # A ground that does not hear its only vehicle takes the agent for hung, and lands the
        # vehicle past it.
        is_of_two=True,
    ),
    Injection("bad bus", bad_bus, is_of_two=True),
    Injection("nonsense on the bus", nonsense, is_of_two=True),
    Injection(
        "battery cell fails",
        fault("battery_cell", drop_pct=80.0),
        # PX4's own failsafe may be the first to act on it
        own=_f(C.BATTERY_LOW, C.BATTERY_FALLING, C.BATTERY_WARNING, C.PX4_FAILSAFE),
    ),
    Injection(
        "motor weak", fault("motor_weak", 3.0, motor=2.0, effectiveness=0.85), is_astray=True
    ),
    Injection(
        "motor dead",
        fault("motor_dead", motor=1.0),
        own=_f(
            C.ATTITUDE_NOT_FOLLOWED,
            C.NOT_CLIMBING,
            C.FALLEN,
            C.DISARMED,
            C.PX4_FAILSAFE,
            C.LEFT_OFFBOARD,
            C.POSITION_JUMPED,
        ),  # in a fall from 0.25 m the impact (POSITION_JUMPED) is the first sign
        is_silenced=True,
        may_leave_fence=True,
        is_falling=True,
        is_astray=True,
    ),
    Injection("PX4's own vision lost", fault("vision_lost", 3.0), needs="poses"),
    Injection("PX4 reports the ground for 0.5 s", landed_state(0.5, is_repeated=True)),
    Injection("PX4's last report of the ground stays", landed_state(math.inf, is_repeated=False)),
    Injection("PX4's landed state stops", stops("landed"), own=_f(C.LANDED_UNKNOWN)),
    Injection("PX4's battery reports stop", stops("battery_frac", "battery_voltage_v")),
    Injection("one wrong report of PX4", some_wrong_report),
    Injection(
        "wrong reports of PX4 for 5 s",
        repeated(wrong_report("another mode"), 9, 0.6),
        own=_f(C.REPORTS_CONTRADICT_LONG),
    ),
    Injection(
        "one flies without the law and says so",
        without_law,
        others=_f(C.CONFIG_DIFFERS),
        is_silenced=True,
    ),
    *(
        Injection(
            f"one lies: {name}",
            lies(lie),
            others=_f(C.NEIGHBOUR_IMPLAUSIBLE),
            is_silenced=True,
            needs="poses",
            is_of_two=True,
        )
        for name, lie in LIES.items()
    ),
    Injection("one is ordered to land", order("land"), rises_m=0.35),
    Injection("one is ordered to hold", order("hold"), rises_m=0.35),
    Injection("one is ordered to disarm", order("disarm")),
    Injection(
        "satellites lost",
        fault("gps_loss"),
        own=_f(C.SATELLITES_LOST),
        is_astray=True,
        needs="satellites",
    ),
    Injection(
        "satellites of all lost",
        to_all_vehicles(fault("gps_loss")),
        own=_f(C.SATELLITES_LOST),
        is_astray=True,
        needs="satellites",
        is_of_all=True,
    ),
    Injection(
        "receiver 0.5 s late", fault("gps_late", delay_s=0.5), is_astray=True, needs="satellites"
    ),
    Injection(
        "receiver drifts for 10 s",
        fault("gps_drift", 10.0, east_m_s=0.1),
        is_astray=True,
        needs="satellites",
    ),
    Injection("ground slow", slow_ground),
    Injection("ground starved", starve_ground),
    Injection("ground hangs for 3 s", hang_ground(3.0), own=_f(C.GROUND_LOST), is_cut_off=True),
    Injection(
        "ground hangs for long",
        hang_ground_for_long,
        own=_f(C.GROUND_LOST_LONG),
        others=_f(C.GROUND_LOST_LONG),
        is_cut_off=True,
    ),
    Injection(
        "ground killed",
        kill_ground,
        own=_f(C.GROUND_LOST_LONG),
        others=_f(C.GROUND_LOST_LONG),
        is_cut_off=True,
    ),
    Injection(
        "RTK lost for good",
        fault("rtk_lost"),
        own=_f(C.FIX_FELL_BACK, C.FIX_COARSE),
        is_astray=True,
        needs="corrections",
    ),
    Injection(
        "corrections of all lost",
        to_all_vehicles(fault("corrections_lost")),
        is_astray=True,
        needs="corrections",
        is_of_all=True,
    ),
    Injection("corrections garbled", fault("corrections_garbled"), needs="corrections"),
    Injection(
        "base says a place 30 m aside",
        fault("base_moved", east_m=30.0),
        own=_f(C.BASE_FAULT),
        is_astray=True,
        needs="corrections",
    ),
    Injection("odometry lost for good", fault("vision_lost"), own=_f(*_POSITION), needs="camera"),
    Injection("odometry lost for 0.6 s", fault("vision_lost", 0.6), needs="camera"),
    Injection(
        "odometry of all lost for good",
        to_all_vehicles(fault("vision_lost")),
        own=_f(*_POSITION),
        is_blind=True,
        needs="camera",
        is_of_all=True,
    ),
    Injection(
        "odometry of all lost for 2 s",
        to_all_vehicles(fault("vision_lost", 2.0)),
        own=_f(*_POSITION),
        is_blind=True,
        needs="camera",
        is_of_all=True,
    ),
    Injection(
        "odometry jumps for good",
        fault("vision_jump", east_m=0.5),
        own=_f(*_POSITION),
        needs="camera",
    ),
    Injection(
        "odometry turns for good",
        fault("vision_turned", yaw_deg=40.0),
        own=_f(*_POSITION),
        needs="camera",
    ),
    # a vehicle in a hover, whose camera shows that it hovers, has nothing to notice
    Injection(
        "odometry frozen",
        fault("vision_frozen"),
        is_astray=True,
        has_false_height=True,
        needs="camera",
    ),
    Injection(
        "odometry of all frozen",
        to_all_vehicles(fault("vision_frozen")),
        is_astray=True,
        has_false_height=True,
        needs="camera",
        is_of_all=True,
    ),
)

# further faults that only `covey evidence` flies: strong wind, and orders given by mistake
FIELD_INJECTIONS: tuple[Injection, ...] = (
    Injection("wind rises to twice the limit", wind_rises, is_astray=True),
    Injection("one is ordered outside the fence", order_outside),
    Injection("one is ordered above the ceiling", order_above),
    Injection("one is ordered into another", order_into_another, is_of_two=True),
)
