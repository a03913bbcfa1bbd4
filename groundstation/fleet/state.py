"""The fleet as the ground sees it: a frozen value, folded from messages of the bus. Pure.

The client folds every batch of messages into a :class:`FleetState`; consoles, missions and the
verdict read it. Telemetry that is older than ``stale_after_s`` in the table of topics counts as
silence and is never shown as present. Ages are counted from the moment of reception, on the
ground's own clock.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence, Set
from types import MappingProxyType
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from groundstation.fleet.separation import closest_pair
from groundstation.fleet.touchdown import (
    SIGHT_RETURNED_NS,
    Touchdown,
    is_flown_blind,
    touchdown_of,
    with_touchdowns,
)
from groundstation.fleet.unknown_time import (
    FASTEST_SHARE,
    KNOWN_S,
    Sighting,
    UnknownTime,
    unknown_time,
    with_time,
)
from onboard.bus.codec import Malformed
from onboard.bus.schema import (
    Event,
    Light,
    Message,
    MocapPoses,
    PreflightReport,
    Telemetry,
    Truth,
)
from onboard.bus.topics import TOPICS, Topic
from onboard.config.fleet import FleetConfig
from onboard.config.pair_separation import separation_m
from onboard.plain_text import plain_line
from onboard.tuples import Xyz

MAX_EVENTS = 500
MAX_UNLISTED = 16  # vehicles outside the fleet file that are kept: those that are up come first
GROUND_STALLED = "ground_stalled"  # code of the event that the ground itself has stood still
# code of the event that PX4 itself reports, on the ground's own link to it, that it is disarmed
DIRECT_DISARMED = "direct_disarmed"
LAW_REFUSED = "own-law-refused"  # code of the event of an agent that flies Covey's law instead
TELEMETRY_STALE_NS = int(TOPICS[Topic.TELEMETRY].stale_after_s * 1e9)
PREFLIGHT_STALE_NS = int(TOPICS[Topic.PREFLIGHT].stale_after_s * 1e9)
PERSON_STALE_NS = int(TOPICS[Topic.ALL_POSES].stale_after_s * 1e9)
TRUTH_STALE_NS = int(TOPICS[Topic.TRUTH].stale_after_s * 1e9)
_NEVER = -(1 << 62)  # time of something that has not happened, long before every other time [ns]
# A message whose number is below the last number, but by less than this, was overtaken and is
# dropped. If it is lower still, the last number was false, and the message counts.
_REORDERED_TICKS = 50
_REORDERED_REPORTS = 2


class NodeSeen(NamedTuple):
    """A liveliness token of the bus that appeared or vanished."""

    node: str
    is_alive: bool


class NotUsed(NamedTuple):
    """Numbers of messages that were refused, and that were pushed out of a full queue."""

    refused: int = 0
    dropped: int = 0


# a message or another item, and its time of reception [ns]
ReceivedMessage = tuple[Message | Malformed | NodeSeen | NotUsed, int]


class Separation(Struct, frozen=True):
    """Separation of two vehicles, as ``onboard.config.pair_separation`` defines it."""

    first: str
    second: str
    distance_m: float
    stamp_ns: int
    is_truth: bool = False  # whether it comes from ground truth, not from telemetry
    is_flying: bool = True  # whether at least one of them flies


class LoggedEvent(Struct, frozen=True):
    """An event of the fleet or of the ground."""

    received_ns: int  # time of reception, on the ground's monotonic clock
    event: Event


class VehicleView(Struct, frozen=True):
    """One vehicle as the ground knows it."""

    name: str
    telemetry: Telemetry | None = None  # the last one, however old: see is_fresh
    received_ns: int = _NEVER  # time of reception of the telemetry
    is_alive: bool = False  # whether the agent's liveliness token is on the bus
    truth: Truth | None = None
    truth_received_ns: int = _NEVER
    # time and position at which it was last seen, by ground truth or by telemetry
    seen_ns: int = _NEVER
    seen_enu_m: Xyz = (0.0, 0.0, 0.0)
    preflight: PreflightReport | None = None
    preflight_received_ns: int = _NEVER
    light: tuple[int, int, int] | None = None  # colour in a show: red, green, blue up to 255
    # last time at which PX4 itself reported, on the ground's own link, that it is disarmed
    direct_disarmed_ns: int = _NEVER
    blind_ns: int = _NEVER  # last time at which it reported a flight without a position
    # whether it was armed or in the air, as far as known, when its agent started anew
    has_restarted_in_flight: bool = False
    # why Covey's law has flown it in place of the user's own in this mission; empty: it has not
    law_refusal: str = ""

    def has_preflight(self, now_ns: int) -> bool:
        """Whether the last preflight report is recent enough to be shown as present.

        A flying vehicle sends no reports.
        """
        if self.preflight is None:
            return False
        return now_ns - self.preflight_received_ns <= PREFLIGHT_STALE_NS

    def age_s(self, now_ns: int) -> float:
        """Return the time since the last telemetry was received [s]; infinite before the first."""
        if self.telemetry is None:
            return math.inf
        return max(0.0, (now_ns - self.received_ns) * 1e-9)

    def is_fresh(self, now_ns: int) -> bool:
        """Whether the telemetry is recent enough to be shown as present."""
        return self.telemetry is not None and now_ns - self.received_ns <= TELEMETRY_STALE_NS

    def has_truth(self, now_ns: int) -> bool:
        """Whether an emulator sends this vehicle's true position."""
        return self.truth is not None and now_ns - self.truth_received_ns <= TRUTH_STALE_NS

    def has_new_truth(self, now_ns: int) -> bool:
        """Whether the true position is known now, so that telemetry is not used for distances."""
        return self.truth is not None and now_ns - self.truth_received_ns <= KNOWN_S * 1e9

    @property
    def sighting(self) -> Sighting | None:
        """The vehicle's last sighting; None if it was never seen."""
        if self.seen_ns == _NEVER:
            return None

        is_flying = self.is_up
        if self.truth is not None and self.truth_received_ns == self.seen_ns:
            is_flying = is_flying or not self.truth.is_on_ground
        return Sighting(self.name, self.seen_enu_m, self.seen_ns, is_flying)

    @property
    def resting_enu_m(self) -> Xyz | None:
        """The position of a disarmed vehicle on the ground [m], ENU; None while it may move."""
        telemetry = self.telemetry
        if telemetry is None or not telemetry.is_position_valid:
            return None
        if self.is_up:
            return None
        return telemetry.position_enu_m

    def position_enu_m(self, now_ns: int) -> Xyz | None:
        """Return the last reported position, extrapolated to now with the reported velocity.

        Args:
            now_ns: the ground's monotonic clock [ns].

        Returns:
            Position [m], ENU; None without fresh telemetry with a valid position.
        """
        telemetry = self.telemetry
        if telemetry is None or not self.is_fresh(now_ns) or not telemetry.is_position_valid:
            return None

        ahead_s = max(0.0, (now_ns - self.received_ns) * 1e-9)
        return _extrapolated(telemetry.position_enu_m, telemetry.velocity_enu_m_s, ahead_s)

    def known_enu_m(self, now_ns: int) -> Xyz | None:
        """Return the position now, by telemetry or else by ground truth; None if neither is new.

        Args:
            now_ns: the ground's monotonic clock [ns].
        """
        position_enu_m = self.resting_enu_m
        if position_enu_m is None:
            position_enu_m = self.position_enu_m(now_ns)
        if position_enu_m is None and self.truth is not None and self.has_new_truth(now_ns):
            position_enu_m = self.truth.position_enu_m
        return position_enu_m

    @property
    def is_disarmed_by_px4(self) -> bool:
        """Whether PX4 has reported a disarm on the direct path after the agent last heard it.

        An agent whose PX4 is silent keeps sending the last report that it heard.
        """
        if self.telemetry is None or self.direct_disarmed_ns == _NEVER:
            return False
        return self.direct_disarmed_ns > self.received_ns - self.telemetry.autopilot_age_s * 1e9

    @property
    def is_armed(self) -> bool:
        """Whether the vehicle is armed, by the last telemetry.

        A later report of a disarm, which PX4 itself sends on the direct path, takes precedence.
        """
        if self.telemetry is None or self.is_disarmed_by_px4:
            return False
        return self.telemetry.is_armed

    @property
    def is_disabled(self) -> bool:
        """Whether an order has taken it out of service, by the last telemetry."""
        return self.telemetry is not None and bool(self.telemetry.disabled_by)

    @property
    def is_airborne(self) -> bool:
        """Whether the vehicle flies, by the last telemetry.

        A later report of a disarm, which PX4 itself sends on the direct path, takes precedence.
        """
        if self.telemetry is None or self.is_disarmed_by_px4:
            return False
        return self.telemetry.is_airborne

    @property
    def is_up(self) -> bool:
        """Whether the vehicle is armed or flies, by the last telemetry."""
        return self.is_armed or self.is_airborne


