"""Explores all states of a flight: every order, every action of a failsafe and every report of PX4,
from every state that can be reached, until nothing new is found.

    python -m tests.onboard.flight.explorer

The state machine, its predicates, the refusals of orders and the failsafe table are those that fly.
Around them stands a world of five facts: whether PX4 is armed, its mode, whether the vehicle is in
the air, whether its poses are lost, and whether PX4 hears a pilot's sticks. An event is an order, a
condition, the change of one fact, or time that passes. After each event the flight's answer is
looked at (:func:`_look_at`), and the state that follows is explored in turn. So every sequence of
events is covered, of two, three and any other number. Conditions that hold at once lead to the
action of one of them (:func:`combined_actions`).

An :class:`Answer` is all that an event changes: the next state, what is sent to PX4 and told to
people, the goal and the reason. A row that is taken out is noticed when one of the states that used
it answers otherwise without it (:func:`difference_without_row`,
:func:`difference_without_condition`).

Of the continuous quantities each state keeps one representative: the times and heights of the
sequence that found it first.
"""

from __future__ import annotations

import copy
import math
import zlib
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement
from typing import Literal, NamedTuple

from msgspec import structs

from onboard.agent_commands import Arm, Command, Disarm, Kill, Publish, Px4Land, SetOffboard
from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import Event, Order, OrderKind, PathOrder
from onboard.control.path import path_of
from onboard.flight import order_checks, state_machine
from onboard.flight.context import FlightContext
from onboard.flight.flight_table import ROWS, Row
from onboard.flight.order_checks import OrderFacts
from onboard.flight.path_flight import CATCH_UP_LIMIT_S, PathFlight
from onboard.flight.predicates import PATH_END_TIMEOUT_S
from onboard.flight.types import FlightEvent, FlightStep, FlightView
from onboard.safety.failsafe_table import TABLE, Action, Condition, Situation, decide
from onboard.safety.failsafe_table import Condition as C
from tests.onboard.agent.rig import fleet
from tests.onboard.flight.open_space import OPEN_SPACE

ORDERS: tuple[tuple[OrderKind, str], ...] = (
    ("arm", ""),
    ("takeoff", ""),
    ("takeoff", "high"),  # to more than the first leg of a climb
    ("move", ""),
    ("move", "then land"),
    ("follow_path", ""),
    ("hold", ""),
    ("land", ""),
    ("land", "mission"),
    ("disarm", ""),
    ("kill", ""),
    ("reboot", ""),
)
MODES = ("OFFBOARD", "HOLD", "LAND", "POSCTL")

FLYING_STEPS = frozenset(
    step for step in FlightStep if step.situation in (Situation.LIFTOFF, Situation.FLYING)
)
LANDING_STEPS = frozenset(
    step for step in FlightStep if step.situation in (Situation.LANDING, Situation.PX4_LANDING)
)
RESTING_STEPS = frozenset({FlightStep.WAITING, FlightStep.READY, FlightStep.LANDED})

# Whoever has the vehicle then lands it: a pilot, or PX4 without setpoints.
GIVES_A_LANDING_UP = frozenset(
    {
        C.FLOWN_BY_HAND,
        C.LEFT_OFFBOARD,
        C.PX4_FAILSAFE,
        C.REBOOTED,
        C.AUTOPILOT_SILENT,
        C.AUTOPILOT_IMPOSSIBLE,
        C.AUTOPILOT_FROZEN,
    }
)

_GIVING_UP = {condition.value for condition in GIVES_A_LANDING_UP}

_HEIGHT_M = 1.0
_HIGH_M = 2.0
_TICK_NS = 100_000_000
_SHORT_TICKS = 8
_LONG_TICK_NS = 2_000_000_000
_LONG_TICKS = 40  # longer than every time limit of the flight table
_SINKS_M_S = -0.7
_FALLS_M_S = -3.0
_DOWN_AFTER_TICKS = 10  # in a landing of the obedient world
_PATH = path_of([[1.0, *[0.0] * 32]])
_PLACES = {id(row): place for place, row in enumerate(ROWS)}
_MAX_EXAMPLES = 50  # states that are kept of each row and step


