"""The questions of authorities about a fleet, and what Covey claims and flies for each. Pure data.

A row of :data:`HAZARDS` is a question that the documents of authorities ask in some form: what
happens when the link is lost, when one drone fails among others, and so on. The row names the
documents that ask it, the conditions of the failsafe table that answer it, the claimed action of a
*flying* vehicle for each condition, and the faults that are flown to show it.

The claimed actions repeat the failsafe table on purpose. If a row of that table is removed or
weakened, it contradicts the claim here, and the evidence shows the question as wrong.

The documents:

* SORA 2.5: Annex A.4 is a matrix of requirements, and of the places where the operator answers
  them. The requirements are operational safety objectives (OSO) and the containment of step 8. OSO
  #13 is about services that others provide: satellites are one; an operator's own motion capture or
  ground station is not.
* CAP 722E: the CAA of the United Kingdom asks these questions of an operator of rotary-wing
  aircraft that fly as a swarm within visual line of sight, as a part of the safety case.
* 14 CFR 107.35: nobody may fly more than one drone at a time without a waiver. A waiver is given to
  those who show how they remain safe.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from onboard.safety.failsafe_table import Action
from onboard.safety.failsafe_table import Condition as C

_GO_ON = Action.GO_ON
_SLOW = Action.SLOW
_HOLD = Action.HOLD
_LEVEL = Action.LEVEL
_LAND = Action.LAND
_PX4_LAND = Action.PX4_LAND
_STOP = Action.STOP

SWARM = "CAP 722E"
WAIVER = "14 CFR 107.35"


class Hazard(NamedTuple):
    """One row of the matrix."""

    key: str  # short name for tests and JSON
    question: str
    asked_by: tuple[str, ...]  # documents that ask it
    claims: dict[C, Action]  # condition -> action that a flying vehicle takes
    faults: tuple[str, ...]  # names of the campaign's faults that are flown for it
    remains: str  # what such flights do not show
    needs_pair: bool = False  # whether only flights with two vehicles in the air answer it


HAZARDS: tuple[Hazard, ...] = (
    Hazard(
        key="normal",
        question="Does the mission keep its place when nothing fails?",
        asked_by=("SORA 2.5 OSO #08", SWARM, WAIVER),
        claims={},
        faults=("nothing",),
        remains="real vehicles, real air",
    ),
    Hazard(
        key="distances",
        question="Do the drones keep their distances when nothing fails?",
        asked_by=("SORA 2.5 OSO #08", SWARM, WAIVER),
        claims={},
        faults=("nothing",),
        remains="real vehicles, real air",
        needs_pair=True,
    ),
    Hazard(
        key="c2-lost",
        question="What happens when the C2 link is lost, for one or for all?",
        asked_by=("SORA 2.5 OSO #06", SWARM, WAIVER),
        claims={
            C.GROUND_LOST: _GO_ON,
            C.GROUND_LOST_LONG: _LAND,
            C.BUS_LOST: _HOLD,
            C.BUS_LOST_LONG: _LAND,
        },
        faults=(
            "ground lost",
            "ground lost for good",
            "cut off from all for 1 s",
            "cut off from all but the mocap",
            "all cut apart, mocap stays",
        ),
        remains="the range and the interference of the radio at the place",
    ),
    Hazard(
        key="c2-degraded",
        question="What happens when the C2 link is bad: late, lossy, disordered?",
        asked_by=("SORA 2.5 OSO #06", SWARM),
        claims={C.NEIGHBOUR_STALE: _SLOW},
        faults=("bad bus", "a tenth of the link lost", "PX4's clock drifts", "ground slow"),
        remains="the quality of the radio at the place",
    ),
    Hazard(
        key="ground-fails",
        question="What happens when the ground station fails?",
        asked_by=("SORA 2.5 OSO #05", WAIVER),
        claims={C.GROUND_LOST_LONG: _LAND, C.ORDER_OVERDUE: _HOLD},
        faults=(
            "ground starved",
            "ground hangs for 3 s",
            "ground hangs for long",
            "ground killed",
        ),
        remains="the power supply and the screens of the ground station",
    ),
    Hazard(
        key="gnss-lost",
        question="What happens when GNSS is lost, for one or for all?",
        asked_by=("SORA 2.5 OSO #13", SWARM, WAIVER),
        claims={C.SATELLITES_LOST: _LAND, C.POSITION_INACCURATE: _LAND},
        faults=("satellites lost", "satellites of all lost"),
        remains="jamming, spoofing and reflections at the place",
    ),
    Hazard(
        key="gnss-wrong",
        question="What happens when GNSS is wrong: late, or drifting?",
        asked_by=("SORA 2.5 OSO #13", SWARM),
        claims={C.POSITION_UNFIT: _LAND},
        faults=("receiver 0.5 s late", "receiver drifts for 10 s"),
        remains="two receivers that drift towards each other are not noticed (docs/failsafe.md)",
    ),
    Hazard(
        key="corrections",
        question="What happens when RTK corrections end, are damaged, or come from a wrong base?",
        asked_by=("SORA 2.5 OSO #13", SWARM),
        claims={
            C.FIX_COARSE: _HOLD,
            C.FIX_FELL_BACK: _SLOW,
            C.BASE_FAULT: _GO_ON,
            C.CORRECTIONS_OLD: _GO_ON,
        },
        faults=(
            "RTK lost for good",
            "corrections of all lost",
            "corrections garbled",
            "base says a place 30 m aside",
        ),
        remains="a base that says the right place and measures falsely (docs/threats.md)",
    ),
    Hazard(
        key="tracking-lost",
        question="What happens when the motion capture loses one or all?",
        asked_by=("SORA 2.5 OSO #05", SWARM),
        claims={
            C.POSITION_STALE: _GO_ON,
            C.POSITION_LOST: _LAND,
            C.POSITION_LOST_LONG: _PX4_LAND,
        },
        faults=(
            "mocap lost for good",
            "mocap lost for 0.35 s",
            "poses of all lost for good",
            "poses of all lost for 0.5 s",
            "poses of all lost for 1.5 s",
            "PX4's own vision lost",
        ),
        remains="the cameras, their mounts and their computer",
    ),
    Hazard(
        key="tracking-wrong",
        question="What happens when the motion capture is wrong?",
        asked_by=("SORA 2.5 OSO #05", SWARM),
        claims={
            C.POSITION_JUMPED: _HOLD,
            C.MOCAP_SWAPPED: _HOLD,
            C.MOCAP_FROZEN: _HOLD,
            C.MOCAP_LATE: _SLOW,
        },
        faults=(
            "mocap jumps for 0.4 s",
            "mocap jumps for good",
            "mocap swaps two",
            "mocap frozen for 0.3 s",
            "mocap frozen for good",
            "poses of all frozen for good",
            "mocap 0.15 s late",
        ),
        remains="a body that is lost slowly is not noticed (docs/failsafe.md)",
    ),
    Hazard(
        key="odometry",
        question="What happens when the visual odometry of one or all is lost or wrong?",
        asked_by=("SORA 2.5 OSO #05", SWARM),
        claims={C.POSITION_STALE: _GO_ON, C.POSITION_LOST: _LAND},
        faults=(
            "odometry lost for good",
            "odometry lost for 0.6 s",
            "odometry of all lost for good",
            "odometry of all lost for 2 s",
            "odometry jumps for good",
            "odometry turns for good",
            "odometry frozen",
            "odometry of all frozen",
        ),
        remains="odometry that drifts slowly, or that is late, is not noticed (docs/failsafe.md)",
    ),
    Hazard(
        key="autopilot",
        question="What happens when the autopilot fails?",
        asked_by=("SORA 2.5 OSO #05", SWARM, WAIVER),
        claims={
            C.REBOOTED: _STOP,
            C.AUTOPILOT_SILENT: _STOP,
            C.AUTOPILOT_IMPOSSIBLE: _STOP,
            C.AUTOPILOT_FROZEN: _STOP,
            C.AUTOPILOT_BACK: _HOLD,
            C.HEARTBEAT_LOST: _LAND,
            C.PX4_FAILSAFE: _STOP,
        },
        faults=("PX4 silent", "PX4 deaf", "PX4 hangs for 0.6 s", "PX4 reboots"),
        remains="PX4 itself: an emulated one is flown, measured beside it (docs/sitl.md)",
    ),
    Hazard(
        key="autopilot-reports",
        question="What happens when the autopilot's reports are wrong or missing?",
        asked_by=("SORA 2.5 OSO #05",),
        claims={
            C.REPORTS_CONTRADICT: _GO_ON,
            C.REPORTS_CONTRADICT_LONG: _LAND,
            C.LANDED_UNKNOWN: _GO_ON,
            C.LANDED_WRONG: _LAND,
        },
        faults=(
            "PX4 reports the ground for 0.5 s",
            "PX4's last report of the ground stays",
            "PX4's landed state stops",
            "one wrong report of PX4",
            "wrong reports of PX4 for 5 s",
        ),
        remains="sensors that fail inside of PX4 without a word of it",
    ),
    Hazard(
        key="propulsion",
        question="What happens when a motor is weak or dead, or thrust is missing?",
        asked_by=("SORA 2.5 OSO #05", SWARM, WAIVER),
        claims={
            C.ATTITUDE_NOT_FOLLOWED: _PX4_LAND,
            C.THRUST_SATURATED: _SLOW,
            C.NOT_CLIMBING: _LAND,
            C.FALLEN: _STOP,
        },
        faults=("motor weak", "motor dead", "PX4 ignores setpoints"),
        remains="motors, propellers and speed controllers; a quadrotor without a motor falls",
    ),
    Hazard(
        key="battery",
        question="What happens when a battery fails, or is empty early?",
        asked_by=("SORA 2.5 OSO #05", SWARM, WAIVER),
        claims={
            C.BATTERY_WARNING: _GO_ON,
            C.BATTERY_LOW: _LAND,
            C.BATTERY_FALLING: _LAND,
            C.BATTERY_UNKNOWN: _LAND,
        },
        faults=("battery cell fails", "PX4's battery reports stop"),
        remains="real batteries, their age and their temperature",
    ),
    Hazard(
        key="computer",
        question="What happens when the computer or the program of a drone fails?",
        asked_by=("SORA 2.5 OSO #05", SWARM),
        claims={
            C.LOOP_LATE: _GO_ON,
            C.LOOP_STALLED: _HOLD,
            C.LOOP_STALLED_LONG: _PX4_LAND,
            C.CLOCK_JUMPED: _GO_ON,
            C.NOT_FINITE: _LEVEL,
            C.NOT_FINITE_LONG: _PX4_LAND,
            C.OWN_LAW_REFUSED: _GO_ON,
            C.DISK_FULL: _GO_ON,
            C.TWIN: _GO_ON,
            C.SHUTDOWN: _LAND,
        },
        faults=(
            "agent killed",
            "agent killed and started",
            "agent hangs for 0.15 s",
            "agent hangs for 1 s",
            "agent hangs for good",
            "agent is asked to stop",
            "ticks fail for 0.1 s",
            "ticks fail for 1 s",
        ),
        remains="the companion computer, its power supply and its memory card",
    ),
    Hazard(
        key="one-among-others",
        question="Does one failing drone endanger the others?",
        asked_by=(SWARM, WAIVER),
        claims={
            C.COLLISION_SUSPECTED: _LAND,
            C.SEPARATION_BREACHED: _SLOW,
            C.SEPARATION_PREDICTED: _SLOW,
            C.LAW_INFEASIBLE: _HOLD,
            C.NEIGHBOUR_UNSEEN: _HOLD,
            C.NEIGHBOUR_SILENT: _GO_ON,
            C.NEIGHBOUR_INVALID: _GO_ON,
            C.NEIGHBOUR_BLIND: _SLOW,
            C.NEIGHBOUR_BACK: _GO_ON,
        },
        faults=(
            "agent killed",
            "agent hangs for good",
            "PX4 silent",
            "PX4 ignores setpoints",
            "motor dead",
            "mocap lost for good",
            "satellites lost",
        ),
        remains="parts that fall from a drone; a drone below one that falls",
        needs_pair=True,
    ),
    Hazard(
        key="not-cooperating",
        question="What happens when one drone flies by other rules, or lies?",
        asked_by=(SWARM,),
        claims={
            C.NEIGHBOUR_UNCOOPERATIVE: _SLOW,
            C.NEIGHBOUR_IMPLAUSIBLE: _SLOW,
            C.CONFIG_DIFFERS: _SLOW,
        },
        faults=(
            "one flies without the law and says so",
            "one lies: a metre beside",
            "one lies: stands",
            "one lies: teleports",
            "nonsense on the bus",
        ),
        remains="an attack with stolen keys (docs/threats.md)",
        needs_pair=True,
    ),
    Hazard(
        key="envelope",
        question="Is the flight envelope kept: the fence, the ceiling, the largest tilt?",
        asked_by=("SORA 2.5 OSO #18", "SORA 2.5 step 8", SWARM, WAIVER),
        claims={
            C.FENCE_NEAR: _SLOW,
            C.FENCE_BREACH: _HOLD,
            C.FENCE_BREACH_LONG: _LAND,
            C.CEILING: _HOLD,
        },
        faults=("one is ordered outside the fence", "one is ordered above the ceiling"),
        remains="an independent system that ends a flight: Covey has none",
    ),
    Hazard(
        key="operator-error",
        question="What happens when the operator errs?",
        asked_by=("SORA 2.5 OSO #18", "SORA 2.5 OSO #19", WAIVER),
        claims={},
        faults=(
            "one is ordered to land",
            "one is ordered to hold",
            "one is ordered to disarm",
            "one is ordered into another",
        ),
        remains="the training of the pilot, and what he sees and decides",
    ),
    Hazard(
        key="pilot",
        question="Can a pilot take a drone?",
        asked_by=("SORA 2.5 OSO #19", SWARM, WAIVER),
        claims={
            C.FLOWN_BY_HAND: _STOP,
            C.LEFT_OFFBOARD: _STOP,
            C.DISARMED: _STOP,
        },
        faults=("a pilot takes over", "a pilot lands"),
        remains="how well he flies it",
    ),
    Hazard(
        key="pilot-among-others",
        question="Do the others keep away from a drone that a pilot has taken?",
        asked_by=("SORA 2.5 OSO #19", SWARM, WAIVER),
        claims={},
        faults=("a pilot takes over", "a pilot lands"),
        remains="how well he flies it",
        needs_pair=True,
    ),
    Hazard(
        key="wind",
        question="What happens in adverse conditions: a wind that rises above its limit?",
        asked_by=("SORA 2.5 OSO #23", "SORA 2.5 OSO #24", SWARM, WAIVER),
        claims={
            C.WIND_ABOVE: _LAND,
            C.PUSHED_ABOUT: _LAND,
            C.WIND_NEAR: _SLOW,
            C.DISTURBANCE_BOUND: _SLOW,
        },
        faults=("wind rises to twice the limit",),
        remains="real wind at the place, its turbulence behind buildings, rain, cold",
    ),
)

# What no simulated flight shows, each with the reason; the last rows of the table.
NOT_SHOWN: tuple[tuple[str, str], ...] = (
    (
        "Hardware",
        "no motor, sensor, frame, radio or battery was used; the vehicle is a model with the values"
        " of the fleet file",
    ),
    (
        "PX4",
        "an emulated autopilot was flown; how it was measured beside PX4 stands in docs/sitl.md",
    ),
    (
        "Flight termination",
        "Covey has no system that ends a flight independently of autopilot and agent",
    ),
    (
        "Pilot and crew",
        "licence, training, number of people, their procedures and their fitness",
    ),
    (
        "Real wind and weather",
        "the wind is a model: a mean with gusts of 15 %, the same for all vehicles",
    ),
    (
        "Ground risk and air risk",
        "who is below, and who else flies there: the buffer is geometry and no risk class",
    ),
    (
        "Radio and satellites at the place",
        "range, interference, jamming, and how many satellites are seen",
    ),
    (
        "Whether the fleet file describes your vehicles",
        "covey identify measures lag, drag and hover throttle of a real one",
    ),
    (
        "Faults that nobody has thought of",
        "what is broken here is a list; faults in pairs are not flown",
    ),
)


def claimed_action(conditions: Iterable[C]) -> Action:
    """Return the action that the claims demand of a flying vehicle in which conditions hold."""
    strongest = _GO_ON
    for condition in conditions:
        strongest = max(strongest, CLAIMS[condition])
    return strongest


CLAIMS: dict[C, Action] = {
    condition: action for hazard in HAZARDS for condition, action in hazard.claims.items()
}
