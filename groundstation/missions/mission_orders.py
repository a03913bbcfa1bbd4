"""Written orders about missions: start one, step through it, end it.

An operator types them alongside the orders to vehicles, in the console or on the live page. Both
use :class:`MissionOrders`.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Sequence
from typing import NamedTuple, Protocol

from msgspec.structs import replace

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.mission_files.expected_course import expected_duration_s
from groundstation.mission_files.loading import load_mission, mission_from_mapping
from groundstation.mission_files.mission_findings import refuse_unflyable
from groundstation.mission_files.names import mission_names
from groundstation.mission_files.wall_time import WallTime, local_now, time_words, wall_time
from groundstation.missions.beginning import begin_refusal, without_unused_slots
from groundstation.missions.countdown import clock_problem, clock_words
from groundstation.missions.mission_words import USAGE
from groundstation.missions.python_check import check_python
from groundstation.missions.runner import MissionRun
from groundstation.orders.intents import Takeoff
from groundstation.orders.kill_latch import KillLatch
from groundstation.verdict.verdict import Verdict
from onboard.config.fleet import ConfigError
from onboard.plain_text import listed

_ONLY_WATCHES = "This ground only watches: open one that may order."
_FLIES_ALREADY = "A mission flies already. Write: stop"
# Order to the vehicles that somebody may mean by a word for a mission, when no mission flies.
_OF_VEHICLES = {"pause": "pause all", "skip": "skip all", "stop": "hold all, or land all"}
_MAX_NAMED = 12  # mission files that a sentence names
_MAX_PROBLEMS = 2  # clock problems that the question before a countdown names
_READY_S = 10.0  # longest wait until all vehicles are ready
_WATCH_S = 0.2  # time between two checks for silent vehicles

MissionJudge = Callable[[MissionRun], Awaitable[Verdict]]
MissionCall = Callable[[], Awaitable[object]]  # flies a mission, and returns its verdict


class CountdownQuestion(NamedTuple):
    """Title, lines and refusals of the question before a countdown, as they are now."""

    title: str
    lines: Sequence[str]
    reasons: Sequence[str]  # why the countdown may not begin


# Shows the question that the first function returns; calls the second when the operator says yes.
Ask = Callable[[Callable[[], CountdownQuestion], Callable[[], None]], None]


class WatchingClient(Protocol):
    """The part of a ground's end of the bus that is needed before a mission may be flown."""

    @property
    def state(self) -> FleetState:
        """The fleet as known now."""