class World(NamedTuple):
    """What is outside of the flight: PX4, the vehicle's place, a pilot."""

    is_armed: bool = False
    mode: str = "HOLD"
    is_in_air: bool = False
    is_blind: bool = False
    has_sticks: bool = False


class Key(NamedTuple):
    """What distinguishes two states."""

    step: FlightStep
    order: str  # kind and reason of the order in progress; empty without one
    is_slow: bool
    was_killed: bool
    world: World


class Answer(NamedTuple):
    """What a flight makes of one event."""

    key: Key  # of the state that follows
    sent: tuple[str, ...]  # to PX4, and told to people
    reason: str
    goal: str  # two numbers that are none have different hashes
    slow_until_ns: int  # of a path


class State(NamedTuple):
    """A flight in its world, at an instant."""

    flight: FlightContext
    world: World
    now_ns: int

    @property
    def key(self) -> Key:
        """What distinguishes it from others."""
        order = self.flight.order
        return Key(
            step=self.flight.step,
            order="" if order is None else f"{order.kind} {order.reason}",
            is_slow=self.flight.is_slow,
            was_killed=self.flight.was_killed,
            world=self.world,
        )

    @property
    def answer(self) -> Answer:
        """What was made of the event that led here."""
        flight = self.flight
        return Answer(
            key=self.key,
            sent=tuple(_words(command) for command in flight.commands),
            reason=flight.reason,
            goal=repr(flight.goal),
            slow_until_ns=flight.path.slow_until_ns,
        )


def _words(command: Command) -> str:
    """Return what a command does, without its stamps."""
    name = type(command).__name__
    if isinstance(command, Publish) and isinstance(command.message, Event):
        event = command.message
        return f"{name} {event.severity} {event.code} {event.order_outcome} {event.sentence}"
    return name


@dataclass(slots=True)
class Found:
    """What an exploration has found."""

    states: int = 0
    transitions: int = 0
    steps: set[FlightStep] = field(default_factory=set)
    moves: Counter[tuple[FlightStep, str, FlightStep, str]] = field(default_factory=Counter)
    answers: dict[tuple[Key, str], int] = field(default_factory=dict)  # hash of each
    # the first states in which an event used a row, by its place in the flight table
    users: defaultdict[int, list[State]] = field(default_factory=lambda: defaultdict(list))
    # the first states of each step
    examples: defaultdict[FlightStep, list[State]] = field(
        default_factory=lambda: defaultdict(list)
    )
    wrong: dict[str, str] = field(default_factory=dict)  # what is wrong -> the first example

    def in_words(self) -> str:
        """Return its size in a sentence, and a checksum of every move from step to step."""
        moves = sorted(
            f"{old.name} {event} {new.name} {sent} {count}"
            for (old, event, new, sent), count in self.moves.items()
        )
        checksum = zlib.crc32("\n".join(moves).encode())
        return (
            f"{self.states} states, {self.transitions} events from them, "
            f"{len(moves)} of them different by step, event and answer (checksum {checksum:08x})."
        )

    def add_wrong(self, what: str, key: Key, event: str) -> None:
        """Keep the first example of something that must not be."""
        self.wrong.setdefault(what, f"{key.step.name} with {key}, after {event}")


# -- the exploration -------------------------------------------------------------------------------


def explore() -> Found:
    """Explore everything that can be reached from a vehicle that stands on the ground."""
    found = Found()
    first = _first_state()
    known = {first.key}
    waiting = deque([first])

    while waiting:
        state = waiting.popleft()
        key = state.key
        found.states += 1
        found.steps.add(key.step)
        if len(found.examples[key.step]) < _MAX_EXAMPLES:
            found.examples[key.step].append(state)
        _look_at(state, found)

        with _rows_used() as used:
            for event, after in _events(state):
                answer = after.answer
                found.transitions += 1
                found.moves[key.step, event, answer.key.step, ", ".join(answer.sent)] += 1
                found.answers[key, event] = hash(answer)
                _look_at_move(state, event, after, found)
                if answer.key not in known:
                    known.add(answer.key)
                    waiting.append(after)

        for row in used:
            users = found.users[row]
            if len(users) < _MAX_EXAMPLES:
                users.append(state)
    return found


