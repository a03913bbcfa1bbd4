"""The countdown to a start at a wall-clock time.

The instant of the start is fixed on the monotonic clock when the countdown begins. From then on
all clocks are checked five times a second. The countdown ends without a start when

* an operator stops it,
* this computer's clock is set, because it is then unknown which of the two times was right,
* a vehicle's computer has a different time from this one, or does not report its time. One of the
  two clocks is wrong, perhaps this computer's.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

from groundstation.client.wall_clock import WallClock
from groundstation.mission_files.wall_time import WallTime, local_now, time_words
from onboard.plain_text import listed

APART_S = 0.5  # largest permitted difference between the clocks of two computers
# The wall clock of this computer was set if it has changed by more than this against the monotonic
# clock.
STEP_S = 0.1
LOOK_S = 0.2  # period of the checks
# Number of checks in a row that must find the clock set. A single check may be interrupted between
# its two readings.
_STEP_LOOK_COUNT = 2
# Number of checks in a row that must find the clocks of two computers different. Computers report
# their time twice a second, so this covers two reports.
_APART_LOOK_COUNT = 7
_MEASURE_S = 3.0  # time after the connection within which the clocks are measured
# Times before the start at which a line says how long the countdown still takes.
_SAID_S = (3600.0, 1800.0, 600.0, 300.0, 60.0, 30.0, 10.0, 5.0)
_MAX_NAMED = 6  # vehicles that a sentence names one by one


class CountdownEnded(RuntimeError):
    """A countdown has ended without a start."""


class Countdown:
    """One countdown; call :meth:`problem` several times a second.

    Args:
        clock: the clocks.
        at: time of the start.
        names: vehicles whose computers must have the same time.
    """

    def __init__(self, clock: WallClock, at: WallTime, names: Sequence[str]) -> None:
        self.at = at
        self._clock = clock
        self._names = tuple(names)
        self._offset_ns = clock.offset_ns()  # wall clock minus monotonic clock, at the start
        self._begin_ns = clock.now_ns
        self._ended = ""  # reason for an end without a start, as a sentence
        self._steps_seen = 0  # checks in a row that saw this computer's clock set
        self._apart_seen: dict[str, int] = {}  # vehicle -> checks in a row that saw another time
        self._agreed: set[str] = set()  # vehicles whose computers had the same time once

    @property
    def start_ns(self) -> int:
        """The start on the ground's monotonic clock [ns]."""
        return self.at.wall_ns - self._offset_ns

    @property
    def left_s(self) -> float:
        """Time until the start [s]."""
        return (self.start_ns - self._clock.now_ns) * 1e-9

    @property
    def line(self) -> str:
        """The countdown in a few words, for the title."""
        minutes, seconds = divmod(max(0, round(self.left_s)), 60)
        hours, minutes = divmod(minutes, 60)
        return f"starts at {self.at.words}, in {hours}:{minutes:02}:{seconds:02}"

    def stop(self, sentence: str) -> None:
        """End the countdown without starting.

        Args:
            sentence: the reason.
        """
        if not self._ended:
            self._ended = sentence

    def problem(self) -> str:
        """Check all clocks.

        Returns:
            Why the countdown has ended, as a sentence; empty while it goes on.
        """
        if not self._ended:
            self._ended = self._step_problem()
        if not self._ended:
            self._ended = self._other_times_problem()
        return self._ended

    def last_problem(self) -> str:
        """Check all clocks at the start.

        By now, the clock of each vehicle must have agreed with this computer's at least once.

        Returns:
            Why nothing may start, as a sentence; empty if the start may begin.
        """
        ended = self.problem()
        if ended:
            return ended
        for name in self._names:
            if name not in self._agreed:
                return clock_problem(self._clock, name)
        return ""

    def _step_problem(self) -> str:
        """Check whether this computer's clock was set; return a sentence if it was."""
        step_s = (self._clock.offset_ns() - self._offset_ns) * 1e-9
        if abs(step_s) <= STEP_S:
            self._steps_seen = 0
            return ""

        self._steps_seen += 1
        if self._steps_seen < _STEP_LOOK_COUNT:
            return ""
        forwards = "forwards" if step_s > 0.0 else "back"
        return (
            f"This computer's clock was set {time_words(abs(step_s))} {forwards} during the "
            "countdown: which time was right is not known. Look at its time server, and order "
            "the start again."
        )

    def _other_times_problem(self) -> str:
        """Compare the vehicles' clocks with this computer's; return a sentence if one differs."""
        since_begin_s = (self._clock.now_ns - self._begin_ns) * 1e-9
        for name in self._names:
            problem = clock_problem(self._clock, name)
            if not problem:
                self._agreed.add(name)
                self._apart_seen.pop(name, None)
                continue

            self._apart_seen[name] = self._apart_seen.get(name, 0) + 1
            is_measured = name in self._agreed or since_begin_s > _MEASURE_S
            if is_measured and self._apart_seen[name] >= _APART_LOOK_COUNT:
                return problem
        return ""


