"""Checks of the links between all running nodes: we listen for some seconds, and then judge.

We listen as a node that only watches. Each vehicle publishes its states with sequence numbers and
time stamps, and reports the age of each neighbour's newest state at its ticks. Each node answers
the clock messages of the others. Rates, losses, ages, round trips and clock errors follow from
this, here and between any two nodes.
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
from onboard.bus.session import BusSession
from onboard.bus.topics import TOPICS, Topic
from onboard.bus.zenoh_settings import ROUTER_LEASE_MS, lease_ms, longest_round_trip_s
from onboard.config.fleet import FleetConfig
from onboard.feasibility.pair_checks import message_age_s
from onboard.message_counts import in_words
from onboard.neighbours.table import SILENT_S

_STEP_S = 0.02  # period at which messages that have come are looked at
_STATES_HZ = TOPICS[Topic.STATE].rate_hz

# Share of the states that arrive.
_GOOD_SHARE = 0.95
_MIN_SHARE = 0.5  # below this share a fleet cannot fly

_OLD_S = 0.1  # a state of this age is old, unless [radio] expects more
_LONG_S = 0.1  # a longer round trip is too long
_CLOCK_S = 0.02  # a larger error of another computer's clock is too large
_NOT_MEASURED_S = 1e3  # a clock that is not measured yet has a larger error than this

# fields of telemetry that count messages which a vehicle could not use
_UNUSED_FIELDS = ("malformed_messages", "refused_messages", "dropped_messages", "late_messages")

_NOT_REACHED_REMEDY = "Does its agent run (covey agent status)? Is its computer reached (ping)?"


@dataclass(slots=True)
class Heard:
    """Everything that was heard, with times of our monotonic clock."""

    nodes: set[str] = field(default_factory=set)
    # (receiver, sender) -> least time of arrival minus time of sending [ns]; each time is by the
    # clock of its own computer, so that only the sum of both directions is free of their difference
    delays_ns: dict[tuple[str, str], int] = field(default_factory=dict)
    hosts: dict[str, int] = field(default_factory=dict)  # node -> its computer
    # node on another computer -> error of its clock
    clock_errors_s: dict[str, float] = field(default_factory=dict)
    boot_ids: dict[str, int] = field(default_factory=dict)  # vehicle -> start of its agent
    # vehicle -> numbers of its states that arrived since the start of its agent
    sequences: dict[str, set[int]] = field(default_factory=lambda: defaultdict(set))
    # vehicle -> ages of its states when they arrived here
    ages_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    last_state_ns: dict[str, int] = field(default_factory=dict)  # vehicle -> arrival of its last
    # (receiver, sender) -> ages of the newest state at each tick of the receiver
    ages_at_receiver_s: dict[tuple[str, str], list[float]] = field(
        default_factory=lambda: defaultdict(list)
    )
    # vehicle -> its first and its last telemetry
    first: dict[str, Telemetry] = field(default_factory=dict)
    last: dict[str, Telemetry] = field(default_factory=dict)
    # vehicles that sent nothing, although a process listens at their endpoint
    listening: set[str] = field(default_factory=set)
    state_ticks: int = 1  # difference of the sequence numbers of two consecutive states
    seconds: float = 0.0  # duration of listening
    end_ns: int = 0  # end of listening


def listen(fleet: FleetConfig, seconds: float) -> Heard:
    """Listen to a fleet's bus for some seconds, as a node that only watches.

    Args:
        fleet: the fleet file.
        seconds: duration of listening [s].

    Raises:
        ConfigError: the fleet's keys do not fit.
        BusError: the bus cannot be opened.
    """
    heard = Heard(state_ticks=fleet.state_ticks, seconds=seconds)
    bus = session(fleet, WATCHER)
    clock = ClockNode(bus)

    def keep_alive(node: str, is_alive: bool) -> None:
        if is_alive:
            heard.nodes.add(node)
        else:
            heard.nodes.discard(node)

    def keep(_topic: Topic, name: str, message: Message | Malformed) -> None:
        _note(heard, bus, clock, name, message)

    bus.start()
    try:
        bus.watch_alive(keep_alive)
        clock.start()
        for topic in (Topic.STATE, Topic.TELEMETRY, Topic.TICK, Topic.CLOCK):
            bus.collect(topic, "*", keep)

        end_s = time.monotonic() + seconds
        next_beat_s = 0.0
        while time.monotonic() < end_s:
            if time.monotonic() >= next_beat_s:
                next_beat_s = time.monotonic() + BEAT_S
                clock.beat()
            time.sleep(_STEP_S)
            bus.deliver()

        heard.end_ns = time.monotonic_ns()
        heard.hosts[bus.node] = clock.clocks.host
        heard.clock_errors_s = clock.clocks.largest_errors_s(time.monotonic_ns())
        heard.nodes.discard(bus.node)
    finally:
        bus.stop()

    for name in fleet.enabled_names:
        if name not in heard.last and is_listening(fleet.vehicles[name].agent):
            heard.listening.add(name)
    return heard


def _note(
    heard: Heard, bus: BusSession, clock: ClockNode, name: str, message: Message | Malformed
) -> None:
    """Note the parts of one message that are judged later."""
    now_ns = time.monotonic_ns()
    if isinstance(message, StateMessage):
        sent_ns = clock.clocks.own_ns(name, message.stamp_ns, now_ns)
        if heard.boot_ids.get(name) != message.boot_id:
            heard.boot_ids[name] = message.boot_id
            heard.sequences[name].clear()  # an agent that has restarted counts from 0
        heard.sequences[name].add(message.sequence)
        heard.ages_s[name].append((now_ns - sent_ns) * 1e-9)
        heard.last_state_ns[name] = now_ns
    elif isinstance(message, Telemetry):
        heard.first.setdefault(name, message)
        heard.last[name] = message
    elif isinstance(message, TickBatch):
        for tick in message.ticks:
            for other, age_s in tick.neighbour_ages_s.items():
                heard.ages_at_receiver_s[name, other].append(age_s)
    elif isinstance(message, ClockMessage) and message.node == name:
        _note_delays(heard, bus.node, message, now_ns)


def _note_delays(heard: Heard, own_node: str, message: ClockMessage, now_ns: int) -> None:
    """Note the least delays from the sender to us, and to the sender from nodes it has heard."""
    heard.hosts[message.node] = message.host

    delays = [(own_node, message.node, now_ns - message.sent_ns)]
    for beat in message.heard:
        delays.append((message.node, beat.node, beat.received_ns - beat.sent_ns))
    for receiver, sender, delay_ns in delays:
        least_ns = heard.delays_ns.get((receiver, sender), delay_ns)
        heard.delays_ns[receiver, sender] = min(delay_ns, least_ns)


def judged(fleet: FleetConfig, heard: Heard) -> Iterator[Diagnosis]:
    """Yield the findings about each vehicle, and then about the computers."""
    for name in fleet.enabled_names:
        if name not in heard.last:
            yield _silent_vehicle(name, fleet, heard)
            continue
        yield _arrivals(name, fleet, heard)
        yield from _neighbours(name, fleet, heard)
        yield from _unused_messages(name, heard)

    yield from _round_trips(heard)
    yield _limits_of_links(fleet)
    for node, error_s in sorted(heard.clock_errors_s.items()):
        text = "Not measured yet."
        if error_s < _NOT_MEASURED_S:
            text = f"Known within {1e3 * error_s:.1f} ms."
        yield graded(
            f"clock of {node}",
            error_s < _CLOCK_S,
            text,
            f"Wait some seconds. If this stays, the network between here and {node} is too slow.",
        )


def _silent_vehicle(name: str, fleet: FleetConfig, heard: Heard) -> Diagnosis:
    """Return the probable reason why a vehicle sends nothing."""
    endpoint = fleet.vehicles[name].agent
    if name in heard.nodes:
        text = "On the bus, but publishes nothing."
        remedy = "Look at its log: covey agent logs"
    elif name in heard.listening and fleet.has_keys:
        text = (
            f"It runs at {endpoint}, but accepts no link: its keys differ, or its clock is wrong."
        )
        remedy = (
            "Copy keys/ca.pem and its own two files to it anew, and start its agent anew"
            f" (covey keys list FLEET). A way of more than {_longest_ms(fleet):.0f} ms there and"
            " back (ping) looks the same."
        )
    elif name in heard.listening:
        text = f"It runs at {endpoint}, and is not of this fleet."
        remedy = (
            "Does its agent have this fleet file, and does it have keys that this file does not"
            " know of?"
        )
    else:
        text = f"Nobody answers at {endpoint}."
        remedy = _NOT_REACHED_REMEDY
    return Diagnosis(name, Grade.FAIL, text, remedy)


def _old_s(fleet: FleetConfig) -> float:
    """Return the age [s] above which a state is older than the fleet's margin allows.

    A state may also wait here for up to one of our periods, so a period is added.
    """
    return max(_OLD_S, message_age_s(fleet) + _STEP_S)


def _silent_s(fleet: FleetConfig) -> float:
    """Return the age [s] of its newest state above which a vehicle counts as silent."""
    return SILENT_S + fleet.expected_radio.lateness_s


def _arrivals(name: str, fleet: FleetConfig, heard: Heard) -> Diagnosis:
    """Return the finding about rate, loss and age of a vehicle's states as we receive them."""
    last_ns = heard.last_state_ns.get(name, heard.end_ns)
    silence_s = (heard.end_ns - last_ns) * 1e-9
    if silence_s > _silent_s(fleet):
        return Diagnosis(
            name,
            Grade.FAIL,
            f"It fell silent while we listened: no state came in the last {silence_s:.1f} s.",
            _NOT_REACHED_REMEDY,
        )

    numbers = heard.sequences[name]
    sent_count = 1
    if numbers:
        sent_count = (max(numbers) - min(numbers)) // heard.state_ticks + 1
    received_share = len(numbers) / sent_count
    lost_pct = 100.0 * (1.0 - received_share)
    rate_hz = len(numbers) / heard.seconds
    age_s = _p99(heard.ages_s[name])

    bad = Grade.WARN
    if received_share < _MIN_SHARE:
        bad = Grade.FAIL
    return graded(
        name,
        received_share >= _GOOD_SHARE and age_s < _old_s(fleet),
        f"{rate_hz:.0f} states a second come here, {lost_pct:.1f} % are lost, "
        f"their age is {1e3 * age_s:.0f} ms (p99).",
        "Its radio loses or delays too much: a better place or channel, fewer on it;"
        " quic/ instead of tcp/.",
        bad=bad,
    )