@contextmanager
def _rows_used() -> Iterator[set[int]]:
    """Collect the places of the flight table's rows that are used meanwhile."""
    used: set[int] = set()
    match = state_machine._match

    def noted(flight: FlightContext, view: FlightView, event: FlightEvent) -> Row | None:
        row = match(flight, view, event)
        if row is not None:
            used.add(_PLACES[id(row)])
        return row

    state_machine._match = noted
    try:
        yield used
    finally:
        state_machine._match = match


def difference_without_row(row: Row, found: Found) -> str | None:
    """Return the first event that the flight table of now answers otherwise; None without one.

    Args:
        row: that is taken out of the table now.
        found: with all rows.
    """
    for state in found.users[ROWS.index(row)]:
        for event, after in _events(state):
            if hash(after.answer) != found.answers[state.key, event]:
                return f"{event} in {state.key.step.name}"
    return None


def difference_without_condition(condition: Condition, found: Found) -> str | None:
    """Return the first step in which a condition leads to another answer now; None without one.

    Args:
        condition: whose row of the failsafe table is changed now.
        found: with the table as it flies.
    """
    for states in found.examples.values():
        for state in states:
            after = _acted(state, TABLE[state.flight.situation, condition])
            if hash(after.answer) != found.answers[state.key, condition.value]:
                return f"{condition.value} in {state.key.step.name}"
    return None


def _first_state() -> State:
    config = fleet()
    flight = FlightContext(config, config.vehicles["mav0"], path=PathFlight(path=_PATH))
    return State(flight, World(), 10**12)


def _events(state: State) -> Iterator[tuple[str, State]]:
    """Yield everything that can happen now, and the state after it."""
    for kind, reason in ORDERS:
        after, _ = ordered(state, kind, reason)
        yield f"order {kind} {reason}".strip(), after

    after_action: dict[Action, State] = {}
    for condition in Condition:
        action = TABLE[state.flight.situation, condition]
        if action not in after_action:
            after_action[action] = _acted(state, action)
        yield condition.value, after_action[action]

    for is_ready in (True, False):
        after = _copy(state)
        state_machine.preflight_checked(after.flight, _view(after), is_ready)
        yield f"preflight {is_ready}", after

    for world in _changed(state.world):
        yield f"world {world}", _passed(state._replace(world=world), _SHORT_TICKS, _TICK_NS)

    yield "short time", _passed(state, _SHORT_TICKS, _TICK_NS)
    yield "long time", _passed(state, _LONG_TICKS, _LONG_TICK_NS)
    yield from _motions(state)


def _motions(state: State) -> Iterator[tuple[str, State]]:
    """Yield how the vehicle may move, or lag, while a step waits for something else."""
    match state.flight.step:
        case FlightStep.LEG:
            yield "rests at its goal", _passed(state, _SHORT_TICKS, _TICK_NS, _seen_at_goal)
        case FlightStep.PATH:
            after = _copy(state)
            after.flight.path.is_skipped = True
            yield "skips the rest of its path", _passed(after, 1, _TICK_NS)
            after = _copy(state)
            after.flight.path.time_s = _PATH.duration_s - 0.03  # its end comes at the second tick
            yield "rests at the end", _passed(after, _SHORT_TICKS, _TICK_NS, _seen_at_goal)
            yield "left behind, lands", _passed(_left_behind(state, "land"), 1, _TICK_NS)
            yield "left behind, holds", _passed(_left_behind(state, "hold"), 1, _TICK_NS)
            after = _copy(state)
            after.flight.path.time_s = _PATH.duration_s + 2.0 * PATH_END_TIMEOUT_S
            yield "path over long since", _passed(after, 1, _TICK_NS)
        case FlightStep.HOLDING:
            yield "does not rest", _passed(state, _LONG_TICKS, _LONG_TICK_NS, _seen_moving)
        case FlightStep.CONTACT:
            yield "falls", _passed(state, 1, _TICK_NS, _seen_falling)
        case FlightStep.DESCENT:
            yield "kept off", _passed(state, _LONG_TICKS, _TICK_NS, _seen_beside_goal)
        case FlightStep.REBOOTING:
            yield "PX4 has a new clock", _passed(state, 1, _TICK_NS, _seen_rebooted)
        case FlightStep.DISARMED:
            yield "PX4 silent", _passed(state, _LONG_TICKS, _TICK_NS * 2, _seen_silent)