async def count_down(
    countdown: Countdown, say: Callable[[str], None], *, until_s: float = 0.0
) -> None:
    """Wait until a start, and check the clocks meanwhile.

    Args:
        countdown: countdown that has begun.
        say: function that receives each line of progress.
        until_s: time before the start at which the wait ends [s].

    Raises:
        CountdownEnded: nothing is to be started.
    """
    left_before_s = countdown.left_s  # time until the start at the check before
    while True:
        ended = countdown.problem()
        if ended:
            raise CountdownEnded(ended)

        left_s = countdown.left_s
        for mark_s in _SAID_S:
            if left_s <= mark_s < left_before_s:
                say(f"  {time_words(mark_s)} until the start at {countdown.at.words}")
        left_before_s = left_s

        if left_s <= until_s:
            break
        await asyncio.sleep(min(LOOK_S, left_s - until_s))

    ended = countdown.last_problem()
    if ended:
        raise CountdownEnded(ended)


def clock_problem(clock: WallClock, vehicle: str) -> str:
    """Return why a vehicle's clock forbids a start at a wall-clock time.

    The reason is a sentence; it is empty if the clock agrees.

    Args:
        clock: the clocks.
        vehicle: vehicle whose computer is compared with this one.
    """
    compared = clock.ahead_s(vehicle)
    if compared is None:
        return (
            f"{vehicle}'s computer does not tell what time it has, or its clock is not measured "
            "yet: start its agent with this version of Covey, or wait a few seconds."
        )

    ahead_s, error_s = compared
    if abs(ahead_s) + error_s <= APART_S:
        return ""
    if abs(ahead_s) <= APART_S:
        return (
            f"The clock of {vehicle}'s computer is known to {time_words(error_s)} only; at most "
            f"{APART_S:g} s is right. Look for a slow or busy network to it."
        )
    side = "ahead of" if ahead_s > 0.0 else "behind"
    return (
        f"{vehicle}'s computer is {time_words(abs(ahead_s))} {side} this one, which has "
        f"{local_now(clock.wall_ns):%Y-%m-%d %H:%M:%S}; at most {APART_S:g} s is right. Set both "
        "by one time server, and order the start again."
    )


def clock_words(clock: WallClock, names: Sequence[str]) -> str:
    """Return which clocks agree with this computer's, and how well, in sentences.

    Args:
        clock: the clocks.
        names: names of vehicles.
    """
    agreeing: dict[str, float] = {}  # vehicle -> largest possible difference of its clock [s]
    differing = []
    unmeasured = []
    for name in names:
        compared = clock.ahead_s(name)
        if compared is None:
            unmeasured.append(name)
        elif clock_problem(clock, name):
            differing.append(name)
        else:
            ahead_s, error_s = compared
            agreeing[name] = abs(ahead_s) + error_s

    sentences = []
    if agreeing:
        within_s = max(0.001, *agreeing.values())  # the sentence shows milliseconds
        sentences.append(
            f"Same time within {within_s:.3f} s: {listed(list(agreeing), _MAX_NAMED)}."
        )
    if differing:
        sentences.append(f"The clock differs: {listed(differing, _MAX_NAMED)}.")
    if unmeasured:
        names_words = listed(unmeasured, _MAX_NAMED)
        sentences.append(f"The clock is not measured yet, or not reported: {names_words}.")
    return " ".join(sentences)