class MissionOrders:
    """Takes written orders about missions.

    Args:
        client: client of the fleet; only one that may order flies missions.
        begin: function that flies a mission in a worker. Its arguments are the function that flies
            the mission, and the function that returns the mission's line for the title. It returns
            False if a mission flies already.
        judge: function that judges an ended mission by the record of the flight; None if there is
            no record.
        run: the mission that the console was started with, if any.
        ask: function that shows the question before a countdown; None: it begins at once.
        latch: vehicles that were killed from here; no mission begins with them. None: no vehicle
            was killed.
    """

    def __init__(
        self,
        client: WatchingClient,
        begin: Callable[[MissionCall, Callable[[], str]], bool],
        judge: MissionJudge | None = None,
        run: MissionRun | None = None,
        ask: Ask | None = None,
        latch: KillLatch | None = None,
    ) -> None:
        self._client = client
        self._begin = begin
        self._judge = judge
        self._run = run
        self._ask = ask
        self._latch = latch or KillLatch()
        self._line = ""  # last line of the mission

    def take(self, words: Sequence[str]) -> str:
        """Carry out an order.

        Args:
            words: words of the line.

        Returns:
            Why the order is refused, as a sentence; empty when it is carried out.
        """
        verb, *further_words = words
        if verb == "mission":
            return self._start(further_words)

        run = self._run
        if run is None or run.is_over:
            no_mission = "No mission flies that was started here."
            if verb in _OF_VEHICLES:
                return f"{no_mission} For the vehicles write: {_OF_VEHICLES[verb]}."
            return f"{no_mission} Write: {USAGE}"

        ground = run.fleet.ground
        if verb == "stop":
            run.interrupt()
        elif verb == "pause":
            ground.pause()
        elif verb == "skip":
            return ground.leave_out_order()
        else:  # "continue" and "step"
            ground.go_on(is_stepping=verb == "step")
        return ""

    def _start(self, words: Sequence[str]) -> str:
        """Start a mission; return why it is refused, or an empty string."""
        client = self._client
        if not isinstance(client, FleetClient):
            return _ONLY_WATCHES
        refusal = client.control.refusal("takeoff")
        if refusal is not None:
            return refusal

        words, written_time = _without_time(words)
        if written_time is None:
            return f"At which time? Write: {USAGE}"
        files = [word for word in words if "=" not in word and word != "stepping"]
        if len(files) != 1:
            return f"Which mission? {_names_sentence()} Write: {USAGE}"
        (file,) = files
        arguments = dict(word.split("=", 1) for word in words if "=" in word)

        try:
            mission = load_mission(file, client.fleet_file)
            if arguments and not mission.is_python:
                return f"{file}: only Python missions have arguments."
            mission = replace(mission, arguments=arguments)
            if mission.is_python:
                check_python(mission)
            # The checks are about the vehicles that take part now. The mission itself keeps all
            # vehicles: when it flies, it leaves out those that are out of service then.
            flown_now = without_unused_slots(mission, client.state)
            refuse_unflyable(flown_now, client.state.is_simulated)
            refusal = begin_refusal(mission, client.state)
            if refusal:
                return refusal

            at = None
            if written_time:
                at = wall_time(written_time, local_now(client.wall_clock.wall_ns))
        except ConfigError as error:
            return str(error)

        run = MissionRun(mission, client, say=self._say, ready_timeout_s=_READY_S, at=at)
        if "stepping" in words:
            run.fleet.ground.go_on(is_stepping=True)

        latched = self._latch.refusal(run.fleet.names)
        if latched:
            return latched
        if at is None or self._ask is None:
            return self._begin_run(run)
        self._ask(lambda: self._question(run, at), lambda: self._begin_asked(run))
        return ""

    def _question(self, run: MissionRun, at: WallTime) -> CountdownQuestion:
        """Return the question before a countdown, with this ground's own reasons against it.

        These are another mission that flies, and vehicles that were killed and not reset.

        Args:
            run: run of the mission, which has not begun.
            at: time at which it begins.
        """
        question = countdown_question(run, at)
        reasons = list(question.reasons)
        latched = self._latch.refusal(run.fleet.names)
        if latched:
            reasons.insert(0, latched)
        if self.is_flying:
            reasons.insert(0, _FLIES_ALREADY)
        return question._replace(reasons=reasons)

    def take_off_in_waves(self, intent: Takeoff) -> str:
        """Fly a take-off in waves as a mission of one step; if a vehicle fails, the others hold.

        Args:
            intent: order as it was shown.

        Returns:
            Why the order is refused, as a sentence; empty when it is carried out.
        """
        client = self._client
        if not isinstance(client, FleetClient):
            return _ONLY_WATCHES
        step = {
            "do": "takeoff",
            "vehicles": list(intent.names),
            "height_m": intent.height_m,
            "by": intent.by,
            "every_s": intent.every_s,
        }
        content = {"schema": 1, "step": [step], "expect": {"all_landed": False}}
        content["on_failure"] = {"do": "hold"}
        try:
            mission = mission_from_mapping(content, path="takeoff", fleet=client.fleet_file)
        except ConfigError as error:
            return str(error)
        return self._begin_run(MissionRun(mission, client, say=self._say, ready_timeout_s=_READY_S))

    def _begin_run(self, run: MissionRun) -> str:
        """Fly a mission; return why it is refused, or an empty string."""
        if not self._begin(lambda: self._fly(run), lambda: self._line_of(run)):
            return _FLIES_ALREADY
        self._run = run
        return ""

    def _begin_asked(self, run: MissionRun) -> None:
        refusal = self._begin_run(run)
        if refusal:
            self._say(refusal)

    def _line_of(self, run: MissionRun) -> str:
        return run.fleet.ground.title_line or self._line

    @property
    def is_flying(self) -> bool:
        """Whether a mission that was started here flies now."""
        return self._run is not None and not self._run.is_over

    @property
    def live_line(self) -> str:
        """Short text about the present mission; empty when none flies."""
        if self._run is None or not self.is_flying:
            return ""
        for line in (self._run.fleet.ground.live_line, self._line):
            if line:
                return line
        return "mission flies"

    @property
    def counts_down(self) -> bool:
        """Whether a countdown is under way."""
        if self._run is None or not self.is_flying:
            return False
        return self._run.fleet.ground.countdown is not None

    def stop_countdown(self) -> str:
        """End the countdown of the mission; return a sentence about what has happened."""
        is_stopped = False
        if self._run is not None and self.is_flying:
            is_stopped = self._run.fleet.ground.stop_countdown()
        if is_stopped:
            return "The countdown ends: nothing is started."
        return "No countdown of a mission that was started here is under way."

    async def _fly(self, run: MissionRun) -> Verdict:
        watch = asyncio.create_task(_watched(run))
        try:
            verdict = await run.run()
        finally:
            watch.cancel()

        if self._judge is None:
            return verdict
        return await self._judge(run)

    def _say(self, line: str) -> None:
        self._line = line.strip()
        if isinstance(self._client, FleetClient):
            self._client.publish_event("info", "mission", self._line)