def _left_behind(state: State, on_lag: Literal["land", "hold"]) -> State:
    after = _copy(state)
    after.flight.path.is_lagging = True
    after.flight.path.used_s = CATCH_UP_LIMIT_S
    after.flight.path.on_lag = on_lag
    return after


def _seen_at_goal(state: State) -> FlightView:
    return structs.replace(_view(state), position_enu_m=state.flight.goal_position_enu_m)


def _seen_moving(state: State) -> FlightView:
    return structs.replace(_view(state), velocity_enu_m_s=(1.0, 0.0, 0.0))


def _seen_falling(state: State) -> FlightView:
    below_m = state.flight.search_began_z_m - 0.3
    return structs.replace(
        _view(state), position_enu_m=(0.0, 0.0, below_m), velocity_enu_m_s=(0.0, 0.0, -1.0)
    )


def _seen_beside_goal(state: State) -> FlightView:
    x, y, _ = state.flight.goal_position_enu_m
    return structs.replace(
        _view(state), position_enu_m=(x + 1.0, y, _HEIGHT_M), velocity_enu_m_s=(0.0, 0.0, 0.0)
    )


def _seen_silent(state: State) -> FlightView:
    view = _view(state)
    silent = structs.replace(view.snapshot, heartbeat_ns=state.flight.step_ns)
    return structs.replace(view, snapshot=silent)


def _seen_rebooted(state: State) -> FlightView:
    view = _view(state)
    anew = structs.replace(view.snapshot, px4_boot_ms=20, attitude_ns=view.now_ns)
    return structs.replace(view, snapshot=anew)


def _changed(world: World) -> Iterator[World]:
    """Yield the worlds that differ in one fact."""
    yield world._replace(is_armed=not world.is_armed)
    yield world._replace(is_in_air=not world.is_in_air)
    yield world._replace(is_blind=not world.is_blind)
    yield world._replace(has_sticks=not world.has_sticks)
    for mode in MODES:
        if mode != world.mode:
            yield world._replace(mode=mode)


# -- what must hold --------------------------------------------------------------------------------


def _look_at(state: State, found: Found) -> None:
    """Look for what must hold in every state."""
    key = state.key

    killed, commands = ordered(state, "kill", "")
    if not any(isinstance(command, Kill) for command in commands):
        found.add_wrong("a kill is not sent to PX4", key, "order kill")
    if killed.flight.step is not FlightStep.KILLING:
        found.add_wrong("a kill does not last", key, "order kill")

    if state.world.is_in_air and _is_landing_told_after_a_fall(killed):
        found.add_wrong("a killed vehicle is said to have landed", key, "order kill, order land")

    if not is_brought_down(state):
        found.add_wrong("a person's order to land brings nothing down", key, "order land")
    if is_at_rest_after_its_flight(state):
        for kind in ("land", "move"):
            _, said = ordered(state, kind, "", then_land=True)
            if not any(is_done(command) for command in said):
                found.add_wrong(f"{kind} of a vehicle at rest is not done", key, f"order {kind}")
    if state.flight.step in LANDING_STEPS and not _comes_to_rest(_copy(state)):
        found.add_wrong("a landing does not end on the ground", key, "nothing else")


def _look_at_move(before: State, event: str, after: State, found: Found) -> None:
    """Look for what must hold between a state and the next."""
    old = before.flight.step
    new = after.flight.step
    if old in LANDING_STEPS and new in FLYING_STEPS:
        found.add_wrong("a landing is undone", before.key, event)

    is_given_up = old in LANDING_STEPS and new.situation is Situation.SILENT
    falls = after.flight.was_killed or not after.world.is_armed
    is_given_up = is_given_up and not falls
    if is_given_up and event not in _GIVING_UP and not event.startswith("order "):
        found.add_wrong("a landing is given up", before.key, event)