class PersonView(Struct, frozen=True):
    """A person of the fleet file as the ground knows the person."""

    name: str
    body: str  # in the motion capture
    position_enu_m: Xyz | None = None  # position where the person was seen last; None: never
    seen_ns: int = _NEVER

    def is_fresh(self, now_ns: int) -> bool:
        """Whether the person was seen a moment ago."""
        return now_ns - self.seen_ns < PERSON_STALE_NS


class FleetState(Struct, frozen=True):
    """The whole fleet as the ground knows it."""

    # in the order of the fleet file; vehicles that the file disables are added when they are heard
    vehicles: Mapping[str, VehicleView]
    # vehicles of this fleet's name that the fleet file lacks, the last one heard at the end
    unlisted: tuple[VehicleView, ...] = ()
    people: tuple[PersonView, ...] = ()  # in the order of the fleet file
    events: tuple[LoggedEvent, ...] = ()  # the newest MAX_EVENTS, oldest first
    nodes: frozenset[str] = frozenset()  # liveliness tokens of the bus
    # smallest separation so far while one of the two flew, by telemetry, without ground truth
    smallest: Separation | None = None
    smallest_truth: Separation | None = None  # the same by ground truth; None outside simulation
    unknown_times: tuple[UnknownTime, ...] = ()  # times of unknown distances, oldest first
    # contacts with the ground at the ends of flights, oldest first: of very many, the hardest ones;
    # simulation only
    touchdowns: tuple[Touchdown, ...] = ()
    # numbers of messages that could not be used, as in onboard/message_counts.py
    malformed: int = 0
    refused: int = 0
    dropped: int = 0
    late: int = 0
    disabled: frozenset[str] = frozenset()  # vehicles that the fleet file disables
    height_share: float = 0.0  # weight of a metre of height in a separation
    top_speed_m_s: float = 0.0  # largest speed of any vehicle
    silence_counts_from_ns: int = _NEVER  # this ground was stalled; until then no silence counts
    loop_late_s: float = 0.0  # largest lateness of this ground's event loop in the last seconds

    def telemetry_of(self, name: str) -> Telemetry | None:
        """Return the last telemetry of a vehicle, however old; None: it was never heard.

        Args:
            name: any name.
        """
        view = self.vehicles.get(name)
        return None if view is None else view.telemetry

    def is_after_stall(self, now_ns: int) -> bool:
        """Whether this ground has just been stalled, so that silence does not count."""
        return now_ns < self.silence_counts_from_ns

    def events_after(self, last: LoggedEvent | None) -> list[LoggedEvent]:
        """Return the events after a given one, oldest first.

        Args:
            last: the given event; if it is no longer kept, all events are returned.
        """
        newer = []
        for logged in reversed(self.events):
            if logged is last:
                break
            newer.append(logged)
        newer.reverse()
        return newer

    def closest(self, now_ns: int) -> Separation | None:
        """Return the closest pair now, by fresh telemetry; None without two known positions.

        A pair on the ground is returned only if no pair has a vehicle in the air.
        """
        positions = []
        for name, view in self.vehicles.items():
            position_enu_m = view.position_enu_m(now_ns)
            if position_enu_m is not None:
                positions.append((name, position_enu_m))

        pairs = []
        for (first, position), (second, other) in itertools.combinations(positions, 2):
            distance_m = separation_m(position, other, self.height_share)
            is_flying = self.vehicles[first].is_airborne or self.vehicles[second].is_airborne
            pairs.append(Separation(first, second, distance_m, now_ns, is_flying=is_flying))
        return min(pairs, key=lambda pair: (not pair.is_flying, pair.distance_m), default=None)

    def resting_enu_m(self, now_ns: int, *, without: Collection[str]) -> dict[str, Xyz]:
        """Return where vehicles are, or were last, that are on the ground or silent [m], ENU.

        Args:
            now_ns: the ground's monotonic clock [ns].
            without: vehicles that do not count.
        """
        positions = {}
        for name, view in self.vehicles.items():
            telemetry = view.telemetry
            if name in without or telemetry is None or not telemetry.is_position_valid:
                continue
            if not view.is_airborne or not view.is_fresh(now_ns):
                positions[name] = telemetry.position_enu_m
        return positions

    def is_landed(self, name: str) -> bool:
        """Whether a vehicle is landed and disarmed, by its last telemetry.

        PX4's own heartbeat on the direct path counts too, if it came after all that the agent has
        heard of PX4.
        """
        view = self.vehicles.get(name)
        if view is None or view.telemetry is None:
            return False

        if not view.telemetry.is_airborne and not view.telemetry.is_armed:
            return True
        return view.is_disarmed_by_px4

    @property
    def smallest_known(self) -> Separation | None:
        """The smallest separation so far: by ground truth, and by telemetry while there is none."""
        known = [pair for pair in (self.smallest_truth, self.smallest) if pair is not None]
        return min(known, key=lambda pair: pair.distance_m, default=None)

    @property
    def is_simulated(self) -> bool:
        """Whether the ground truth of every vehicle was received, which only simulations send."""
        return all(view.truth is not None for view in self.vehicles.values())

    @property
    def knows_contacts(self) -> bool:
        """Whether one simulator has all vehicles, and so knows which have touched each other."""
        simulators = {
            0 if view.truth is None else view.truth.contacts_known_by
            for view in self.vehicles.values()
        }
        return len(simulators) == 1 and 0 not in simulators

    @property
    def is_anybody_heard(self) -> bool:
        """Whether any vehicle of the fleet file has sent telemetry."""
        return any(view.telemetry is not None for view in self.vehicles.values())

    @property
    def unlisted_up(self) -> tuple[VehicleView, ...]:
        """Vehicles that the fleet file lacks and that are armed or fly, by their last telemetry."""
        return tuple(view for view in self.unlisted if view.is_up)

    @property
    def airborne_names(self) -> tuple[str, ...]:
        """Vehicles that fly, by their last telemetry."""
        return tuple(name for name, view in self.vehicles.items() if view.is_airborne)


