"""Messages that a link streams, their rates, and the time at which each is due.

`streams.toml` lists for each message its rates on the links of the companion and of the ground, and
the highest rate that can be requested, where PX4 has one. The builder of a message is the function
with its name in `messages.py` or `messages_of_versions.py`.
"""

from __future__ import annotations

import heapq
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files

from sitl.mavlink import messages, messages_of_versions
from sitl.mavlink.codec import ID_BY_NAME
from sitl.mavlink.messages import Builder
from sitl.px4.arming_checks import BOOT_S
from sitl.px4.versions import Version

FASTEST_HZ = 250.0  # rate of the loop of PX4's simulator

_TABLE = tomllib.loads(files(__package__).joinpath("streams.toml").read_text())
_BUILDER_BY_NAME = {**vars(messages), **vars(messages_of_versions)}
BUILDERS: dict[int, Builder] = {
    ID_BY_NAME[name]: _BUILDER_BY_NAME[name.lower()] for name in _TABLE["rates_hz"]
}

ONBOARD_RATES_HZ: dict[int, float] = {}
GCS_RATES_HZ: dict[int, float] = {}
# Highest rate of a message, where it is below that of the physics.
_CEILINGS_HZ: dict[int, float] = {}
for _name, (_onboard_hz, _gcs_hz, *_ceiling_hz) in _TABLE["rates_hz"].items():
    ONBOARD_RATES_HZ[ID_BY_NAME[_name]] = _onboard_hz
    GCS_RATES_HZ[ID_BY_NAME[_name]] = _gcs_hz
    if _ceiling_hz:
        (_CEILINGS_HZ[ID_BY_NAME[_name]],) = _ceiling_hz
SIMULATOR_RATES_HZ: dict[int, float] = {
    ID_BY_NAME[name]: rate for name, rate in _TABLE["simulator_hz"].items()
}
# Messages whose rate can be set, although PX4 never sends them.
SILENT: frozenset[int] = frozenset(
    ID_BY_NAME[name] for name in _TABLE["silent"]["names"] if name in ID_BY_NAME
)

_HEARTBEAT = ID_BY_NAME["HEARTBEAT"]
# Times from the start of PX4 to the first message of a stream. PX4 is silent at first, then sends
# its heartbeat, and then its attitude.
_FIRST_PACKET_S = 0.3
_FIRST_S: dict[int, float] = {
    _HEARTBEAT: 1.3,
    ID_BY_NAME["ATTITUDE"]: 1.35,
    ID_BY_NAME["ATTITUDE_QUATERNION"]: 1.35,
    # Programs take HOME_POSITION as the sign that PX4 can be armed. A real PX4 sends it 2 s too
    # early for that (facts.toml).
    ID_BY_NAME["HOME_POSITION"]: BOOT_S,
}
_STEP_S = 0.004  # step of the physics
# The start times of a link's streams are spread over _SPREAD_STEPS steps. The stream of the next
# message begins 7 steps later, and that of the next vehicle 3 steps later, modulo _SPREAD_STEPS.
_SPREAD_STEPS = 25
_SPREAD_PER_MESSAGE = 7
_SPREAD_PER_VEHICLE = 3

_LARGEST_INTERVAL_US = 2**31 - 1
_FIRST_INTERVAL_S = 1.0  # longest time before the first message at a new rate
_LATE_S = 0.1  # a stream that is later than this skips messages
_TIME_TOLERANCE_S = 1e-6  # a message is due this much earlier


def schedule_of(version: Version, rates_hz: Mapping[int, float]) -> Schedule:
    """Return the streams of a link of PX4 of one version.

    Args:
        version: version of PX4.
        rates_hz: default rate of each message that some version streams.
    """
    silent = {ID_BY_NAME[name] for name in version.silent_streams}
    default_hz = {
        message_id: rate_hz for message_id, rate_hz in rates_hz.items() if message_id not in silent
    }
    return Schedule(default_hz=default_hz, silent=SILENT | silent)


@dataclass(slots=True)
class Schedule:
    """Times at which each message of a link is due, in simulated time."""

    default_hz: Mapping[int, float]  # rate of each message that the link can stream
    silent: frozenset[int] = SILENT  # messages whose rate can be set, but which are never sent
    _interval_s: dict[int, float] = field(default_factory=dict)  # interval of each streamed message
    _due: list[tuple[float, int]] = field(default_factory=list)  # heap of due times and ids

    def start(self, now_s: float, *, boot_s: float = 0.0, phase: int = 0) -> None:
        """Schedule each message at its default rate.

        The due times differ between messages and between vehicles.

        Args:
            now_s: present time.
            boot_s: time at which the autopilot started [s].
            phase: number that differs between vehicles.
        """
        for index, (message_id, rate_hz) in enumerate(self.default_hz.items()):
            if rate_hz <= 0.0:
                continue
            self._interval_s[message_id] = 1.0 / rate_hz

            earliest_s = boot_s + _FIRST_S.get(message_id, _FIRST_PACKET_S)
            position = index * _SPREAD_PER_MESSAGE + phase * _SPREAD_PER_VEHICLE
            spread_s = (position % _SPREAD_STEPS) * _STEP_S
            heapq.heappush(self._due, (max(now_s, earliest_s) + spread_s, message_id))

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> bool:
        """Set the interval of a message, as requested by MAV_CMD_SET_MESSAGE_INTERVAL.

        Args:
            message_id: identifier of the message.
            interval_us: interval; 0 sets the default, and a negative number stops the stream.
            now_s: present time.

        Returns:
            False for a message whose rate cannot be set.
        """
        if message_id in self.silent:
            return True
        if message_id not in self.default_hz or message_id == _HEARTBEAT:
            return False
        if not math.isfinite(interval_us):
            return False

        default_hz = self.default_hz[message_id]
        interval_s = 0.0
        if interval_us > 0.0:
            ceiling_hz = _CEILINGS_HZ.get(message_id, FASTEST_HZ)
            interval_s = max(interval_us * 1e-6, 1.0 / ceiling_hz)
        elif interval_us == 0.0 and default_hz > 0.0:
            interval_s = 1.0 / default_hz

        self._due = [(due_s, other) for due_s, other in self._due if other != message_id]
        heapq.heapify(self._due)
        self._interval_s.pop(message_id, None)
        if interval_s > 0.0:
            self._interval_s[message_id] = interval_s
            heapq.heappush(self._due, (now_s + min(interval_s, _FIRST_INTERVAL_S), message_id))
        return True

    def interval_us(self, message_id: int) -> int:
        """Return MESSAGE_INTERVAL.interval_us: -1 when not streamed, 0 when unknown."""
        if message_id not in self.default_hz and message_id not in self.silent:
            return 0

        interval_s = self._interval_s.get(message_id)
        if interval_s is None:
            return -1
        return min(round(interval_s * 1e6), _LARGEST_INTERVAL_US)

    def pop_due(self, now_s: float) -> list[int]:
        """Return the ids of the messages that are due now, and schedule each again."""
        due: list[int] = []
        limit_s = now_s + _TIME_TOLERANCE_S
        while self._due:
            due_s, message_id = self._due[0]
            if due_s > limit_s:
                break
            due.append(message_id)
            next_s = max(due_s, now_s - _LATE_S) + self._interval_s[message_id]
            heapq.heapreplace(self._due, (next_s, message_id))
        return due
