"""The fleet as the ground sees it: a frozen value, folded from the bus one message at a time. Pure.

What is fresh follows from the topics table: telemetry older than its ``stale_after_s`` is shown as silence, never as a
number of now. Ages are counted from the moment of reception on the ground's own clock.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence, Set
from types import MappingProxyType

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from onboard.bus.schema import Event, Message, PreflightReport, Telemetry, Truth, Vec3
from onboard.bus.topics import TOPICS, Topic
from onboard.config.fleet import FleetConfig

MAX_EVENTS = 500
DIRECT_DISARMED = "direct_disarmed"  # code of the ground's event: PX4 itself says so, past a silent agent
TELEMETRY_STALE_NS = int(TOPICS[Topic.TELEMETRY].stale_after_s * 1e9)
PREFLIGHT_STALE_NS = int(TOPICS[Topic.PREFLIGHT].stale_after_s * 1e9)
TRUTH_STALE_NS = int(TOPICS[Topic.TRUTH].stale_after_s * 1e9)
_NEVER = -(1 << 62)


class Separation(Struct, frozen=True):
    """Horizontal distance between the centres of two vehicles; ``is_truth`` when ground truth says so."""

    first: str
    second: str
    distance_m: float
    stamp_ns: int
    is_truth: bool = False


class LoggedEvent(Struct, frozen=True):
    """An event and when the ground heard it (its own monotonic clock)."""

    received_ns: int
    event: Event


class VehicleView(Struct, frozen=True):
    """What is known of one vehicle. ``telemetry`` is the last one heard, however old: ask :meth:`is_fresh`."""

    name: str
    telemetry: Telemetry | None = None
    received_ns: int = _NEVER
    is_alive: bool = False
    truth: Truth | None = None
    truth_received_ns: int = _NEVER
    last_event: Event | None = None
    preflight: PreflightReport | None = None
    preflight_received_ns: int = _NEVER
    direct_disarmed_ns: int = _NEVER  # when PX4 itself told the ground, past a silent agent, that it is disarmed

    def has_preflight(self, now_ns: int) -> bool:
        """Whether the last go/no-go report may be shown as the present; a flying vehicle sends none."""
        return self.preflight is not None and now_ns - self.preflight_received_ns <= PREFLIGHT_STALE_NS

    def age_s(self, now_ns: int) -> float:
        """Seconds since telemetry came in; infinite when none ever did."""
        return math.inf if self.telemetry is None else max(0.0, (now_ns - self.received_ns) * 1e-9)

    def is_fresh(self, now_ns: int) -> bool:
        """Whether the telemetry may be shown as the present."""
        return self.telemetry is not None and now_ns - self.received_ns <= TELEMETRY_STALE_NS

    def has_truth(self, now_ns: int) -> bool:
        """Whether an emulator tells this vehicle's true position."""
        return self.truth is not None and now_ns - self.truth_received_ns <= TRUTH_STALE_NS

    def position_enu_m(self, now_ns: int) -> Vec3 | None:
        """Last reported position carried on with its velocity to now; None without fresh, valid, finite numbers."""
        message = self.telemetry
        if message is None or not self.is_fresh(now_ns) or not message.is_position_valid:
            return None
        ahead_s = max(0.0, (now_ns - self.received_ns) * 1e-9)
        return _along(message.position_enu_m, message.velocity_enu_m_s, ahead_s)

    @property
    def is_disarmed_by_px4(self) -> bool:
        """Whether PX4 has told so on the direct way, after the last word of the agent."""
        return self.direct_disarmed_ns > self.received_ns

    @property
    def is_armed(self) -> bool:
        """By the last telemetry, unless PX4 has since told on the direct way that it is not."""
        return self.telemetry is not None and self.telemetry.is_armed and not self.is_disarmed_by_px4

    @property
    def is_airborne(self) -> bool:
        """By the last telemetry, unless PX4 has since told on the direct way that it is disarmed."""
        return self.telemetry is not None and self.telemetry.is_airborne and not self.is_disarmed_by_px4