def without_earlier_flights(state: FleetState) -> FleetState:
    """Return the state without what counts for one flight only, for the start of another mission.

    That is the distances so far, and the laws that were refused on vehicles which have landed.
    """
    vehicles = {}
    for name, view in state.vehicles.items():
        if not view.is_airborne:
            view = replace(view, law_refusal="")
        vehicles[name] = view
    return replace(
        state,
        vehicles=MappingProxyType(vehicles),
        smallest=None,
        smallest_truth=None,
        unknown_times=(),
    )


def without_silent(state: FleetState, name: str, now_ns: int) -> FleetState:
    """Return the state without a vehicle that the fleet file lacks, if it is silent.

    Args:
        state: fleet before.
        name: the vehicle's name as it is shown.
        now_ns: the ground's monotonic clock [ns].
    """
    unlisted = tuple(
        view for view in state.unlisted if plain_line(view.name) != name or view.is_fresh(now_ns)
    )
    return replace(state, unlisted=unlisted)


def initial(fleet: FleetConfig) -> FleetState:
    """Return the state before the first message."""
    enabled = fleet.enabled_names
    fastest_m_s = max((fleet.vehicles[name].max_speed_m_s for name in enabled), default=0.0)
    return FleetState(
        vehicles=MappingProxyType({name: VehicleView(name) for name in enabled}),
        people=tuple(PersonView(name, body) for name, body in fleet.people_bodies.items()),
        disabled=frozenset(fleet.vehicles) - {*enabled},
        height_share=fleet.fleet.height_share,
        top_speed_m_s=FASTEST_SHARE * fastest_m_s,
    )