def _neighbours(name: str, fleet: FleetConfig, heard: Heard) -> Iterator[Diagnosis]:
    """Yield the finding about the ages of the others' states at a vehicle, if it reported them."""
    ages_s = {}
    for other in fleet.enabled_names:
        reported_s = heard.ages_at_receiver_s.get((name, other), [])
        if other != name and reported_s:
            ages_s[other] = _p99(reported_s)
    if not ages_s:
        return

    old_s = _old_s(fleet)
    silent_s = _silent_s(fleet)
    old_ages_s = {other: age_s for other, age_s in ages_s.items() if age_s >= old_s}

    bad = Grade.WARN
    if any(age_s >= silent_s for age_s in old_ages_s.values()):
        bad = Grade.FAIL
    shown = ages_s
    if old_ages_s:
        shown = old_ages_s
    listed = ", ".join(f"{other} {1e3 * age_s:.0f} ms" for other, age_s in sorted(shown.items()))
    yield graded(
        f"{name} hears",
        not old_ages_s,
        f"Age of the others' states (p99): {listed}.",
        f"The fleet's margin allows for {1e3 * old_s:.0f} ms. A vehicle whose newest state is older"
        f" than {1e3 * silent_s:.0f} ms counts as silent. Improve the radio at {name}, or declare"
        " its delay ([radio] expected_delay_s, docs/network.md).",
        bad=bad,
    )


