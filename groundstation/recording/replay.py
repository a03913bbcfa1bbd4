"""Replay of a recorded flight: the fleet's state at any time of the record.

:class:`Replay` has the same methods as a client, as far as the console uses them; it refuses
orders. The same code as in a live flight folds the messages into the state, on the record's own
clock. The state is kept every two seconds of the record, so that going back is quick.
"""

from __future__ import annotations

import asyncio
import bisect
import itertools
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from groundstation.alarms.alarms import plain
from groundstation.fleet import state as fleet_state
from groundstation.fleet.state import FleetState
from groundstation.fleet.tick_stream import KEPT
from groundstation.orders.grammar import OrderError
from groundstation.orders.intents import Intent
from groundstation.orders.result import OrderResult
from groundstation.recording.channels import as_mapping, undecoded_words
from groundstation.recording.timeline import Reading, RecordedMessage, Timeline
from groundstation.recording.writer import event_line
from onboard.bus.schema import Telemetry, TickSample, Truth
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
STEP_NS = 100_000_000  # the console's own period
KEYFRAME_NS = 2_000_000_000  # time between two states that are kept
MAX_KEYFRAMES = 20_000
# A seek back begins this long before its target, so that trails and charts are filled.
MEMORY_NS = 60_000_000_000
# When another vehicle is followed, its ticks of this long before the present are read at once.
TICKS_NS = 20_000_000_000
_SLICE_S = 0.02  # work of a seek between two breaks, in which other tasks draw the console
_MAX_PLAY_S = 4.0 * _SLICE_S  # one call of Replay.play works no longer than this
_MAX_ELAPSED_S = 1.0  # one call of Replay.play makes up for a pause of at most this
# While the record plays, a jump back skips events that are less than this behind. After a jump to
# an event the replay passes that event at once, so the next jump would lead to it again.
_BACK_NS = 1_000_000_000
_FOLDED = frozenset(("telemetry", "truth", "event", "preflight"))  # topics of the fleet's state
REFUSAL = (
    "This is a recorded flight: nothing can be ordered. Attach to a flying fleet with covey tui."
)

OnStep = Callable[[FleetState, int], None]


class RecordedTickStream:
    """The latest ticks of one vehicle, from the record.

    Args:
        on_change: called when another vehicle is followed.
    """

    def __init__(self, on_change: Callable[[], None]) -> None:
        self.values: deque[TickSample] = deque(maxlen=KEPT)
        self.vehicle: str | None = None
        self._on_change = on_change

    def follow(self, vehicle: str | None) -> None:
        """Keep the ticks of this vehicle from now on; None keeps none."""
        if vehicle != self.vehicle:
            self.vehicle = vehicle
            self.values.clear()
            self._on_change()