# -- one message -----------------------------------------------------------------------------------


def fold(state: FleetState, message: Message, now_ns: int) -> FleetState:
    """Fold one message into the state.

    Of vehicles that the fleet file lacks, only the telemetry is kept. Repeated or overtaken
    messages change nothing: their number is equal to the last number of the same boot, or a little
    below it. With a new boot id the numbers begin again.

    Args:
        state: fleet before the message.
        message: any message of the bus.
        now_ns: time of reception, on the ground's monotonic clock [ns].

    Returns:
        The state after the message.
    """
    if isinstance(message, Telemetry):
        return fold_telemetry(state, ((message, now_ns),))
    if isinstance(message, Truth):
        return fold_truths(state, (message,), now_ns)
    if isinstance(message, PreflightReport):
        return _fold_preflight(state, message, now_ns)
    if isinstance(message, Light):
        return _fold_light(state, message)
    if isinstance(message, MocapPoses):
        return _fold_poses(state, message, now_ns)
    if isinstance(message, Event):
        return _fold_event(state, message, now_ns)
    return state


def _fold_preflight(state: FleetState, message: PreflightReport, now_ns: int) -> FleetState:
    view = state.vehicles.get(message.vehicle)
    if view is None or _is_repeated(view.preflight, message, _REORDERED_REPORTS):
        return state
    return _with_view(state, replace(view, preflight=message, preflight_received_ns=now_ns))