class FleetState(Struct, frozen=True):
    """Everything the ground knows. ``vehicles`` keeps the order of the fleet file.

    smallest: smallest separation so far while one of the two flew, by telemetry; smallest_truth: the same by ground
    truth, None outside simulation. nodes: who has a liveliness token. malformed: messages that were none.
    """

    vehicles: Mapping[str, VehicleView]
    events: tuple[LoggedEvent, ...] = ()
    nodes: frozenset[str] = frozenset()
    smallest: Separation | None = None
    smallest_truth: Separation | None = None
    malformed: int = 0

    def closest(self, now_ns: int) -> Separation | None:
        """The closest pair now, by fresh telemetry; None with fewer than two positions."""
        spots = [(name, view.position_enu_m(now_ns)) for name, view in self.vehicles.items()]
        known = [(name, spot) for name, spot in spots if spot is not None]
        pairs = (
            Separation(one, two, math.dist(p[:2], q[:2]), now_ns)
            for (one, p), (two, q) in itertools.combinations(known, 2)
        )
        return min(pairs, key=lambda pair: pair.distance_m, default=None)

    @property
    def is_simulated(self) -> bool:
        """Whether any ground truth was heard."""
        return any(view.truth is not None for view in self.vehicles.values())

    @property
    def airborne_names(self) -> tuple[str, ...]:
        """Vehicles that fly, by their last telemetry."""
        return tuple(name for name, view in self.vehicles.items() if view.is_airborne)


def initial(fleet: FleetConfig) -> FleetState:
    """Nobody heard yet."""
    return FleetState(MappingProxyType({name: VehicleView(name) for name in fleet.enabled_names}))


def fold(state: FleetState, message: Message, now_ns: int) -> FleetState:
    """The state after one message received at ``now_ns``; unknown vehicles and repeated or old samples change nothing.

    A sample is old when its sequence is not above the last one of the same boot; a new boot id starts over.
    """
    if isinstance(message, Telemetry):
        return fold_telemetry(state, ((message, now_ns),))
    if isinstance(message, Truth):
        return fold_truths(state, (message,), now_ns)
    if isinstance(message, PreflightReport):
        return _fold_preflight(state, message, now_ns)
    if isinstance(message, Event):
        events = (*state.events[-(MAX_EVENTS - 1) :], LoggedEvent(now_ns, message))
        state = replace(state, events=events)
        view = state.vehicles.get(message.vehicle)
        if view is None:
            return state
        told_ns = now_ns if message.code == DIRECT_DISARMED else view.direct_disarmed_ns
        return _with(state, replace(view, last_event=message, direct_disarmed_ns=told_ns))
    return state


def fold_alive(state: FleetState, node: str, is_alive: bool) -> FleetState:
    """A liveliness token came or went."""
    nodes = state.nodes | {node} if is_alive else state.nodes - {node}
    state = replace(state, nodes=nodes)
    view = state.vehicles.get(node)
    return state if view is None else _with(state, replace(view, is_alive=is_alive))


def fold_malformed(state: FleetState) -> FleetState:
    """Something arrived that was no message: counted, otherwise ignored."""
    return replace(state, malformed=state.malformed + 1)


def fold_telemetry(state: FleetState, heard: Sequence[tuple[Telemetry, int]]) -> FleetState:
    """The state after telemetry of several vehicles, each with when it was received; the same for one of them.

    What a large fleet says at once is compared at once. Who speaks twice is compared twice: nothing near is skipped.
    """
    vehicles, told, now_ns, malformed = dict(state.vehicles), set[str](), 0, state.malformed
    for message, now_ns in heard:
        view = vehicles.get(message.vehicle)
        if view is None:
            continue
        last = view.telemetry
        if last is not None and last.boot_id == message.boot_id and message.sequence <= last.sequence:
            continue
        if view.name in told:
            state = _compared(replace(state, vehicles=MappingProxyType(dict(vehicles))), told, now_ns)
            told.clear()
        if not _finite(message.position_enu_m) or not _finite(message.velocity_enu_m_s):
            malformed += 1
            message = _without_position(message)
        vehicles[view.name] = replace(view, telemetry=message, received_ns=now_ns)
        told.add(view.name)
    if not told:
        return state
    return _compared(replace(state, vehicles=MappingProxyType(vehicles), malformed=malformed), told, now_ns)


def _compared(state: FleetState, told: Set[str], now_ns: int) -> FleetState:
    """With the smallest separation between those who just ``told`` their place and everybody."""
    if not any(view.is_airborne for view in state.vehicles.values()):
        return state
    known = [(view, spot) for view in state.vehicles.values() if (spot := view.position_enu_m(now_ns)) is not None]
    pair = _closest_pair(
        np.array([spot[:2] for _, spot in known]),
        np.array([view.is_airborne for view, _ in known]),
        np.array([view.name in told for view, _ in known]),
        math.inf if state.smallest is None else state.smallest.distance_m,
    )
    if pair is None:
        return state
    one, two, distance_m = pair
    names = known[one][0].name, known[two][0].name
    return replace(state, smallest=_separation(*names, distance_m, now_ns, is_truth=False))


