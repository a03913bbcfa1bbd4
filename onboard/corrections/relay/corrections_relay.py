"""``covey corrections``: one process that reads the source and publishes its frames on the bus.

Each frame is sent once over each link. Bytes that do not form a frame, and frames with a wrong
checksum, are counted and dropped. A source that ends is reopened, after a pause that grows each
time. After a refusal, a source is reopened only once a minute, because casters block clients that
retry too often.
"""

from __future__ import annotations

import asyncio
import math
import secrets
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing
from typing import NamedTuple

from onboard.bus.clock_sync import BEAT_S, ClockNode
from onboard.bus.codec import Malformed
from onboard.bus.protocol import Bus
from onboard.bus.schema import Corrections, Message, Telemetry
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.corrections import rtcm
from onboard.corrections.base_watch import BaseWatch
from onboard.corrections.fragments import MAX_BYTES
from onboard.corrections.relay.framing import FrameCutter
from onboard.corrections.relay.source_error import SourceError
from onboard.corrections.relay.sources import words_of
from onboard.exit_status import EXIT_FAILED, EXIT_NO_ANSWER, EXIT_OK
from onboard.plain_text import plain_line
from onboard.security.credentials import credentials_of
from onboard.security.node_roles import NodeRole

NODE = NodeRole.CORRECTIONS.value
NAME = "base"  # last part of the key under which frames are published

MAX_BYTES_S = 6000.0  # greatest rate of the published frames; a base sends 1 kB each second
_FIRST_PAUSE_S = 1.0  # pause before a source that has ended is reopened for the first time
_LONGEST_PAUSE_S = 30.0  # limit of this growing pause
_REFUSED_PAUSE_S = 60.0  # pause before a source is reopened after a refusal
_TELEMETRY_S = 3.0  # a vehicle's fix is shown from telemetry up to this age

OpenSource = Callable[[], AsyncIterator[bytes]]


class _Damage(NamedTuple):
    """Counts of bytes and frames that were not passed on."""

    bad_checksums: int = 0
    skipped_bytes: int = 0
    dropped_frames: int = 0