def _fold_light(state: FleetState, message: Light) -> FleetState:
    view = state.vehicles.get(message.vehicle)
    if view is None:
        return state
    return _with_view(state, replace(view, light=message.colour))


def _fold_poses(state: FleetState, message: MocapPoses, now_ns: int) -> FleetState:
    """Keep where the motion capture sees the persons of the fleet file."""
    seen = {pose.body: pose for pose in message.poses if pose.is_tracked}
    people = []
    for person in state.people:
        if person.body in seen:
            position_enu_m = seen[person.body].position_enu_m
            person = replace(person, position_enu_m=position_enu_m, seen_ns=now_ns)
        people.append(person)
    return replace(state, people=tuple(people))


def _fold_event(state: FleetState, message: Event, now_ns: int) -> FleetState:
    """Keep an event, and note for longer that PX4 has reported a disarm, or a law was refused."""
    earlier_events = state.events[-(MAX_EVENTS - 1) :]
    state = replace(state, events=(*earlier_events, LoggedEvent(now_ns, message)))

    view = state.vehicles.get(message.vehicle)
    if view is None:
        return state
    if message.code == DIRECT_DISARMED:
        view = replace(view, direct_disarmed_ns=now_ns)
    elif message.code == LAW_REFUSED:
        view = replace(view, law_refusal=message.sentence)
    return _with_view(state, view)


# -- many messages ---------------------------------------------------------------------------------


def fold_batch(state: FleetState, batch: Sequence[ReceivedMessage], now_ns: int) -> FleetState:
    """Fold everything that has arrived since the last batch.

    Telemetry of all vehicles is folded at once, after the other messages, and so is ground truth,
    because the number of pairs to compare grows with the square of the number of vehicles.

    Args:
        state: fleet before the batch.
        batch: items with their times of reception, oldest first.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        The state after the batch.
    """
    telemetry: list[tuple[Telemetry, int]] = []
    truths: list[Truth] = []
    nodes: list[NodeSeen] = []

    for item, received_ns in batch:
        if isinstance(item, Telemetry):
            telemetry.append((item, received_ns))
        elif isinstance(item, Truth):
            truths.append(item)
        elif isinstance(item, NodeSeen):
            nodes.append(item)
        elif isinstance(item, Malformed):
            state = replace(state, malformed=state.malformed + 1)
        elif isinstance(item, NotUsed):
            state = replace(
                state,
                refused=state.refused + item.refused,
                dropped=state.dropped + item.dropped,
            )
        else:
            state = fold(state, item, received_ns)

    if nodes:
        state = fold_nodes(state, nodes)
    # Truth comes first, because telemetry is not used for distances where there is truth.
    if truths:
        state = fold_truths(state, truths, now_ns)
    if telemetry:
        state = fold_telemetry(state, telemetry)
    return state


