"""The judge of a flight with an injected fault: it checks every tick.

It judges ground truth and the setpoints that leave the agents, not what agents report about
themselves. It checks distances, the fence, the setpoints, and whether each vehicle does what its
conditions demand. At the end all vehicles must be down and disarmed, the events must name the
condition, and a user's own law must not have been refused.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections import Counter
from collections.abc import Callable, Collection

import numpy as np

from onboard.bus.schema import Truth
from onboard.bus.topics import Topic
from onboard.config.flight_space import flight_space_of
from onboard.config.pair_separation import separation_m
from onboard.flight.types import FlightStep
from onboard.safety.failsafe_table import WORDS, Action, Condition, Situation, decide
from onboard.types import AttitudeSetpoint
from sitl.lockstep.campaign.crossed_edges import beyond_m
from sitl.lockstep.campaign.injections import Injection
from sitl.lockstep.flight import Lockstep

_NODE = "watcher-judge"  # a fleet file may not give a vehicle a name that begins with "watcher-"
_FENCE_SLACK_M = 0.30
_TILT_SLACK_DEG = 0.5

# returns the action that conditions demand in a situation
ActionOf = Callable[[Situation, Collection[Condition]], Action]

# demanded action -> behaviours (words of _behaviour) that satisfy the demand: that action, and
# every stronger one. An armed vehicle that has not taken off stands on the ground, so it satisfies
# HOLD and LEVEL.
_SATISFYING: dict[Action, tuple[str, ...]] = {
    Action.HOLD: ("hold", "land", "px4", "failed", "armed"),
    Action.LEVEL: ("hold", "land", "px4", "failed", "armed"),
    Action.LAND: ("land", "px4", "failed"),
    Action.PX4_LAND: ("px4", "failed"),
    Action.STOP: ("failed",),
}

# conditions for which no event is required
_QUIET = {
    Condition.NOT_FINITE,
    Condition.LOOP_LATE,
    Condition.GROUND_LOST,
    Condition.SHUTDOWN,
}


def action_of_table(situation: Situation, conditions: Collection[Condition]) -> Action:
    """Return the action that the failsafe table demands."""
    action, _ = decide(situation, conditions)
    return action


class Judge:
    """Checks every tick of a flight.

    Args:
        flight: the flight, which has not begun.
        injection: the fault.
        victim: name of the vehicle that it hits.
        silenced: vehicles that stop avoiding after the fault; distances to them are noted
            separately.
        action_of: returns what a vehicle has to do; by default what the failsafe table says.
    """

    def __init__(
        self,
        flight: Lockstep,
        injection: Injection,
        victim: str,
        silenced: Collection[str],
        action_of: ActionOf = action_of_table,
    ) -> None:
        self.flight = flight
        self.injection = injection
        self.victim = victim
        self.silenced = frozenset(silenced)
        self.action_of = action_of
        self.areas = flight_space_of(flight.config).areas

        self._wrong: dict[str, None] = {}  # sentences, each once, in their order
        # vehicle -> condition -> number of ticks in which the vehicle noticed it
        self.seen: dict[str, Counter[Condition]] = {
            name: Counter() for name in flight.config.enabled_names
        }
        self.truths: dict[str, Truth] = {}

        # smallest distance [m] of pairs with 0, 1 or 2 silenced vehicles
        self.smallest = [math.inf, math.inf, math.inf]
        self.had_pair = False  # whether two vehicles were in the air at the same time

        self.is_injected = False
        self.was_flying = False  # whether all vehicles flew when the fault was injected
        self.highest_m = math.inf  # height that the victim may reach; no limit before the fault
        self.height_share = flight.config.fleet.height_share

        # by vehicle
        self._strongest: dict[str, Action] = {}  # strongest action demanded since its newest order
        self._newest_order_id: dict[str, str] = {}
        self._demanded: dict[str, Action] = {}  # action demanded in its last tick

        node = flight.bus.node(_NODE)
        node.start()
        node.subscribe(Topic.TRUTH, "*", self._truth_received)
        for shell in flight.agents.values():
            shell.link.send_attitude = functools.partial(  # type: ignore[method-assign]
                self._check_setpoint, shell.name, shell.link.send_attitude
            )

    @property
    def wrong(self) -> list[str]:
        """Sentences about what must not happen."""
        return list(self._wrong)

    def note(self, sentence: str) -> None:
        """Note a sentence about something that must not happen; a repetition is ignored."""
        self._wrong.setdefault(sentence)

    def begin(self) -> None:
        """Note that the fault is injected now, and whether all vehicles fly.

        Vehicles do not have to notice a fault on the ground.
        """
        self.is_injected = True
        situations = [shell.core.flight.situation for shell in self.flight.agents.values()]
        self.was_flying = all(situation is Situation.FLYING for situation in situations)
        if self.was_flying:
            _, _, height_m = self.truths[self.victim].position_enu_m
            self.highest_m = height_m + self.injection.rises_m

    # -- while it flies ----------------------------------------------------------------------------

    def _check_setpoint(self, name: str, send: object, setpoint: AttitudeSetpoint) -> None:
        """Note a setpoint if it is bad; send it either way."""
        q = np.asarray(setpoint.quaternion_wxyz)
        thrust_frac = setpoint.thrust_frac
        limit_deg = self.flight.config.vehicles[name].max_tilt_deg + _TILT_SLACK_DEG
        if not (np.isfinite(q).all() and math.isfinite(thrust_frac)):
            self.note(f"{name} sends what is not finite")
        elif not 0.0 <= thrust_frac <= 1.0 or abs(np.linalg.norm(q) - 1.0) > 1e-6:
            self.note(f"{name} sends a thrust of {thrust_frac:.2f} or no unit quaternion")
        else:
            # the vertical component of the body's vertical axis
            _, qx, qy, _ = q
            cos_tilt = 1.0 - 2.0 * float(qx**2 + qy**2)
            tilt_deg = math.degrees(math.acos(max(-1.0, cos_tilt)))
            if tilt_deg > limit_deg:
                self.note(f"{name} sends more tilt than allowed")
        send(setpoint)  # type: ignore[operator]

    def _truth_received(self, _topic: Topic, name: str, truth: object) -> None:
        """Check the fleet when the truth of its last vehicle has arrived."""
        assert isinstance(truth, Truth)
        self.truths[name] = truth
        if name != self.flight.config.enabled_names[-1]:
            return

        self._measure_distances()
        for vehicle_truth in self.truths.values():
            self._check_place(vehicle_truth)
        for shell in self.flight.agents.values():
            if shell.is_ticking:
                self._check_action(shell.name)

    def _measure_distances(self) -> None:
        for first, second in itertools.combinations(self.truths.values(), 2):
            if first.is_on_ground and second.is_on_ground:
                continue
            if not first.is_on_ground and not second.is_on_ground:
                self.had_pair = True
            distance_m = separation_m(
                first.position_enu_m, second.position_enu_m, self.height_share
            )
            silenced_count = 0
            if self.is_injected:
                silenced_count = len(self.silenced & {first.vehicle, second.vehicle})
            self.smallest[silenced_count] = min(self.smallest[silenced_count], distance_m)

    def _check_place(self, truth: Truth) -> None:
        """Note a vehicle that leaves the fence, or that rises too much after the fault."""
        fence = self.flight.config.fleet.geofence_m
        x, y, z = truth.position_enu_m
        west, east = fence.x
        south, north = fence.y
        _, top = fence.z
        is_in_fence = (
            west - _FENCE_SLACK_M <= x <= east + _FENCE_SLACK_M
            and south - _FENCE_SLACK_M <= y <= north + _FENCE_SLACK_M
            and z <= top + _FENCE_SLACK_M
        )
        is_excused = self.injection.may_leave_fence and (
            truth.vehicle == self.victim or truth.vehicle in self.silenced
        )
        if not is_in_fence and not is_excused:
            self.note(f"{truth.vehicle} leaves the fence")
        for area in self.areas:
            if not is_excused and beyond_m(area, (x, y, z)) > _FENCE_SLACK_M:
                self.note(f"{truth.vehicle} crosses the edge of the fence '{area.name}'")
        if truth.vehicle == self.victim and z > self.highest_m:
            self.note(f"{truth.vehicle} rises by more than {self.injection.rises_m} m")

    def _check_action(self, name: str) -> None:
        """Note a vehicle that does less than its conditions demand, or more without a reason.

        The strongest demand since the newest order counts, because a vehicle does not take back an
        action before its next order.
        """
        core = self.flight.agents[name].core
        flight = core.flight
        conditions = core.failsafes.conditions
        self.seen[name].update(conditions)

        # a new order clears the demands before it
        order_id = ""
        if flight.order is not None:
            order_id = flight.order.order_id
        if order_id and order_id != self._newest_order_id.get(name):
            self._newest_order_id[name] = order_id
            self._strongest[name] = Action.GO_ON

        situation = flight.situation
        if situation is Situation.GROUND:
            self._strongest[name] = Action.GO_ON
            return

        # A vehicle may obey one tick late, so the weaker demand of the last two ticks counts.
        demanded = self.action_of(situation, conditions)
        demanded_before = self._demanded.get(name, Action.GO_ON)
        self._demanded[name] = demanded

        obeyed_by_now = min(demanded_before, demanded)
        strongest = max(self._strongest.get(name, Action.GO_ON), obeyed_by_now)
        self._strongest[name] = strongest

        behaviour = _behaviour(core)
        if strongest in _SATISFYING and behaviour not in _SATISFYING[strongest]:
            listed = ", ".join(condition.value for condition in conditions)
            self.note(f"{name}: {WORDS[strongest]} is asked for ({listed}), {behaviour} is done")
        if strongest <= Action.SLOW and behaviour in ("failed", "px4") and not flight.reason:
            self.note(f"{name}: {behaviour} is done without a reason")

    # -- after it ----------------------------------------------------------------------------------

    def finish(self) -> None:
        """Judge the end of the flight, and whether the fault was noticed and reported."""
        flight = self.flight
        for collision in flight.simulation.emulator.world.collisions:
            both = {flight.simulation.names[i] for i in (collision.first, collision.second)}
            one_avoids = bool(both - self.silenced)
            if one_avoids:
                self.note(f"{' and '.join(sorted(both))} collide")

        autopilots = flight.simulation.emulator.autopilots
        for name, autopilot in zip(flight.simulation.names, autopilots, strict=True):
            if autopilot.is_armed or not self.truths[name].is_on_ground:
                self.note(f"{name} is not down and disarmed at the end")
        for touchdown in flight.touchdowns:
            vehicle = flight.config.vehicles[touchdown.vehicle]
            is_excused = self.injection.excuses_touchdown(touchdown.vehicle, self.victim)
            if touchdown.is_hard(vehicle) and not is_excused:
                self.note(touchdown.sentence(vehicle))
        for event in flight.events:
            if event.code == "direct_command" and event.vehicle not in self.silenced:
                self.note(event.sentence)

        # such a flight says little of the law that the fleet file names
        law = flight.config.law.name
        for name, counts in self.seen.items():
            if counts[Condition.OWN_LAW_REFUSED]:
                self.note(f"{name}: {law} was refused, and Covey's law flew in its place")

        if self.was_flying:
            others = [name for name in self.seen if name != self.victim]
            self._check_noticed(self.injection.own, [self.victim])
            self._check_noticed(self.injection.others, others)

    def _check_noticed(self, wanted: Collection[Condition], names: Collection[str]) -> None:
        """Note if none of these vehicles has noticed and reported any of these conditions."""
        if not wanted or not names:
            return

        noticed: set[Condition] = set()
        for name in names:
            noticed |= {condition for condition in wanted if self.seen[name][condition]}
        if not noticed:
            words = " or ".join(sorted(condition.value for condition in wanted))
            self.note(f"{' or '.join(names)} did not notice {words}")
            return
        needs_event = bool(noticed - _QUIET)
        if self.injection.is_cut_off or not needs_event:
            return

        reported = {(event.vehicle, event.code) for event in self.flight.events}
        is_reported = any(
            (name, _code(condition)) in reported for name in names for condition in noticed
        )
        if not is_reported:
            words = ", ".join(condition.value for condition in noticed)
            self.note(f"the record does not tell {words}")


def _behaviour(core: object) -> str:
    """Return a word for what an agent does now.

    The words are fly, armed, hold, land (by the agent), px4 (landing by PX4 alone) and failed.
    """
    flight = core.flight  # type: ignore[attr-defined]
    if flight.state == "landing":
        if flight.step is FlightStep.PX4_LANDING:
            return "px4"
        return "land"
    if flight.state == "holding":
        return "hold"
    if flight.state in ("failed", "armed"):
        return str(flight.state)
    return "fly"


def _code(condition: Condition) -> str:
    """Return the code of a condition's events."""
    return condition.name.lower().replace("_", "-")
