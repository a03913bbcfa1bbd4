"""The corrections of one vehicle: from the bus, checked, in fragments to its PX4. Pure.

PX4 does not get a message that is not a frame, is old, comes from a second source, or belongs to an
untrusted base. Without corrections PX4's receiver falls back to a worse fix, which the failsafes
notice. PX4 gets nothing from a base until the base has reported its position.

At each tick, at most one fragment is sent, after the setpoint. This gives up to 9 kB/s. A frame is
sent completely before the next frame starts. The number of waiting frames is bounded; the oldest
are dropped, because a receiver has no use for corrections that are a second late.
"""

from __future__ import annotations

import math
from collections import deque

from msgspec import Struct

from onboard.autopilot import Snapshot
from onboard.bus.schema import Corrections
from onboard.bus.topics import TOPICS, Topic
from onboard.config.corrections import CorrectionsConfig
from onboard.config.earth import Origin, latitude_longitude_deg
from onboard.corrections import rtcm
from onboard.corrections.base_watch import BaseWatch, distance_m
from onboard.corrections.fragments import MAX_BYTES, SEQUENCES, Fragment, fragments_of
from onboard.corrections.status import CorrectionsStatus
from onboard.message_counts import MessageCounts

MAX_WAITING = 24  # frames; the observations of four satellite systems at one moment take six
_STALE_NS = round(1e9 * TOPICS[Topic.CORRECTIONS].stale_after_s)
_FUTURE_NS = 100_000_000  # a stamp may be later than its message's arrival by this
_SOURCE_GONE_NS = 5_000_000_000  # after this silence of the source, another source is accepted
_SEVERAL_NS = 5_000_000_000  # a second source is reported for this time after its newest message
_TOO_LONG_NS = 60_000_000_000  # a frame that is too long is reported for this time


class _Waiting(Struct, frozen=True):
    """A frame that waits for its turn."""

    frame: bytes
    stamp_ns: int