def fold_nodes(state: FleetState, seen: Sequence[NodeSeen]) -> FleetState:
    """Fold all names of the bus that appeared or vanished at once, since there may be thousands."""
    nodes = set(state.nodes)
    vehicles = dict(state.vehicles)

    for node, is_alive in seen:
        if is_alive:
            nodes.add(node)
        else:
            nodes.discard(node)
        if node in vehicles:
            vehicles[node] = replace(vehicles[node], is_alive=is_alive)

    return replace(state, nodes=frozenset(nodes), vehicles=MappingProxyType(vehicles))


def fold_telemetry(state: FleetState, received: Sequence[tuple[Telemetry, int]]) -> FleetState:
    """Fold telemetry of several vehicles; all separations are computed at once.

    A vehicle that occurs twice is compared twice, so that no close encounter is skipped.

    Args:
        state: fleet before the messages.
        received: messages with their times of reception, on the ground's monotonic clock [ns].

    Returns:
        The state after the messages.
    """
    vehicles = dict(state.vehicles)
    updated: set[str] = set()  # vehicles with a new position that is not compared yet
    malformed = state.malformed
    late = state.late

    for message, now_ns in received:
        view = vehicles.get(message.vehicle)
        if view is None and message.vehicle in state.disabled:
            view = VehicleView(message.vehicle)
        if view is None:
            state = _with_unlisted(state, message, now_ns)
            continue
        if _is_repeated(view.telemetry, message, _REORDERED_TICKS):
            late += 1
            continue

        if view.name in updated:
            state = replace(state, vehicles=MappingProxyType(dict(vehicles)))
            state = _with_separation_of(state, updated, now_ns)
            updated.clear()

        if not _is_finite(message.position_enu_m) or not _is_finite(message.velocity_enu_m_s):
            malformed += 1
            message = _without_position(message)

        new_view = replace(view, telemetry=message, received_ns=now_ns)
        if view.telemetry is not None and view.telemetry.boot_id != message.boot_id:
            new_view = replace(new_view, has_restarted_in_flight=_was_up(view))
        if is_flown_blind(message):
            new_view = replace(new_view, blind_ns=now_ns)
        if message.is_position_valid:
            new_view = replace(new_view, seen_ns=now_ns, seen_enu_m=message.position_enu_m)
            state = _seen_again(state, vehicles, view, new_view)
        vehicles[view.name] = new_view
        updated.add(view.name)

    if not updated:
        if late == state.late:
            return state
        return replace(state, late=late)

    state = replace(state, vehicles=MappingProxyType(vehicles), malformed=malformed, late=late)
    _, last_ns = received[-1]
    return _with_separation_of(state, updated, last_ns)


def _with_unlisted(state: FleetState, message: Telemetry, now_ns: int) -> FleetState:
    """Return the state with the telemetry of a vehicle that the fleet file lacks."""
    kept = [view for view in state.unlisted if view.name != message.vehicle]
    kept.append(VehicleView(message.vehicle, telemetry=message, received_ns=now_ns))
    if len(kept) > MAX_UNLISTED:
        # the longest at rest, or else the longest up
        dropped = min(range(len(kept)), key=lambda index: kept[index].is_up)
        del kept[dropped]
    return replace(state, unlisted=tuple(kept))