def _is_landing_told_after_a_fall(killed: State) -> bool:
    """Return whether an order to land is done though a kill has stopped the motors in the air."""
    falling, _ = ordered(killed, "land", "")
    disarmed = falling.world._replace(is_armed=False, is_in_air=False)  # so says PX4 without motors
    fallen = _passed(falling._replace(world=disarmed), _SHORT_TICKS, _TICK_NS)
    return any(is_done(command) for command in fallen.flight.commands)


def is_brought_down(state: State) -> bool:
    """Return whether a person's order to land, or to disarm what is on the ground, ends with the
    vehicle at rest.

    Args:
        state: from which it is ordered; PX4 obeys from then on.
    """
    calm = _passed(state, _SHORT_TICKS, _TICK_NS)
    if calm.flight.step in RESTING_STEPS and not calm.world.is_in_air:
        return True

    landed, requests = ordered(calm, "land", "")
    if _comes_to_rest(landed._replace(world=_obeyed(landed.world, requests))):
        return True
    disarmed, requests = ordered(calm, "disarm", "")
    obeyed = _obeyed(disarmed.world, requests)
    return not calm.world.is_in_air and _comes_to_rest(disarmed._replace(world=obeyed))


def _comes_to_rest(state: State) -> bool:
    """Return whether a vehicle comes to rest on the ground, disarmed, with a PX4 that obeys.

    It goes on from there: a later flight can begin.
    """
    flight = state.flight
    world = state.world
    if world.mode == "POSCTL":
        world = world._replace(mode="HOLD", has_sticks=False)  # the pilot gives it back

    sinking = 0
    now_ns = state.now_ns
    for tick in range(_SHORT_TICKS * 8):
        if flight.step in RESTING_STEPS and not world.is_in_air and not world.is_armed:
            return True

        now_ns += _TICK_NS if tick < _SHORT_TICKS * 4 else _LONG_TICK_NS
        state_machine.advance(flight, _view(State(flight, world, now_ns)))
        world = _obeyed(world, flight.take_commands())

        is_sinking = flight.step in LANDING_STEPS or not flight.step.is_streaming
        sinking = sinking + 1 if is_sinking else 0
        if sinking > _DOWN_AFTER_TICKS:
            world = world._replace(is_in_air=False)
        if not world.is_in_air and world.mode == "LAND":
            world = world._replace(is_armed=False)  # PX4 disarms itself after its landing
    return False


def _obeyed(world: World, commands: list[Command]) -> World:
    """Return the world after PX4 has done what it was asked for."""
    for command in commands:
        match command:
            case SetOffboard():
                world = world._replace(mode="OFFBOARD")
            case Arm():
                world = world._replace(is_armed=True)
            case Disarm() if not world.is_in_air:
                world = world._replace(is_armed=False)
            case Px4Land():
                world = world._replace(mode="LAND")
            case Kill():
                world = world._replace(is_armed=False)
    return world


def combined_actions() -> Iterator[tuple[Situation, tuple[Condition, ...], Action]]:
    """Yield the action that up to three conditions lead to at once, in every situation."""
    for situation in Situation:
        for some in combinations_with_replacement(Condition, 3):
            action, _ = decide(situation, set(some))
            yield situation, some, action


# -- one event -------------------------------------------------------------------------------------


def is_at_rest_after_its_flight(state: State) -> bool:
    """Return whether a vehicle stands disarmed where it has landed, and has not fallen there."""
    flight = state.flight
    is_down = flight.step is FlightStep.LANDED and not state.world.is_armed
    has_landed = not flight.has_fallen and not flight.was_killed
    is_left_alone = not _view(state).is_flown_by_hand
    return is_down and has_landed and is_left_alone


def is_done(command: Command) -> bool:
    """Return whether this tells that an order is done."""
    return isinstance(command, Publish) and getattr(command.message, "order_outcome", "") == "done"


