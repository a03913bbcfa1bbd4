"""The alarm table: condition -> severity, sentence, advice. Pure data.

Every condition of the failsafe table has a row, and so has every condition that the ground detects itself. The worst
come first.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

from onboard.safety.failsafe_table import Condition


class Severity(IntEnum):
    """Urgency of an alarm."""

    NOTE = 0  # for information
    WARNING = 1  # look into it
    CRITICAL = 2  # act now


class Ground(Enum):
    """Conditions that the ground detects itself, beside those that a vehicle reports."""

    SILENT = "vehicle silent"
    FAILED = "vehicle failed"
    UNKNOWN = "condition unknown to this console"
    CLOSE = "too close"
    COLLIDED = "collided"
    LAW_STRAINED = "avoidance at its limit"
    LAW_OFF = "avoidance off"
    WAITING = "waiting for vehicles"
    FILES_DIFFER = "fleet files differ"
    RECORD_ENDED = "record ended"
    PROCESS_ENDED = "process ended"
    KILLED = "killed in the air"


Kind = Condition | Ground


@dataclass(frozen=True, slots=True)
class AlarmRow:
    """One row of the table."""

    in_flight: Severity  # while the vehicle flies
    on_ground: Severity  # while it does not
    sentence: str  # {who} is a vehicle or several, {what} a number, name or reason
    advice: str


_NOTE, _WARN, _CRIT = Severity.NOTE, Severity.WARNING, Severity.CRITICAL
_C, _G = Condition, Ground

TABLE: dict[Kind, AlarmRow] = {
    _G.COLLIDED: AlarmRow(_CRIT, _CRIT, "{who} collided", "Land all; look at the vehicle before it flies again."),
    _G.KILLED: AlarmRow(_CRIT, _CRIT, "{who}: {what}", "Keep off until its motors stand; hold or land the others."),
    _G.CLOSE: AlarmRow(_CRIT, _NOTE, "{who}: {what}", "Hold or land one of them."),
    _G.SILENT: AlarmRow(
        _CRIT, _WARN, "{who}: silent", "Keep clear, RC switch ready: its failsafe lands it. Is its agent running?"
    ),
    _G.FAILED: AlarmRow(_CRIT, _WARN, "{who} failed: {what}", "Keep clear; see its page (enter) for the reason."),
    _C.AUTOPILOT_SILENT: AlarmRow(
        _CRIT, _WARN, "{who}: PX4 is silent", "RC switch ready. Check the cable and power between computer and PX4."
    ),
    _C.POSITION_LOST: AlarmRow(
        _CRIT, _WARN, "{who}: own position lost", "PX4 lands it. Check whether mocap tracks the body and its markers."
    ),
    _C.NOT_FINITE_LONG: AlarmRow(
        _CRIT, _WARN, "{who}: its law gives no finite thrust", "PX4 lands it. Keep its record and log."
    ),
    _C.FALLEN: AlarmRow(
        _CRIT, _CRIT, "{who} is on the ground though it should fly", "Keep off until its motors stand."
    ),
    _C.COLLISION_SUSPECTED: AlarmRow(
        _CRIT, _WARN, "{who}: may have touched a neighbour", "It lands. Hold the others; look at both before they fly."
    ),
    _C.DISARMED: AlarmRow(_CRIT, _NOTE, "{who}: PX4 disarmed in flight", "Keep clear. Who used the kill switch?"),
    _C.REBOOTED: AlarmRow(
        _CRIT, _WARN, "{who}: PX4 rebooted", "Keep clear; check its power and its log before it flies."
    ),
    _C.AUTOPILOT_FROZEN: AlarmRow(
        _CRIT, _WARN, "{who}: PX4's clock stands still", "RC switch ready. Restart PX4 on the ground."
    ),
    _C.HEARTBEAT_LOST: AlarmRow(
        _CRIT, _WARN, "{who}: no heartbeat from PX4", "It lands. RC switch ready; check the link."
    ),
    _C.ATTITUDE_NOT_FOLLOWED: AlarmRow(
        _CRIT, _WARN, "{who}: its attitude does not follow", "PX4 lands it. Check motors, propellers and OFFBOARD."
    ),
    _C.NOT_CLIMBING: AlarmRow(
        _CRIT, _WARN, "{who}: sinks with full thrust", "It lands. Check battery, load, propellers."
    ),
    _C.BATTERY_FALLING: AlarmRow(
        _CRIT, _WARN, "{who}: battery falling fast{what}", "It lands now. Change the battery."
    ),
    _C.MOCAP_SWAPPED: AlarmRow(
        _CRIT,
        _WARN,
        "{who}: mocap tracks it under another name",
        "It holds; PX4 lands it if this lasts. Check the markers.",
    ),
    _C.MOCAP_FROZEN: AlarmRow(
        _CRIT, _WARN, "{who}: mocap repeats the same pose", "It holds; PX4 lands it if this lasts. Check the source."
    ),
    _C.POSITION_JUMPED: AlarmRow(
        _CRIT, _WARN, "{who}: own position jumped", "It holds; PX4 lands it if this lasts. Check the markers."
    ),
    _C.NEIGHBOUR_UNSEEN: AlarmRow(
        _CRIT, _WARN, "{who}: a neighbour is silent and not seen", "It holds. Find that one; land all if in doubt."
    ),
    _C.LAW_INFEASIBLE: AlarmRow(
        _CRIT, _NOTE, "{who}: avoidance finds no safe thrust", "It holds. Hold or land its neighbours."
    ),
    _C.TWIN: AlarmRow(_CRIT, _WARN, "{who}: two agents run for it", "End one of them: no take-off while both run."),
    _C.SEPARATION_BREACHED: AlarmRow(
        _CRIT, _WARN, "{who}: closer to a neighbour than the limit", "The law pushes apart; hold the others."
    ),
    _C.FENCE_BREACH_LONG: AlarmRow(_CRIT, _WARN, "{who}: outside the fence for long", "It lands. Keep clear."),
    _C.FENCE_BREACH: AlarmRow(_CRIT, _WARN, "{who}: outside the fence", "It holds. Move it back, or land it."),
    _C.BATTERY_LOW: AlarmRow(
        _CRIT, _WARN, "{who}: battery at the landing level{what}", "It lands now. Change the battery."
    ),
    _C.LEFT_OFFBOARD: AlarmRow(
        _CRIT, _WARN, "{who}: PX4 left OFFBOARD{what}", "Another pilot or program flies it. Ask the RC pilot."
    ),
    _C.PX4_FAILSAFE: AlarmRow(
        _CRIT, _WARN, "{who}: PX4 left OFFBOARD by its own failsafe", "PX4 lands it. Its status text says why."
    ),
    _C.LOOP_STALLED_LONG: AlarmRow(_CRIT, _WARN, "{who}: its loop stood still for long", "PX4 lands it. See its log."),
    _C.BUS_LOST_LONG: AlarmRow(_CRIT, _WARN, "{who}: hears nobody on the bus for long", "It lands. Check its network."),
    _G.PROCESS_ENDED: AlarmRow(_CRIT, _WARN, "{what}", "Read its log in the flight folder."),
    _G.RECORD_ENDED: AlarmRow(_CRIT, _WARN, "{what}", "The flight goes on unrecorded: land, and free some space."),
    _C.POSITION_STALE: AlarmRow(
        _CRIT, _WARN, "{who}: own position stale", "Check mocap or GPS; it lands if this lasts."
    ),
    _C.NOT_FINITE: AlarmRow(_WARN, _WARN, "{who}: its law once gave no finite thrust", "Land it if this comes back."),
    _C.CEILING: AlarmRow(_WARN, _WARN, "{who}: above the ceiling", "It comes down and holds."),
    _C.FENCE_NEAR: AlarmRow(
        _WARN, _NOTE, "{who}: about to cross the fence", "It slows down. Hold it if this comes back."
    ),
    _C.SEPARATION_PREDICTED: AlarmRow(
        _WARN, _NOTE, "{who}: will come too close to a neighbour", "It slows down. Hold one of them."
    ),
    _C.AUTOPILOT_BACK: AlarmRow(
        _WARN, _NOTE, "{who}: PX4 had stood still", "It holds. Land it, and look for the cause in PX4's log."
    ),
    _C.ORDER_OVERDUE: AlarmRow(_WARN, _NOTE, "{who}: its order took too long", "It holds. Look for what blocks it."),
    _C.LOOP_STALLED: AlarmRow(_WARN, _WARN, "{who}: its loop stood still", "It holds. Is its computer overloaded?"),
    _C.BUS_LOST: AlarmRow(
        _WARN, _WARN, "{who}: hears nobody on the bus", "It holds. Check its network; it lands if this lasts."
    ),
    _C.NEIGHBOUR_SILENT: AlarmRow(
        _WARN,
        _WARN,
        "{who}: a neighbour is silent",
        "It keeps clear of that one's possible positions. Land the silent one.",
    ),
    _C.NEIGHBOUR_INVALID: AlarmRow(
        _WARN,
        _WARN,
        "{who}: a neighbour does not know its position",
        "It keeps clear of that one's possible positions. Check mocap.",
    ),
    _C.NEIGHBOUR_UNCOOPERATIVE: AlarmRow(
        _WARN, _WARN, "{who}: a neighbour does not fly as it says", "Look at that one; land it if this comes back."
    ),
    _C.NEIGHBOUR_STALE: AlarmRow(
        _WARN, _NOTE, "{who}: a neighbour's messages are late", "It slows down. Check the network."
    ),
    _C.NEIGHBOUR_BACK: AlarmRow(
        _WARN, _NOTE, "{who}: a neighbour is heard again", "Look at that one's page for the reason."
    ),
    _C.CONFIG_DIFFERS: AlarmRow(
        _WARN, _WARN, "{who}: a neighbour has another fleet file", "Give all the same one and restart the agents."
    ),
    _C.MOCAP_LATE: AlarmRow(
        _WARN, _WARN, "{who}: mocap is late", "It slows down. Check the load of the mocap's computer."
    ),
    _C.CLOCK_JUMPED: AlarmRow(
        _WARN, _WARN, "{who}: a clock jumped", "No take-off for a moment. Check its time synchronisation."
    ),
    _C.DISK_FULL: AlarmRow(_WARN, _WARN, "{who}: its disk is full", "No take-off. Free some space."),
    _C.THRUST_SATURATED: AlarmRow(
        _WARN, _NOTE, "{who}: thrust at its limit", "It slows down. Too heavy, or the battery is weak."
    ),
    _C.GROUND_LOST: AlarmRow(_WARN, _NOTE, "{who}: does not hear the ground", "Check the network from it to here."),
    _C.BATTERY_WARNING: AlarmRow(_WARN, _WARN, "{who}: battery low{what}", "Plan its landing."),
    _C.LOOP_LATE: AlarmRow(_WARN, _NOTE, "{who}: its loop is late", "Is its computer overloaded?"),
    _C.SHUTDOWN: AlarmRow(_WARN, _NOTE, "{who}: its agent was asked to stop", "It lands first. Start it again to fly."),
    _G.LAW_STRAINED: AlarmRow(
        _WARN, _NOTE, "{who}: avoidance cannot keep every limit at once", "Give it room: hold or land a neighbour."
    ),
    _G.LAW_OFF: AlarmRow(_WARN, _NOTE, "{who}: avoidance is off", "Nothing keeps it from the others but you."),
    _G.UNKNOWN: AlarmRow(_WARN, _WARN, "{who}: {what}", "This console is older than the agent: update it."),
    _G.FILES_DIFFER: AlarmRow(
        _WARN, _WARN, "The vehicles read different fleet files", "Give all the same one and restart the agents."
    ),
    _G.WAITING: AlarmRow(_WARN, _NOTE, "Waiting for {who}", "Start the agents, or try covey demo."),
}
RANKS = {kind: rank for rank, kind in enumerate(TABLE)}
BY_TEXT = {condition.value: condition for condition in Condition}
# of two that say the same, only the worse one is shown
COVERED: dict[Kind, Kind] = {
    _C.POSITION_STALE: _C.POSITION_LOST,
    _C.NOT_FINITE: _C.NOT_FINITE_LONG,
    _C.LOOP_STALLED: _C.LOOP_STALLED_LONG,
    _C.BUS_LOST: _C.BUS_LOST_LONG,
    _C.FENCE_BREACH: _C.FENCE_BREACH_LONG,
    _C.BATTERY_WARNING: _C.BATTERY_LOW,
    _C.PX4_FAILSAFE: _C.REBOOTED,
    _C.LEFT_OFFBOARD: _C.REBOOTED,
    _C.HEARTBEAT_LOST: _C.AUTOPILOT_SILENT,
    _C.AUTOPILOT_FROZEN: _C.AUTOPILOT_SILENT,
    _C.POSITION_JUMPED: _C.MOCAP_SWAPPED,
    _C.NEIGHBOUR_SILENT: _C.NEIGHBOUR_UNSEEN,
    _C.SEPARATION_PREDICTED: _C.SEPARATION_BREACHED,
    _C.SEPARATION_BREACHED: _C.COLLISION_SUSPECTED,
    _C.THRUST_SATURATED: _C.NOT_CLIMBING,
    _C.FENCE_NEAR: _C.FENCE_BREACH,
    _C.CEILING: _C.FENCE_BREACH,
    _C.LOOP_LATE: _C.LOOP_STALLED,
}