def _with_separation_of(state: FleetState, updated: Set[str], now_ns: int) -> FleetState:
    """Return the state with the smallest separation between ``updated`` and all vehicles."""
    views = state.vehicles.values()
    if not any(view.is_airborne for view in views):
        return state
    if all(view.has_new_truth(now_ns) for view in views):
        return state

    known = []
    positions = []
    for view in views:
        position_enu_m = view.known_enu_m(now_ns)
        if position_enu_m is not None:
            known.append(view)
            positions.append(position_enu_m)

    smallest_m = math.inf
    if state.smallest is not None:
        smallest_m = state.smallest.distance_m
    pair = closest_pair(
        np.array(positions),
        np.array([view.is_airborne for view in known]),
        np.array([view.name in updated for view in known]),
        below_m=smallest_m,
        height_share=state.height_share,
    )
    if pair is None:
        return state

    first, second, distance_m = pair
    names = (known[first].name, known[second].name)
    return replace(state, smallest=_sorted_separation(*names, distance_m, now_ns, is_truth=False))


def fold_truths(state: FleetState, messages: Sequence[Truth], now_ns: int) -> FleetState:
    """Fold ground truth of several vehicles, received together.

    A vehicle that occurs twice, as after a stall of this ground, is compared twice.

    Args:
        state: fleet before the messages.
        messages: messages of one emulator, hence of one clock.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        The state after the messages.
    """
    vehicles = dict(state.vehicles)
    updated: set[str] = set()  # vehicles with a new position that is not compared yet
    touchdowns: list[Touchdown] = []
    for message in messages:
        view = vehicles.get(message.vehicle)
        if view is None:
            continue

        if view.name in updated:
            state = replace(state, vehicles=MappingProxyType(dict(vehicles)))
            state = _with_true_separation_of(state, updated, now_ns)
            updated.clear()

        if not _is_finite(message.position_enu_m) or not _is_finite(message.velocity_enu_m_s):
            continue
        is_newer = view.truth is None or message.stamp_ns > view.truth.stamp_ns
        if not is_newer and view.has_truth(now_ns):
            continue

        touchdown = touchdown_of(
            message,
            view.truth,
            view.telemetry,
            telemetry_age_s=view.age_s(now_ns),
            is_fresh=view.is_fresh(now_ns),
            was_blind=now_ns - view.blind_ns < SIGHT_RETURNED_NS,
        )
        if touchdown is not None:
            touchdowns.append(touchdown)

        new_view = replace(
            view,
            truth=message,
            truth_received_ns=now_ns,
            seen_ns=now_ns,
            seen_enu_m=message.position_enu_m,
        )
        if not _follows_without_gap(view.truth, message):
            state = _seen_again(state, vehicles, view, new_view)
        vehicles[view.name] = new_view
        updated.add(view.name)

    if touchdowns:
        state = replace(state, touchdowns=with_touchdowns(state.touchdowns, touchdowns))
    if not updated:
        return state
    state = replace(state, vehicles=MappingProxyType(vehicles))
    return _with_true_separation_of(state, updated, now_ns)


def _with_true_separation_of(state: FleetState, updated: Set[str], now_ns: int) -> FleetState:
    """Return the state with the smallest true separation between ``updated`` and all vehicles.

    Samples that are older than the newest one are extrapolated to its time.
    """
    known = []
    for view in state.vehicles.values():
        if view.truth is not None and view.has_truth(now_ns):
            known.append(view.truth)

    newest_ns = max([truth.stamp_ns for truth in known])
    position_enu_m = np.array([truth.position_enu_m for truth in known])
    if any(truth.stamp_ns != newest_ns for truth in known):
        ahead_s = np.array([(newest_ns - truth.stamp_ns) * 1e-9 for truth in known])
        velocity_enu_m_s = np.array([truth.velocity_enu_m_s for truth in known])
        position_enu_m = position_enu_m + ahead_s[:, None] * velocity_enu_m_s

    smallest_m = math.inf
    if state.smallest_truth is not None:
        smallest_m = state.smallest_truth.distance_m
    pair = closest_pair(
        position_enu_m,
        np.array([not truth.is_on_ground for truth in known]),
        np.array([truth.vehicle in updated for truth in known]),
        below_m=smallest_m,
        height_share=state.height_share,
    )
    if pair is None:
        return state

    first, second, distance_m = pair
    names = (known[first].vehicle, known[second].vehicle)
    return replace(
        state, smallest_truth=_sorted_separation(*names, distance_m, newest_ns, is_truth=True)
    )