class CorrectionsIntake:
    """Corrections of one vehicle. Call :meth:`hear` for each message and :meth:`due` once a tick.

    Args:
        corrections: table of corrections of the fleet file.
    """

    def __init__(self, corrections: CorrectionsConfig) -> None:
        self.counts = MessageCounts()  # counts of messages that were not sent to PX4
        self._watch = BaseWatch(corrections)

        self._boot_id: int | None = None  # boot id of the source whose messages are accepted
        self._heard_ns = 0  # arrival of the newest message from that source
        self._several_ns: int | None = None  # arrival of the newest message from another source
        self._too_long_bytes = 0  # length of the newest frame that was too long; 0: none
        self._too_long_ns = 0  # arrival of that frame

        self._waiting: deque[_Waiting] = deque()
        self._sending: _Waiting | None = None  # the frame that is partly sent
        self._fragments: deque[Fragment] = deque()  # remaining fragments of that frame
        self._sequence = 0
        self._observed_ns: int | None = None  # stamp of the newest observations sent to PX4

    def hear(self, message: Corrections, received_ns: int, *, is_on_ground: bool) -> None:
        """Check a message of the bus, and queue its frame for PX4.

        Args:
            message: the message, its stamp on our clock.
            received_ns: arrival of the message.
            is_on_ground: whether this vehicle stands on the ground, disarmed.
        """
        frame = message.frame
        if not rtcm.is_frame(frame):
            self.counts.malformed += 1
            return
        if not self._is_of_the_source(message, received_ns):
            self.counts.refused += 1
            return
        if not -_FUTURE_NS <= received_ns - message.stamp_ns <= _STALE_NS:
            self.counts.late += 1
            return
        if not rtcm.is_for_receivers(rtcm.number_of(frame)):
            return  # not counted, because a maker's message for its own receivers is not a fault
        if len(frame) > MAX_BYTES:
            self._too_long_bytes = len(frame)
            self._too_long_ns = received_ns
            self.counts.refused += 1
            return
        if not self._is_of_the_base(frame, received_ns, is_on_ground=is_on_ground):
            self.counts.refused += 1
            return

        if len(self._waiting) == MAX_WAITING:
            self._waiting.popleft()
            self.counts.dropped += 1
        self._waiting.append(_Waiting(frame, message.stamp_ns))

    def _is_of_the_source(self, message: Corrections, received_ns: int) -> bool:
        """Whether a message is from the accepted source.

        If the accepted source has fallen silent, the sender of this message is accepted instead.
        """
        is_silent = received_ns - self._heard_ns > _SOURCE_GONE_NS
        if self._boot_id is None or is_silent:
            self._boot_id = message.boot_id

        if message.boot_id != self._boot_id:
            self._several_ns = received_ns
            return False

        self._heard_ns = received_ns
        return True

    def _is_of_the_base(self, frame: bytes, received_ns: int, *, is_on_ground: bool) -> bool:
        """Whether a frame is from a trusted base."""
        position = rtcm.base_of(frame)
        if position is not None:
            return self._watch.hear(position, received_ns, is_on_ground=is_on_ground)

        base = self._watch.base
        if base is None or self._watch.judgement.fault is not None:
            return False
        station = rtcm.station_of(frame)
        return station is None or station == base.station

    def due(self, now_ns: int) -> Fragment | None:
        """Return the fragment that is to be sent at this tick; None if nothing waits."""
        if not self._fragments:
            self._begin(now_ns)
        if not self._fragments:
            return None

        fragment = self._fragments.popleft()
        is_last_fragment = not self._fragments
        if is_last_fragment and self._sending is not None:
            self._note_sent(self._sending)
            self._sending = None
        return fragment

    def _note_sent(self, sent: _Waiting) -> None:
        """Keep the stamp of a completely sent frame, if it contains observations."""
        if not rtcm.is_observation(rtcm.number_of(sent.frame)):
            return
        if self._observed_ns is None or sent.stamp_ns > self._observed_ns:
            self._observed_ns = sent.stamp_ns

    def _begin(self, now_ns: int) -> None:
        """Cut the next frame that is not yet too old into fragments."""
        while self._waiting:
            waiting = self._waiting.popleft()
            if now_ns - waiting.stamp_ns > _STALE_NS:
                self.counts.late += 1
                continue
            self._sending = waiting
            self._fragments.extend(fragments_of(waiting.frame, self._sequence))
            self._sequence = (self._sequence + 1) % SEQUENCES
            return

    def status(self, snapshot: Snapshot, now_ns: int) -> CorrectionsStatus:
        """Return the state of the corrections at this tick.

        Args:
            snapshot: newest snapshot of PX4, with the vehicle's position on Earth.
            now_ns: the time.
        """
        age_s = math.inf
        if self._observed_ns is not None:
            age_s = max(0.0, (now_ns - self._observed_ns) * 1e-9)

        base_id = -1
        base_distance_m = math.nan
        base = self._watch.base
        if base is not None:
            base_id = base.station
            vehicle_deg = _vehicle_deg(snapshot)
            if vehicle_deg is not None:
                base_distance_m = distance_m(self._watch.base_deg, vehicle_deg)

        several_ns = self._several_ns
        too_long_bytes = 0
        if now_ns - self._too_long_ns <= _TOO_LONG_NS:
            too_long_bytes = self._too_long_bytes
        return CorrectionsStatus(
            age_s=age_s,
            base_id=base_id,
            base_distance_m=base_distance_m,
            base=self._watch.judgement,
            unsteady_s=self._watch.unsteady_s(now_ns),
            has_several_sources=several_ns is not None and now_ns - several_ns < _SEVERAL_NS,
            too_long_bytes=too_long_bytes,
        )


def _vehicle_deg(snapshot: Snapshot) -> tuple[float, float] | None:
    """Return a vehicle's latitude and longitude from its PX4; None while PX4 does not know them."""
    if snapshot.global_origin is None or snapshot.local_position_ns == 0:
        return None
    latitude_deg, longitude_deg, altitude_m = snapshot.global_origin
    origin = Origin(latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_m=altitude_m)
    north_m, east_m, _ = snapshot.position_local_ned_m
    return latitude_longitude_deg(origin, east_m, north_m)