class CorrectionsRelay:
    """One run of the node.

    Args:
        fleet: the fleet file, with a table of corrections.
        open_source: opens the source again.
        say: prints a line for a person.
        publishes: whether it publishes the frames; otherwise it reads the source without a bus.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        open_source: OpenSource,
        say: Callable[[str], None],
        *,
        publishes: bool = True,
    ) -> None:
        corrections = fleet.corrections
        assert corrections is not None
        self.fleet = fleet
        self._corrections = corrections
        self._open_source = open_source
        self._say = say

        self._bus: Bus | None = None
        if publishes:
            self._bus = BusSession(
                namespace=fleet.namespace,
                node=NODE,
                connect=[fleet.vehicles[name].agent for name in fleet.enabled_names],
                credentials=credentials_of(fleet, NODE),
                routers=fleet.fleet.routers,
            )

        self.publisher = FramePublisher(self._bus)
        self._watch = BaseWatch(corrections)
        self._cutter = FrameCutter()
        self._problem = ""  # last printed problem of the source; empty after a frame
        self._has_frame = False  # at least one frame has arrived
        self._observed_s = -math.inf  # arrival of the newest observations

        # message number -> count of such messages since the last report
        self._counts: Counter[int] = Counter()
        self._reported = _Damage()  # counts at the last report
        self._too_long_bytes = 0  # length of the newest frame that is too long for PX4; 0: none
        # vehicle -> its newest telemetry, and the arrival of this telemetry
        self._vehicles: dict[str, tuple[Telemetry, float]] = {}

    async def run(self, *, seconds: float | None, every_s: float, stopped: asyncio.Event) -> int:
        """Run until ``stopped`` is set or ``seconds`` have passed; return the exit status.

        Raises:
            BusError: no router answers.
            ConfigError: the fleet file describes a source that cannot be opened.
        """
        if self._bus is not None:
            self._bus.start()
        reading = asyncio.create_task(self._read())
        beating = asyncio.create_task(self._beat())

        try:
            self._say(
                f"corrections: {words_of(self._corrections)} -> bus "
                f"{self.fleet.namespace}/{Topic.CORRECTIONS.value}/{NAME}. Ctrl-C ends."
            )
            await self._report_until(reading, seconds=seconds, every_s=every_s, stopped=stopped)
        finally:
            for task in (reading, beating):
                task.cancel()
            await asyncio.gather(reading, beating, return_exceptions=True)
            if self._bus is not None:
                self._bus.stop()

        if not self._has_frame:
            return EXIT_NO_ANSWER
        if seconds is None or self._is_complete():
            return EXIT_OK
        return EXIT_FAILED

    def _is_complete(self) -> bool:
        """Whether the base is known and trusted, and new observations arrive."""
        age_s = time.monotonic() - self._observed_s
        is_trusted = self._watch.base is not None and self._watch.judgement.fault is None
        return is_trusted and age_s <= self._corrections.max_age_s

    # -- in ----------------------------------------------------------------------------------------

    async def _read(self) -> None:
        """Read the source, and open it again when it ends."""
        pause_s = _FIRST_PAUSE_S
        while True:
            try:
                async with aclosing(self._open_source()) as source:  # type: ignore[type-var]
                    async for data in source:
                        if self._take(data):
                            pause_s = _FIRST_PAUSE_S
                            self._problem = ""
            except SourceError as error:
                self._print_problem(str(error))
                if error.is_refusal:
                    pause_s = _REFUSED_PAUSE_S

            self._cutter = self._fresh_cutter()
            await asyncio.sleep(pause_s)
            if pause_s < _LONGEST_PAUSE_S:  # the longer pause after a refusal stays the same
                pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)

    def _fresh_cutter(self) -> FrameCutter:
        """Return a cutter for the next connection, which keeps the counts of the present one."""
        cutter = FrameCutter()
        cutter.bad_checksums = self._cutter.bad_checksums
        cutter.skipped_bytes = self._cutter.skipped_bytes
        return cutter

    def _print_problem(self, sentence: str) -> None:
        """Print a problem of the source, unless the same problem was printed last."""
        if sentence != self._problem:
            self._problem = sentence
            self._say(f"  ! {plain_line(sentence)} It is tried again.")

    def _take(self, data: bytes) -> bool:
        """Publish the frames that these bytes complete; return whether there were any."""
        now_ns = time.monotonic_ns()
        frames = self._cutter.feed(data)
        for frame in frames:
            self._note_frame(frame, now_ns)
            self.publisher.publish(frame, now_ns)
        return bool(frames)

    def _note_frame(self, frame: bytes, now_ns: int) -> None:
        """Remember the values from a frame that the next report needs."""
        self._has_frame = True
        number = rtcm.number_of(frame)
        self._counts[number] += 1

        if rtcm.is_observation(number):
            self._observed_s = now_ns * 1e-9
        if rtcm.is_for_receivers(number) and len(frame) > MAX_BYTES:
            self._too_long_bytes = len(frame)

        position = rtcm.base_of(frame)
        if position is not None:
            # As for a vehicle on the ground, the base may move at any time. The report then shows
            # its new position.
            self._watch.hear(position, now_ns, is_on_ground=True)

    async def _beat(self) -> None:
        """Publish the clock, and receive the vehicles' telemetry, which contains their fixes."""
        if self._bus is None:
            return
        self._bus.collect(Topic.SLOW_TELEMETRY, "*", self._telemetry_received)

        clock = ClockNode(self._bus)
        clock.start()
        while True:
            clock.beat()
            self._bus.deliver()
            await asyncio.sleep(BEAT_S)

    def _telemetry_received(self, _topic: Topic, name: str, message: Message | Malformed) -> None:
        if isinstance(message, Telemetry) and message.vehicle == name:
            self._vehicles[name] = (message, time.monotonic())

    # -- out ---------------------------------------------------------------------------------------

    async def _report_until(
        self,
        reading: asyncio.Task[None],
        *,
        seconds: float | None,
        every_s: float,
        stopped: asyncio.Event,
    ) -> None:
        """Print reports until ``stopped`` is set or ``seconds`` have passed.

        Raises:
            ConfigError: the fleet file describes a source that cannot be opened.
        """
        began_s = time.monotonic()
        reported_s = began_s
        while True:
            wait_s = every_s
            if seconds is not None:
                wait_s = min(every_s, began_s + seconds - time.monotonic())

            stopping = asyncio.create_task(stopped.wait())
            done, _ = await asyncio.wait(
                (stopping, reading),
                timeout=max(0.0, wait_s),
                return_when=asyncio.FIRST_COMPLETED,
            )
            stopping.cancel()

            # the reading task ends only with an error, which is raised here
            if reading in done:
                reading.result()
            if stopping in done:
                return

            now_s = time.monotonic()
            for line in self.report(now_s - reported_s):
                self._say(line)
            reported_s = now_s
            if seconds is not None and now_s - began_s >= seconds:
                return

    def report(self, period_s: float) -> list[str]:
        """Return the lines of a report.

        Args:
            period_s: time since the last report.
        """
        count = sum(self._counts.values())
        kinds = "none"
        if self._counts:
            kinds = " ".join(str(number) for number in sorted(self._counts))
        self._counts.clear()
        lines = [
            f"{time.strftime('%H:%M:%S')} {self._base_words()}; {count / period_s:.1f} messages/s "
            f"({kinds})"
        ]

        judgement = self._watch.judgement
        if judgement.fault is not None:
            lines.append(
                f"  ! The base {judgement.words}: no vehicle gives its corrections to PX4."
            )
        if self._too_long_bytes:
            lines.append(
                f"  ! A message has {self._too_long_bytes} bytes, and {MAX_BYTES} fit into four "
                "fragments of MAVLink: no vehicle gives it to PX4. Let the base send MSM4 instead "
                "of MSM7, or fewer systems."
            )
            self._too_long_bytes = 0
        lines += self._damage_words()

        now_s = time.monotonic()
        for name, (telemetry, heard_s) in sorted(self._vehicles.items()):
            if now_s - heard_s < _TELEMETRY_S:
                lines.append(f"  {name}: {_fix_words(telemetry)}")
        return lines

    def _base_words(self) -> str:
        """Return station and position of the base, or why they are not known."""
        base = self._watch.base
        if not self._has_frame:
            return "no frame has come yet"
        if base is None:
            return "the base has not said where it is (1005 or 1006)"
        latitude_deg, longitude_deg, height_m = base.latitude_longitude_height
        return (
            f"base {base.station} at {latitude_deg:.7f}, {longitude_deg:.7f}, {height_m:.2f} m "
            "above the ellipsoid"
        )

    def _damage_words(self) -> list[str]:
        """Return lines about bytes and frames that were not passed on since the last report."""
        before = self._reported
        bad = self._cutter.bad_checksums - before.bad_checksums
        skipped = self._cutter.skipped_bytes - before.skipped_bytes
        dropped = self.publisher.dropped - before.dropped_frames
        self._reported = _Damage(
            bad_checksums=self._cutter.bad_checksums,
            skipped_bytes=self._cutter.skipped_bytes,
            dropped_frames=self.publisher.dropped,
        )

        lines: list[str] = []
        if bad or skipped:
            lines.append(
                f"  ! {bad} frames with a wrong checksum, {skipped} bytes of no frame: not passed "
                "on. Is the cable good, and is it RTCM 3?"
            )
        if dropped:
            lines.append(
                f"  ! {dropped} frames more than {MAX_BYTES_S / 1000:g} kB/s: not passed on. Let "
                "the base send fewer."
            )
        return lines