# -- times of unknown distances --------------------------------------------------------------------


def unknown_until(state: FleetState, now_ns: int) -> tuple[UnknownTime, ...]:
    """Return the times in which distances were not known, including those that have not ended.

    Args:
        state: state of the fleet.
        now_ns: end of the flight, on the ground's monotonic clock [ns].
    """
    still_unknown = []
    for view in state.vehicles.values():
        time = _unknown_time(state, state.vehicles, view, None, now_ns)
        if time is not None:
            still_unknown.append(time)
    return (*state.unknown_times, *still_unknown)


def _was_up(view: VehicleView) -> bool:
    """Whether a vehicle was armed or in the air when its agent was last heard.

    An agent that has never heard PX4 does not know this. Then the agent before it counts.
    """
    if view.is_up:
        return True
    has_heard_px4 = view.telemetry is not None and math.isfinite(view.telemetry.autopilot_age_s)
    return view.has_restarted_in_flight and not has_heard_px4


def _seen_again(
    state: FleetState, vehicles: Mapping[str, VehicleView], before: VehicleView, after: VehicleView
) -> FleetState:
    """Return the state with the time in which a vehicle was not seen, if that was long enough."""
    if after.seen_ns - before.seen_ns <= KNOWN_S * 1e9:
        return state

    time = _unknown_time(state, vehicles, before, after.sighting, after.seen_ns)
    if time is None:
        return state
    return replace(state, unknown_times=with_time(state.unknown_times, time))


def _unknown_time(
    state: FleetState,
    vehicles: Mapping[str, VehicleView],
    before: VehicleView,
    after: Sighting | None,
    now_ns: int,
) -> UnknownTime | None:
    """Return the time in which a vehicle was not seen, up to now; None if it does not count."""
    sighting = before.sighting
    if sighting is None:
        return None

    others = []
    for view in vehicles.values():
        other = view.sighting
        if other is not None and view.name != before.name:
            others.append(other)
    return unknown_time(
        sighting,
        after,
        others,
        now_ns,
        top_speed_m_s=state.top_speed_m_s,
        height_share=state.height_share,
    )


def _follows_without_gap(last: Truth | None, message: Truth) -> bool:
    """Whether nothing is missing between two samples of ground truth, by the emulator's clock."""
    if last is None:
        return False
    return 0 < message.stamp_ns - last.stamp_ns <= KNOWN_S * 1e9


# -- parts -----------------------------------------------------------------------------------------


def _sorted_separation(
    name: str, other_name: str, distance_m: float, stamp_ns: int, *, is_truth: bool
) -> Separation:
    """Return the separation of two vehicles, whose names come in alphabetical order."""
    return Separation(
        first=min(name, other_name),
        second=max(name, other_name),
        distance_m=distance_m,
        stamp_ns=stamp_ns,
        is_truth=is_truth,
    )


def _is_repeated(
    last: Telemetry | PreflightReport | None,
    message: Telemetry | PreflightReport,
    most_reordered: int,
) -> bool:
    """Whether a message is a repetition of the last one, or was overtaken by it.

    If its number is much lower, the number of the last one was false.
    """
    if last is None or last.boot_id != message.boot_id:
        return False
    return 0 <= last.sequence - message.sequence < most_reordered


def _with_view(state: FleetState, view: VehicleView) -> FleetState:
    """Return the state with another view of one vehicle."""
    return replace(state, vehicles=MappingProxyType({**state.vehicles, view.name: view}))


def _extrapolated(position: Xyz, velocity: Xyz, ahead_s: float) -> Xyz:
    x, y, z = position
    v_x, v_y, v_z = velocity
    return (x + v_x * ahead_s, y + v_y * ahead_s, z + v_z * ahead_s)


def _is_finite(vector: Xyz) -> bool:
    return all(math.isfinite(value) for value in vector)


def _without_position(message: Telemetry) -> Telemetry:
    zero = (0.0, 0.0, 0.0)
    return msgspec.structs.replace(
        message, position_enu_m=zero, velocity_enu_m_s=zero, is_position_valid=False
    )