def _unused_messages(name: str, heard: Heard) -> Iterator[Diagnosis]:
    """Yield the finding about messages that a vehicle could not use while we listened."""
    first = heard.first[name]
    last = heard.last[name]
    # a restarted agent counts from 0 again
    counts = [max(0, getattr(last, field) - getattr(first, field)) for field in _UNUSED_FIELDS]
    words = in_words(*counts)
    if not words:
        return

    malformed, refused, _, _ = counts
    has_foreign = malformed > 0 or refused > 0
    tolerated = (1.0 - _GOOD_SHARE) * _STATES_HZ * heard.seconds
    yield graded(
        f"{name} did not use",
        not has_foreign and sum(counts) < tolerated,
        f"Of the last {heard.seconds:.0f} s: {words}.",
        "Refused or malformed ones are of another version, or of a stranger: docs/threats.md",
    )


def _round_trips(heard: Heard) -> Iterator[Diagnosis]:
    """Yield the round trips between computers, the longest first.

    Round trips between nodes on the same computer are left out.
    """
    trips_s = {}
    for (one, other), delay_ns in heard.delays_ns.items():
        if one >= other:
            continue  # the loop meets this pair the other way round, too
        delay_back_ns = heard.delays_ns.get((other, one))
        is_one_computer = heard.hosts.get(one) == heard.hosts.get(other)
        if delay_back_ns is not None and not is_one_computer:
            trips_s[one, other] = (delay_ns + delay_back_ns) * 1e-9

    for (one, other), trip_s in sorted(trips_s.items(), key=lambda item: -item[1]):
        yield graded(
            f"{one} - {other}",
            trip_s < _LONG_S,
            f"{1e3 * trip_s:.1f} ms at best, there and back.",
            "Too long a way: take nearer access points.",
        )
    if not trips_s and heard.last:
        yield Diagnosis("round trips", Grade.OK, "All nodes that were heard run on one computer.")


def _limits_of_links(fleet: FleetConfig) -> Diagnosis:
    """Return the longest round trip and the longest outage that this fleet's links allow."""
    endpoints = [
        *fleet.fleet.routers,
        *(fleet.vehicles[name].agent for name in fleet.enabled_names),
    ]
    silent_s = 1e-3 * lease_ms(endpoints)
    if len(fleet.fleet.routers) > 1:  # a node must change to another router soon
        silent_s = 1e-3 * ROUTER_LEASE_MS
    return Diagnosis(
        "links",
        Grade.OK,
        f"They open over at most {_longest_ms(fleet):.0f} ms there and back, and are closed after"
        f" {silent_s:.1f} s of silence. After an outage of 1 s states come again within 0.3 s"
        " (docs/network.md).",
    )


def _longest_ms(fleet: FleetConfig) -> float:
    return 1e3 * longest_round_trip_s(fleet.fleet.routers)


def _p99(values: list[float]) -> float:
    """Return the value that 99 % do not exceed; infinity without values."""
    if not values:
        return float("inf")
    return sorted(values)[round(0.99 * (len(values) - 1))]