def _without_time(words: Sequence[str]) -> tuple[list[str], str | None]:
    """Return the words without "at TIME", and the time.

    The time is empty when the words have no "at". It is None when nothing follows "at".
    """
    if "at" not in words:
        return list(words), ""

    index = list(words).index("at")
    other_words = [*words[:index], *words[index + 2 :]]
    if index + 1 == len(words):
        return other_words, None
    return other_words, words[index + 1]


def countdown_question(run: MissionRun, at: WallTime) -> CountdownQuestion:
    """Return the present content of the question before a countdown.

    Args:
        run: run of the mission, which has not begun.
        at: time at which it begins.
    """
    client = run.client
    names = run.fleet.names
    left_s = (at.wall_ns - client.wall_clock.wall_ns) * 1e-9
    lines = [f"Begins in {time_words(max(0.0, left_s))}, when all are still ready."]

    steps = list(run.mission.course())
    if steps:
        takes_s = expected_duration_s(steps)
        lines.append(f"Takes about {time_words(takes_s)}, in {len(run.mission.steps)} steps.")
    if not client.wall_clock.is_simulated:
        lines.append(clock_words(client.wall_clock, names))

    charges = {}
    for name in names:
        telemetry = client.state.vehicles[name].telemetry
        if telemetry is not None and math.isfinite(telemetry.battery_frac):
            charges[name] = telemetry.battery_frac
    if charges:
        weakest = min(charges, key=lambda name: charges[name])
        lines.append(f"The weakest battery is {weakest}'s, with {100 * charges[weakest]:.0f} %.")

    reasons = []
    if left_s <= 0.0:
        reasons.append(f"{at.words} has passed.")
    if not client.wall_clock.is_simulated:
        problems = [clock_problem(client.wall_clock, name) for name in names]
        reasons += [problem for problem in problems if problem][:_MAX_PROBLEMS]
    return CountdownQuestion(f"{run.mission.name} at {at.words}", lines, reasons)


def _names_sentence() -> str:
    return f"There are {listed(mission_names(), _MAX_NAMED)}; tab completes a name."


async def _watched(run: MissionRun) -> None:
    """Look for silent vehicles until the mission is over."""
    while not run.check():  # noqa: ASYNC110 - no event reports a silence
        await asyncio.sleep(_WATCH_S)