def _closest_pair(
    spots: NDArray[np.float64], is_up: NDArray[np.bool_], is_told: NDArray[np.bool_], below_m: float
) -> tuple[int, int, float] | None:
    """The closest two of ``spots`` (n, 2) in metres, one of which flies and one of which was just told.

    None where nobody comes closer than ``below_m``.
    """
    rows = np.flatnonzero(is_told)
    if not len(rows) or not is_up.any():
        return None
    offset = spots[rows, None] - spots[None]
    distance_m = np.hypot(offset[..., 0], offset[..., 1])
    distance_m[~(is_up[rows, None] | is_up[None])] = np.inf
    distance_m[np.arange(len(rows)), rows] = np.inf
    row, other = divmod(int(distance_m.argmin()), len(spots))
    found = float(distance_m[row, other])
    return (int(rows[row]), other, found) if found < below_m else None


def _fold_preflight(state: FleetState, message: PreflightReport, now_ns: int) -> FleetState:
    view = state.vehicles.get(message.vehicle)
    if view is None:
        return state
    last = view.preflight
    if last is not None and last.boot_id == message.boot_id and message.sequence <= last.sequence:
        return state
    return _with(state, replace(view, preflight=message, preflight_received_ns=now_ns))


def fold_truths(state: FleetState, messages: Sequence[Truth], now_ns: int) -> FleetState:
    """The state after ground truth of several vehicles, received together; the same for one of them."""
    vehicles = dict(state.vehicles)
    told = set()
    for message in messages:
        view = vehicles.get(message.vehicle)
        if view is None or not (_finite(message.position_enu_m) and _finite(message.velocity_enu_m_s)):
            continue
        if view.truth is not None and message.stamp_ns <= view.truth.stamp_ns and view.has_truth(now_ns):
            continue
        vehicles[view.name] = replace(view, truth=message, truth_received_ns=now_ns)
        told.add(view.name)
    if not told:
        return state
    state = replace(state, vehicles=MappingProxyType(vehicles))
    known = [view.truth for view in vehicles.values() if view.truth is not None and view.has_truth(now_ns)]
    # All samples come from one clock; the older ones are carried on to the newest one's stamp.
    newest_ns = max([truth.stamp_ns for truth in known])
    spots = np.array([t.position_enu_m for t in known])[:, :2]
    if any(truth.stamp_ns != newest_ns for truth in known):
        ahead_s = np.array([(newest_ns - truth.stamp_ns) * 1e-9 for truth in known])
        spots = spots + ahead_s[:, None] * np.array([t.velocity_enu_m_s for t in known])[:, :2]
    pair = _closest_pair(
        spots,
        np.array([not truth.is_on_ground for truth in known]),
        np.array([truth.vehicle in told for truth in known]),
        math.inf if state.smallest_truth is None else state.smallest_truth.distance_m,
    )
    if pair is None:
        return state
    one, two, distance_m = pair
    names = known[one].vehicle, known[two].vehicle
    return replace(state, smallest_truth=_separation(*names, distance_m, newest_ns, is_truth=True))


def _separation(one: str, two: str, distance_m: float, stamp_ns: int, *, is_truth: bool) -> Separation:
    return Separation(min(one, two), max(one, two), distance_m, stamp_ns, is_truth)


def _with(state: FleetState, view: VehicleView) -> FleetState:
    return replace(state, vehicles=MappingProxyType({**state.vehicles, view.name: view}))


def _along(position: Vec3, velocity: Vec3, ahead_s: float) -> Vec3:
    return (
        position[0] + velocity[0] * ahead_s,
        position[1] + velocity[1] * ahead_s,
        position[2] + velocity[2] * ahead_s,
    )


def _finite(vector: Vec3) -> bool:
    return all(math.isfinite(value) for value in vector)


def _without_position(message: Telemetry) -> Telemetry:
    zero = (0.0, 0.0, 0.0)
    return msgspec.structs.replace(message, position_enu_m=zero, velocity_enu_m_s=zero, is_position_valid=False)
