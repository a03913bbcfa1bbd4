"""The links between all nodes that run: listened to for some seconds as one that only watches, then
judged.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field

from groundstation.client.ground_node import session
from groundstation.keys.listeners import is_listening
from groundstation.network.diagnosis import Diagnosis, Grade, graded
from onboard.bus.clock_sync import BEAT_S, ClockNode
from onboard.bus.codec import Malformed
from onboard.bus.control_token import WATCHER
from onboard.bus.schema import ClockMessage, Message, StateMessage, Telemetry, TickBatch
from onboard.bus.topics import TOPICS, Topic
from onboard.config.fleet import FleetConfig
from onboard.feasibility.pair_checks import message_age_s
from onboard.message_counts import in_words
from onboard.neighbours.table import SILENT_S

_STEP_S = 0.02
_STATES_HZ = TOPICS[Topic.STATE].rate_hz
_WELL_SHARE, _LEAST_SHARE = 0.95, 0.5  # of the states that arrive
_OLD_S = 0.1  # age of a state, and what [radio] expects where that is more
_LONG_S = 0.1  # a round trip
_CLOCK_S = 0.02  # error of another computer's clock


@dataclass(slots=True)
class Heard:
    """Everything that was heard, by our monotonic clock."""

    nodes: set[str] = field(default_factory=set)
    # (receiver, sender) -> shortest difference of arrival and sending, each by its own computer's
    # clock [ns]
    ways_ns: dict[tuple[str, str], int] = field(default_factory=dict)
    hosts: dict[str, int] = field(default_factory=dict)  # node -> its computer
    # node on another computer -> error of its clock
    clock_errors_s: dict[str, float] = field(default_factory=dict)
    # vehicle -> states that arrived
    sequences: dict[str, set[int]] = field(default_factory=lambda: defaultdict(set))
    # vehicle -> of its states, here
    ages_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    # (receiver, sender) -> ages of the newest state at each tick of the receiver
    ages_there_s: dict[tuple[str, str], list[float]] = field(
        default_factory=lambda: defaultdict(list)
    )
    first: dict[str, Telemetry] = field(default_factory=dict)
    last: dict[str, Telemetry] = field(default_factory=dict)
    # vehicles that told nothing, but listen at their endpoint
    listening: set[str] = field(default_factory=set)
    state_ticks: int = 1  # from the number of one state to that of the next
    seconds: float = 0.0


def listen(fleet: FleetConfig, seconds: float) -> Heard:
    """Listen to a fleet's bus for some seconds, as a node that only watches.

    Raises:
        ConfigError: the fleet's keys do not fit. BusError: the bus cannot be opened.
    """
    heard, bus = Heard(state_ticks=fleet.state_ticks, seconds=seconds), session(fleet, WATCHER)
    clock = ClockNode(bus)

    def take(_topic: Topic, name: str, message: Message | Malformed) -> None:
        now_ns = time.monotonic_ns()
        if isinstance(message, StateMessage):
            heard.sequences[name].add(message.sequence)
            heard.ages_s[name].append(
                (now_ns - clock.clocks.own_ns(name, message.stamp_ns, now_ns)) * 1e-9
            )
        elif isinstance(message, Telemetry):
            heard.first.setdefault(name, message)
            heard.last[name] = message
        elif isinstance(message, TickBatch):
            for tick in message.ticks:
                for other, age_s in tick.neighbour_ages_s.items():
                    heard.ages_there_s[name, other].append(age_s)
        elif isinstance(message, ClockMessage) and message.node == name:
            _take_clock(heard, bus.node, message, now_ns)

    bus.start()
    try:
        bus.watch_alive(
            lambda node, is_alive: (heard.nodes.add if is_alive else heard.nodes.discard)(node)
        )
        clock.start()
        for topic in (Topic.STATE, Topic.TELEMETRY, Topic.TICK, Topic.CLOCK):
            bus.collect(topic, "*", take)
        end_s, beat_s = time.monotonic() + seconds, 0.0
        while time.monotonic() < end_s:
            if time.monotonic() >= beat_s:
                beat_s = time.monotonic() + BEAT_S
                clock.beat()
            time.sleep(_STEP_S)
            bus.deliver()
        heard.hosts[bus.node] = clock.clocks.host
        heard.clock_errors_s = clock.clocks.bounds_s(time.monotonic_ns())
        heard.nodes.discard(bus.node)
    finally:
        bus.stop()
    silent = [name for name in fleet.enabled_names if name not in heard.last]
    heard.listening = {name for name in silent if is_listening(fleet.vehicles[name].agent)}
    return heard


def _take_clock(heard: Heard, own_node: str, message: ClockMessage, now_ns: int) -> None:
    heard.hosts[message.node] = message.host
    arrivals = [(own_node, message.node, now_ns - message.sent_ns)]
    arrivals += [(message.node, one.node, one.received_ns - one.sent_ns) for one in message.heard]
    for receiver, sender, way_ns in arrivals:
        heard.ways_ns[receiver, sender] = min(way_ns, heard.ways_ns.get((receiver, sender), way_ns))


def judged(fleet: FleetConfig, heard: Heard) -> Iterator[Diagnosis]:
    """Yield what is to be said of each vehicle, then of the computers."""
    for name in fleet.enabled_names:
        if name not in heard.last:
            yield _silent(name, fleet, heard)
            continue
        yield _arrivals(name, fleet, heard)
        yield from _neighbours(name, fleet, heard)
        yield from _unused(name, heard)
    yield from _round_trips(heard)
    for node, error_s in sorted(heard.clock_errors_s.items()):
        text = f"Known within {1e3 * error_s:.1f} ms." if error_s < 1e3 else "Not measured yet."
        yield graded(
            f"clock of {node}",
            error_s < _CLOCK_S,
            text,
            "Wait some seconds; else its way here is too slow.",
        )


def _silent(name: str, fleet: FleetConfig, heard: Heard) -> Diagnosis:
    """Return why a vehicle tells nothing, as far as that can be seen from here."""
    endpoint = fleet.vehicles[name].agent
    if name in heard.nodes:
        return Diagnosis(
            name, Grade.FAIL, "On the bus, but tells nothing.", "Look at its log: covey agent logs"
        )
    if name in heard.listening and fleet.has_keys:
        said = (
            f"It runs at {endpoint}, and takes no link: its keys are others, or its clock is wrong."
        )
        remedy = "Copy keys/ca.pem and its own two files to it anew, and start its agent anew (covey keys list FLEET)."
        return Diagnosis(name, Grade.FAIL, said, remedy)
    if name in heard.listening:
        remedy = "Does its agent have this fleet file, and does it have keys that this file does not know of?"
        return Diagnosis(
            name, Grade.FAIL, f"It runs at {endpoint}, and is not of this fleet.", remedy
        )
    remedy = "Does its agent run (covey agent status)? Is its computer reached (ping)?"
    return Diagnosis(name, Grade.FAIL, f"Nobody answers at {endpoint}.", remedy)


def _old_s(fleet: FleetConfig) -> float:
    """Return the age of a state from which on it is older than the fleet's margin is for."""
    return max(_OLD_S, message_age_s(fleet) + _STEP_S)