class FramePublisher:
    """Publishes frames, at no more than a greatest rate.

    Args:
        bus: an open node; with None nothing is published.
    """

    def __init__(self, bus: Bus | None) -> None:
        self.dropped = 0  # frames that exceeded the rate
        self._bus = bus
        self._boot_id = secrets.randbits(31)
        self._sequence = 0
        # Number of bytes that may be sent now. Frames reduce it, and within a second without frames
        # it grows to its maximum.
        self._room_bytes = MAX_BYTES_S
        self._last_ns: int | None = None  # arrival of the last frame

    def publish(self, frame: bytes, now_ns: int) -> None:
        """Publish a frame, unless too much has been published lately; never blocks.

        Args:
            frame: whole frame with a correct checksum.
            now_ns: this computer's monotonic clock.
        """
        since_s = 0.0
        if self._last_ns is not None:
            since_s = (now_ns - self._last_ns) * 1e-9
        self._last_ns = now_ns

        self._room_bytes = min(MAX_BYTES_S, self._room_bytes + MAX_BYTES_S * since_s)
        if len(frame) > self._room_bytes:
            self.dropped += 1
            return
        self._room_bytes -= len(frame)

        if self._bus is None:
            return
        self._sequence += 1
        message = Corrections(
            source=self._bus.node,
            boot_id=self._boot_id,
            sequence=self._sequence,
            stamp_ns=now_ns,
            frame=frame,
        )
        self._bus.publish(Topic.CORRECTIONS, NAME, message)


def _fix_words(telemetry: Telemetry) -> str:
    """Return a vehicle's fix and its corrections for the report."""
    fix = plain_line(telemetry.fix)
    if not fix:
        fix = "no fix reported"
    words = [fix]
    if telemetry.satellites >= 0:
        words.append(f"{telemetry.satellites} satellites")
    if math.isfinite(telemetry.corrections_age_s):
        words.append(f"corrections {telemetry.corrections_age_s:.1f} s old")
    if math.isfinite(telemetry.base_distance_m):
        words.append(f"{telemetry.base_distance_m / 1000:.2f} km from the base")
    return ", ".join(words)


def relay_problem(fleet: FleetConfig) -> ConfigError | None:
    """Return a sentence about a fleet file without corrections; None if it has corrections."""
    if fleet.corrections is not None:
        return None
    return ConfigError(
        f"{fleet.path} has no table [corrections]: nothing says where they come from. Add it: "
        "docs/corrections.md."
    )