class Replay:
    """Plays a record; the caller calls :meth:`play` often.

    Args:
        fleet: the fleet file.
        timeline: the record.
        speed: speed of the replay as a multiple of real time.
    """

    def __init__(self, fleet: FleetConfig, timeline: Timeline, *, speed: float = 1.0) -> None:
        self.fleet = fleet
        self.timeline = timeline
        self.is_playing = True
        self.speed = speed
        self.tick_stream = RecordedTickStream(self._read_again)
        self.seeking: float | None = None  # progress of the seek under way, 0 to 1; None: no seek

        self._listeners: list[OnStep] = []
        self._resets: list[Callable[[], None]] = []

        # one nanosecond early, because a reading yields only messages after this time
        self._now_ns = timeline.begin_ns - 1
        self._state = fleet_state.initial(fleet)
        self._keyframes = [(self._now_ns, self._state)]  # the kept states, by rising time
        self._reading = self._read_on()

        self._event_stamps = [
            stamp_ns for stamp_ns, event in timeline.events if event.severity != "debug"
        ]
        self._target_ns: int | None = None  # target of a seek that has not begun yet

    # -- as a client -------------------------------------------------------------------------------

    @property
    def state(self) -> FleetState:
        """The fleet at this time of the record."""
        return self._state

    def now_ns(self) -> int:
        """Return the time of the record [ns], on the record's clock."""
        return self._now_ns

    async def submit(self, order: Intent | str) -> OrderResult:
        """Refuse an order: the flight is over.

        Args:
            order: any order.

        Raises:
            OrderError: always.
        """
        raise OrderError(REFUSAL)

    # -- playing -----------------------------------------------------------------------------------

    @property
    def position_s(self) -> float:
        """Seconds since the record began."""
        return max(0.0, (self._now_ns - self.timeline.begin_ns) * 1e-9)

    @property
    def length_s(self) -> float:
        """Seconds from start to end."""
        return self.timeline.length_s

    @property
    def is_at_end(self) -> bool:
        """Whether the end of the record is reached."""
        return self._now_ns >= self.timeline.end_ns

    def add_listener(self, on_step: OnStep, on_reset: Callable[[], None]) -> None:
        """Add functions that follow the record.

        Args:
            on_step: called with state and time [ns], ten times per second of the record.
            on_reset: called when the replay goes back.
        """
        self._listeners.append(on_step)
        self._resets.append(on_reset)

    def play(self, elapsed_s: float) -> None:
        """Advance the replay, if it plays; it stops at the end of the record.

        Args:
            elapsed_s: real time since the last call [s].
        """
        if not self.is_playing or self.seeking is not None:
            return

        until_ns = self._now_ns + int(min(elapsed_s, _MAX_ELAPSED_S) * self.speed * 1e9)
        begin_s = time.perf_counter()
        for _ in self._steps(min(until_ns, self.timeline.end_ns)):
            if time.perf_counter() - begin_s > _MAX_PLAY_S:
                break  # this computer is too slow for the speed: play as fast as it can

        if self.is_at_end:
            self.is_playing = False

    def change_speed(self, steps: int) -> None:
        """Change the speed by a number of steps in SPEEDS; a negative number makes it slower."""
        nearest = min(range(len(SPEEDS)), key=lambda index: abs(SPEEDS[index] - self.speed))
        self.speed = SPEEDS[max(0, min(len(SPEEDS) - 1, nearest + steps))]

    async def seek(self, position_s: float) -> None:
        """Go to a time of the record. A new target replaces that of a seek under way.

        Args:
            position_s: seconds since the start of the record.
        """
        within_s = max(0.0, min(position_s, self.length_s))
        chosen_ns = self.timeline.begin_ns + int(within_s * 1e9)
        self._target_ns = min(chosen_ns, self.timeline.end_ns)
        if self.seeking is not None:
            return  # the seek under way takes over the new target

        self.seeking = 0.0
        try:
            while self._target_ns is not None:
                target_ns = self._target_ns
                self._target_ns = None
                await self._go(target_ns)
        finally:
            self.seeking = None

    async def jump(self, direction: int) -> None:
        """Go to the next event (+1) or the one before (-1)."""
        stamps = self._event_stamps
        if direction > 0:
            index = bisect.bisect_right(stamps, self._now_ns)
        else:
            before_ns = self._now_ns
            if self.is_playing:
                before_ns -= _BACK_NS
            index = bisect.bisect_left(stamps, before_ns) - 1

        if 0 <= index < len(stamps):
            await self.seek((stamps[index] - self.timeline.begin_ns) * 1e-9)
        elif direction > 0:
            await self.seek(self.length_s)
        else:
            await self.seek(0.0)

    async def _go(self, target_ns: int) -> None:
        """Replay up to a time.

        If the time is behind, the replay starts from a kept state MEMORY_NS before it. The event
        loop runs other tasks after each slice of work. A newer target ends this seek.
        """
        if target_ns < self._now_ns:
            self._turn_back(target_ns - MEMORY_NS)

        start_ns = self._now_ns
        begin_s = time.perf_counter()
        for _ in self._steps(target_ns):
            if time.perf_counter() - begin_s > _SLICE_S:
                self.seeking = (self._now_ns - start_ns) / max(1, target_ns - start_ns)
                await asyncio.sleep(0.001)
                begin_s = time.perf_counter()
                if self._target_ns is not None:
                    return

    def _turn_back(self, before_ns: int) -> None:
        """Go back to the newest kept state that is not newer than a time."""
        # index of the first newer state
        newer = bisect.bisect_right(self._keyframes, before_ns, key=lambda kept: kept[0])
        self._now_ns, self._state = self._keyframes[max(0, newer - 1)]

        self.tick_stream.values.clear()
        self._reading = self._read_on()
        for reset in self._resets:
            reset()

    def _read_again(self) -> None:
        """Read the last ticks of the vehicle that is followed now, and go on from the present."""
        self._reading = self._read_on()
        if self.tick_stream.vehicle is None:
            return

        ticks = self.timeline.read(self._now_ns - TICKS_NS, frozenset(("tick",)))
        for recorded in ticks.until(self._now_ns):
            self._add_tick(recorded)

    def _read_on(self) -> Reading:
        """Return a reading of the messages after this time.

        It contains ticks only if a vehicle is followed, and poses only if the fleet has persons.
        """
        topics = _FOLDED
        if self.fleet.people:
            topics |= {"poses"}
        if self.tick_stream.vehicle is not None:
            topics |= {"tick"}
        return self.timeline.read(self._now_ns, topics)

    def _steps(self, until_ns: int) -> Iterator[None]:
        """Replay up to ``until_ns``; yield after every step."""
        while self._now_ns < until_ns:
            next_step_ns = (self._now_ns // STEP_NS + 1) * STEP_NS
            now_ns = min(until_ns, next_step_ns)
            self._state = self._folded(list(self._reading.until(now_ns)))
            self._now_ns = now_ns

            newest_kept_ns, _ = self._keyframes[-1]
            is_due = now_ns - newest_kept_ns >= KEYFRAME_NS
            if is_due and len(self._keyframes) < MAX_KEYFRAMES:
                self._keyframes.append((now_ns, self._state))

            for listener in self._listeners:
                listener(self._state, now_ns)
            yield

    def _folded(self, messages: list[RecordedMessage]) -> FleetState:
        """Return the state after these messages.

        Consecutive messages of the same topic are folded together, which is faster.
        """
        state = self._state
        for topic, group in itertools.groupby(messages, key=lambda recorded: recorded.topic):
            same_topic = list(group)
            if topic == "truth":
                state = _fold_truths(state, same_topic)
            elif topic == "tick":
                for recorded in same_topic:
                    self._add_tick(recorded)
            else:
                state = _fold(state, same_topic)
        return state

    def _add_tick(self, recorded: RecordedMessage) -> None:
        """Add a tick to the tick stream if it is of the vehicle that is followed."""
        tick = recorded.message
        if isinstance(tick, TickSample) and recorded.name == self.tick_stream.vehicle:
            self.tick_stream.values.append(tick)


def _fold_truths(state: FleetState, messages: list[RecordedMessage]) -> FleetState:
    """Return the state after messages of truth; those with the same stamp are folded together."""
    for stamp_ns, moment in itertools.groupby(messages, key=lambda recorded: recorded.stamp_ns):
        truths = [recorded.message for recorded in moment if isinstance(recorded.message, Truth)]
        state = fleet_state.fold_truths(state, truths, stamp_ns)
    return state


def _fold(state: FleetState, messages: list[RecordedMessage]) -> FleetState:
    """Return the state after messages of vehicles; a vehicle that sends counts as alive."""
    telemetry = [
        (recorded.message, recorded.stamp_ns)
        for recorded in messages
        if isinstance(recorded.message, Telemetry)
    ]
    state = fleet_state.fold_telemetry(state, telemetry)

    for recorded in messages:
        if not isinstance(recorded.message, Telemetry):
            state = fleet_state.fold(state, recorded.message, recorded.stamp_ns)
        view = state.vehicles.get(recorded.name)
        if view is not None and not view.is_alive:
            alive = fleet_state.NodeSeen(recorded.name, is_alive=True)
            state = fleet_state.fold_nodes(state, [alive])
    return state


def open_flight(folder: Path, fleet_path: str | None = None) -> tuple[FleetConfig, Timeline]:
    """Open a record and its fleet file.

    Args:
        folder: flight folder, or the MCAP file of one.
        fleet_path: fleet file; None for the one beside the record.

    Returns:
        Fleet file and record.

    Raises:
        ConfigError: there is no record, or no fleet file that can be read.
    """
    timeline = Timeline(folder)
    beside = timeline.path.parent / "fleet.toml"
    if fleet_path is None and not beside.is_file():
        timeline.close()
        raise ConfigError(
            f"{timeline.path}: there is no fleet.toml beside it. Give the fleet file with --fleet."
        )

    # A record may come from anybody, so code that its fleet file names (a law) is not run.
    try:
        fleet = load_fleet(fleet_path or beside, needs_folders=False)
    except ConfigError as error:
        timeline.close()
        if fleet_path is not None:
            raise
        raise ConfigError(f"{error} Or give another fleet file with --fleet.") from None
    return fleet, timeline


async def story(replay: Replay, *, is_json: bool) -> str:
    """Return the events of the whole record, and its figures, as text.

    Args:
        replay: a replay of the record, which is played to its end.
        is_json: whether the text is one JSON object instead of lines for people.

    Returns:
        The text.
    """
    await replay.seek(replay.length_s)
    if is_json:
        summary = _summary(replay)
        return msgspec.json.format(msgspec.json.encode(summary), indent=2).decode()
    return "\n".join(_summary_lines(replay))


def _summary(replay: Replay) -> dict[str, Any]:
    """Return the result of a replay as data for programs."""
    timeline = replay.timeline
    state = replay.state

    smallest = None
    pair = state.smallest_known
    if pair is not None:
        smallest = {
            "pair": [pair.first, pair.second],
            "distance_m": pair.distance_m,
            "is_truth": pair.is_truth,
        }

    events = []
    for stamp_ns, event in timeline.events:
        at_s = (stamp_ns - timeline.begin_ns) * 1e-9
        events.append({"at_s": round(at_s, 3), **as_mapping(event)})

    return {
        "record": str(timeline.path),
        "length_s": round(timeline.length_s, 3),
        "is_whole": not timeline.broken,
        "note": " ".join(timeline.notes),
        "vehicles": _vehicles_with_telemetry(state),
        "smallest": smallest,
        "malformed": timeline.malformed + state.malformed,
        "events": events,
    }


def _summary_lines(replay: Replay) -> list[str]:
    """Return the result of a replay as lines: its events, the closest pair, and its length."""
    timeline = replay.timeline
    state = replay.state

    lines = []
    for stamp_ns, event in timeline.events:
        if event.severity != "debug":
            at_s = (stamp_ns - timeline.begin_ns) * 1e-9
            lines.append(f"{at_s:8.1f} s  {plain(event_line(event), 400)}")

    pair = state.smallest_known
    if pair is not None:
        source = "ground truth" if pair.is_truth else "telemetry"
        names = f"{pair.first} and {pair.second}"
        lines.append(f"Closest: {names}, {pair.distance_m:.2f} m, by {source}.")

    count = len(_vehicles_with_telemetry(state))
    lines.append(f"{timeline.length_s:.1f} s of {count} vehicles in {timeline.path}.")
    lines += timeline.notes
    if timeline.malformed:
        lines.append(undecoded_words(timeline.malformed))
    return lines


def _vehicles_with_telemetry(state: FleetState) -> list[str]:
    return [name for name, view in state.vehicles.items() if view.telemetry is not None]