def _arrivals(name: str, fleet: FleetConfig, heard: Heard) -> Diagnosis:
    numbers = heard.sequences[name]
    sent = (max(numbers) - min(numbers)) // heard.state_ticks + 1 if numbers else 1
    share = len(numbers) / sent
    age_s = _p99(heard.ages_s[name])
    text = f"{len(numbers) / heard.seconds:.0f} states a second come here, {100.0 * (1.0 - share):.1f} % are lost, "
    text += f"their age is {1e3 * age_s:.0f} ms (p99)."
    bad = Grade.FAIL if share < _LEAST_SHARE or not numbers else Grade.WARN
    remedy = "Too much of its radio is lost: a better place or channel, fewer on it; quic/ instead of tcp/."
    return graded(name, share >= _WELL_SHARE and age_s < _old_s(fleet), text, remedy, bad=bad)


def _neighbours(name: str, fleet: FleetConfig, heard: Heard) -> Iterator[Diagnosis]:
    ages_s = {
        other: heard.ages_there_s.get((name, other), [])
        for other in fleet.enabled_names
        if other != name
    }
    known = {other: _p99(ages) for other, ages in ages_s.items() if ages}
    if not known:
        return
    old_s, silent_s = _old_s(fleet), SILENT_S + fleet.expected_radio.lateness_s
    old = {other: age_s for other, age_s in known.items() if age_s >= old_s}
    told = ", ".join(
        f"{other} {1e3 * age_s:.0f} ms" for other, age_s in sorted((old or known).items())
    )
    bad = Grade.FAIL if any(age_s >= silent_s for age_s in old.values()) else Grade.WARN
    text = f"Age of the others' states (p99): {told}."
    remedy = (
        f"The fleet's margin is for {1e3 * old_s:.0f} ms, and older than {1e3 * silent_s:.0f} ms they count as silent: "
        "improve the radio there, or declare it ([radio] expected_delay_s, docs/network.md)."
    )
    yield graded(f"{name} hears", not old, text, remedy, bad=bad)


def _unused(name: str, heard: Heard) -> Iterator[Diagnosis]:
    """Yield what a vehicle could not use of the messages that came meanwhile."""
    fields = "malformed_messages", "refused_messages", "dropped_messages", "late_messages"
    first, last = heard.first[name], heard.last[name]
    counts = [max(0, getattr(last, field) - getattr(first, field)) for field in fields]
    words = in_words(*counts)
    if words:
        few = (
            counts[0] == counts[1] == 0
            and sum(counts) < (1.0 - _WELL_SHARE) * _STATES_HZ * heard.seconds
        )
        remedy = (
            "Refused or malformed ones are of another version, or of a stranger: docs/threats.md"
        )
        yield graded(
            f"{name} did not use", few, f"Of the last {heard.seconds:.0f} s: {words}.", remedy
        )


def _round_trips(heard: Heard) -> Iterator[Diagnosis]:
    """Yield the round trips between computers; nodes of one computer have none to speak of."""
    trips_s = {
        (one, other): (way_ns + heard.ways_ns[other, one]) * 1e-9
        for (one, other), way_ns in heard.ways_ns.items()
        if one < other
        and (other, one) in heard.ways_ns
        and heard.hosts.get(one) != heard.hosts.get(other)
    }
    for (one, other), trip_s in sorted(trips_s.items(), key=lambda item: -item[1]):
        text = f"{1e3 * trip_s:.1f} ms at best, there and back."
        yield graded(
            f"{one} - {other}", trip_s < _LONG_S, text, "Too long a way: take nearer access points."
        )
    if not trips_s and heard.last:
        yield Diagnosis("round trips", Grade.OK, "All nodes that were heard run on one computer.")


def _p99(values: list[float]) -> float:
    return sorted(values)[round(0.99 * (len(values) - 1))] if values else float("inf")