def ordered(
    state: State, kind: OrderKind, reason: str, *, then_land: bool = False
) -> tuple[State, list[Command]]:
    """Return the state after an order, and what was sent to PX4; a refused one changes nothing."""
    after = _copy(state)
    view = _view(after)
    ends_on_ground = then_land or reason == "then land"
    order = Order(
        order_id=f"{kind} {reason}",
        author="x",
        kind=kind,
        stamp_ns=after.now_ns,
        deadline_ns=0,
        reason=reason,
        position_enu_m=(0.0, 0.0, 1.0) if ends_on_ground else (1.0, 0.0, 1.0),
        then_land=ends_on_ground,
        height_m=_HIGH_M if reason == "high" else None,
        path=PathOrder(path_id="p", show_id="s", start_ns=after.now_ns),
    )
    facts = OrderFacts(
        view=view,
        fleet=after.flight.fleet,
        surroundings=OPEN_SPACE,
        others={},
        last_positions_enu_m={},
        distances_m={},
        not_ready=(),
        not_ready_in_air=lambda: (),
    )
    is_path = kind == "follow_path"  # its other refusals are about the path
    is_refused = order_checks.refusal(order, after.flight, facts) is not None
    if is_path:
        is_refused = not state_machine.accepts(after.flight.step, kind)
    if not is_refused:
        state_machine.begin_order(after.flight, view, order)
    return after, list(after.flight.commands)


def _acted(state: State, action: Action) -> State:
    """Return the state after an action of the failsafe table.

    On the ground a refusal is one of the preflight check: the vehicle is not ready any more.
    """
    after = _copy(state)
    view = _view(after)
    if action is Action.REFUSE:
        state_machine.preflight_checked(after.flight, view, is_ready=False)
    else:
        state_machine.begin_failsafe(after.flight, view, action, "a condition.")
    return after


def _passed(
    state: State,
    ticks: int,
    tick_ns: int,
    see: Callable[[State], FlightView] | None = None,
) -> State:
    """Return the state after some time in an unchanged world, or at the next step."""
    look = see or _view
    after = _copy(state)
    for _ in range(ticks):
        after = after._replace(now_ns=after.now_ns + tick_ns)
        step = after.flight.step
        state_machine.advance(after.flight, look(after))
        if after.flight.step is not step:
            break  # what follows is another event
    return after


def _copy(state: State) -> State:
    flight = replace(state.flight, path=copy.copy(state.flight.path), commands=[])
    return state._replace(flight=flight)


def _view(state: State) -> FlightView:
    """Return what the flight sees of its world."""
    world = state.world
    now_ns = state.now_ns
    climbs_m_s = 0.0
    if world.is_in_air and state.flight.step in LANDING_STEPS:
        climbs_m_s = _SINKS_M_S if world.is_armed else _FALLS_M_S
    height_m = _HEIGHT_M if world.is_in_air else 0.0
    sticks_ns = now_ns if world.has_sticks else 0
    snapshot = Snapshot(
        heartbeat_ns=now_ns,
        is_armed=world.is_armed,
        mode=world.mode,
        landed=Landed.IN_AIR if world.is_in_air else Landed.ON_GROUND,
        landed_ns=now_ns,
        velocity_local_ned_m_s=(0.0, 0.0, -climbs_m_s),
        sticks_ns=sticks_ns,
        sticks_before_ns=sticks_ns - 1 if sticks_ns else 0,
        battery_frac=1.0,
    )
    return FlightView(
        now_ns=now_ns,
        position_enu_m=(0.0, 0.0, height_m),
        velocity_enu_m_s=(0.0, 0.0, climbs_m_s),
        has_position=True,
        snapshot=snapshot,
        thrust_share=1.0 if world.is_in_air else 0.5,
        lift_share=1.0 if world.is_in_air else 0.5,
        is_dead_reckoned=world.is_blind,
        yaw_rad=0.0,
        position_age_s=math.inf if world.is_blind else 0.0,
    )


if __name__ == "__main__":
    result = explore()
    print(result.in_words())
    for what, example in result.wrong.items():
        print(f"{what}: {example}")
