"""A path that a vehicle follows: its parts, its clock, and the vehicle's lag.

All vehicles of a show have the same path time. Each vehicle integrates its own clock, and compares
it with the clocks in the telemetry of the others. So a show continues without the ground:

    A vehicle that falls behind its path requests more time. All clocks then run at half the rate.
    So they do while a failsafe requests slow flight.

    A clock that is ahead of the slowest clock slows down.

    A vehicle that is behind gets CATCH_UP_LIMIT_S of time. If it has used up that time and is still
    behind, it leaves the show, and the others no longer wait for it. A pause uses up no time.

    A pause stops the clock of the vehicle that was ordered to pause. The other vehicles of the show
    see this in its telemetry, and stop their clocks, too. Each vehicle brakes along its own path.
    The clocks continue when no vehicle of the show is paused.

    A vehicle that skips the rest leaves the show, and flies straight to the end of its path. There
    its order to follow the path is done.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from onboard.bus.schema import PathOrder, Telemetry
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.flight_space import flight_space_of
from onboard.config.ground import (
    highest_spot_m,
    least_height_m,
    lowest_ground_in_fence_m,
    touchable_ground_at_m,
)
from onboard.control import path as paths
from onboard.control.path import Path, PathPoint
from onboard.safety.area_room import clearances_m
from onboard.tuples import Xyz
from onboard.types import Goal

CATCH_UP_LIMIT_S = 10.0  # the others wait for one vehicle for this time
BEHIND_M = 0.6  # a vehicle with more lag than this requests more time
CAUGHT_UP_M = 0.3  # below this lag, the request ends
SLOWEST_RATE = 0.5  # rate of the clocks while a vehicle requests more time
START_WITHIN_S = 60.0  # a show starts at most this long after its order
AT_START_M = 0.5  # largest distance from the start of the path when the show is ordered

_RATE_SLEW_1_S = 0.5  # largest change of the clock's rate per second
_RECOVERY = 0.1  # seconds to catch up that a vehicle regains per second of keeping up
_AHEAD_GAIN_1_S = 1.0  # how much a clock slows down for each second that it is ahead
_CLOCK_AHEAD_S = 0.05  # a clock that is ahead of the slowest by less does not slow down

_HEARD_NS = 1_500_000_000  # clocks in older telemetry are not compared
_COMPARE_NS = 95_000_000  # time between two comparisons

_CHECK_HZ = 20.0  # samples per second in the check of a path
_SPEED_ROOM = 1.1  # largest speed on a path, relative to the vehicle's top speed
_REST_M_S = 0.05  # largest speed at the start and the end of a path
_JUMP_ROOM = 1.1  # largest jump between two pieces, relative to the largest that is planned


class OtherClock(NamedTuple):
    """Clock of another vehicle of the same show, extrapolated to now."""

    time_s: float
    is_behind: bool
    is_paused: bool = False


@dataclass(slots=True)
class PathFlight:
    """The loaded path of one vehicle, and how far it has flown it."""

    parts: dict[int, bytes] = field(default_factory=dict)
    path_id: str = ""  # id of the path that the parts belong to
    path: Path | None = None  # the path, once all its parts have arrived

    show_id: str = ""  # id of the show that is flown; empty: none
    start_ns: int = 0  # time when the show begins
    on_lag: str = "land"  # "land" or "hold": what the vehicle does if it must leave the show

    time_s: float = 0.0  # time of the path's clock
    rate: float = 1.0  # rate of the clock
    target_rate: float = 1.0  # rate from the last comparison with the others
    compare_ns: int = 0  # time of the next comparison

    lag_m: float = 0.0  # distance from the path's present point
    is_lagging: bool = False  # whether the lag is too large
    slow_until_ns: int = 0  # until this time a failsafe requests slow flight; 0: no request
    is_paused: bool = False  # whether an order has stopped the clock
    is_skipped: bool = False  # whether an order lets it fly straight to the end
    used_s: float = 0.0  # part of CATCH_UP_LIMIT_S that is used up

    @property
    def is_behind(self) -> bool:
        """Whether the vehicle requests more time from the others.

        It gets time for its lag only while CATCH_UP_LIMIT_S is not used up. A failsafe's request
        lasts as long as its cause.
        """
        has_time_left = self.used_s < CATCH_UP_LIMIT_S
        return (self.is_lagging and has_time_left) or self.slow_until_ns > 0

    @property
    def is_lost(self) -> bool:
        """Whether the vehicle still lags although its time to catch up is used up."""
        return self.is_lagging and self.used_s >= CATCH_UP_LIMIT_S

    @property
    def left_s(self) -> float:
        """Time of the path that is left; negative after its end."""
        if self.path is None:
            return -math.inf
        return self.path.duration_s - self.time_s

    def load(self, order: PathOrder) -> None:
        """Take a part that :func:`part_refusal` has not refused."""
        self.parts = _parts_with(self, order)
        self.path_id = order.path_id

        if len(self.parts) == order.parts:
            self.path = paths.from_bytes(_joined(self.parts))
        elif len(self.parts) == 1:
            # the first part of another path, which replaces the loaded one
            self.path = None

    def begin(self, order: PathOrder) -> None:
        """Start to follow the path at the ordered time."""
        self.show_id = order.show_id
        self.start_ns = order.start_ns
        self.on_lag = order.on_lag

        self.time_s = -math.inf  # the first tick sets it
        self.rate = 1.0
        self.target_rate = 1.0
        self.compare_ns = 0

        self.lag_m = 0.0
        self.is_lagging = False
        self.slow_until_ns = 0
        self.is_paused = False
        self.is_skipped = False
        self.used_s = 0.0

    def advance(
        self, now_ns: int, dt_s: float, position_enu_m: Xyz, others: Sequence[OtherClock] | None
    ) -> None:
        """Advance the clock by one tick, and measure the lag.

        Args:
            now_ns: our clock.
            dt_s: time since the last tick.
            position_enu_m: position of the vehicle.
            others: clocks of the others; None at ticks without a comparison.
        """
        assert self.path is not None
        self._advance_clock(now_ns, dt_s, others)

        point = paths.point_at(self.path, self.time_s)
        self.lag_m = math.dist(point.position_enu_m, position_enu_m)
        limit_m = CAUGHT_UP_M if self.is_lagging else BEHIND_M
        self.is_lagging = self.lag_m > limit_m

        if self.slow_until_ns < now_ns:
            self.slow_until_ns = 0

        is_stopped = self.target_rate == 0.0
        if not self.is_lagging:
            self.used_s = max(self.used_s - _RECOVERY * dt_s, 0.0)
        elif not is_stopped:
            self.used_s += dt_s

    def _advance_clock(self, now_ns: int, dt_s: float, others: Sequence[OtherClock] | None) -> None:
        """Before the start, set the path time. Afterwards, integrate the rate of the clock."""
        since_start_s = (now_ns - self.start_ns) * 1e-9
        is_first = not math.isfinite(self.time_s)
        if since_start_s <= 0.0 or is_first:
            self.time_s = since_start_s
            return

        if others is not None:
            self.target_rate = _target_rate(self, others)
            self.compare_ns = now_ns + _COMPARE_NS
        elif self.is_paused:
            self.target_rate = 0.0

        most_change = _RATE_SLEW_1_S * dt_s
        self.rate += min(max(self.target_rate - self.rate, -most_change), most_change)
        self.time_s += self.rate * dt_s

    def goal(self, sequence: int, lead_s: float) -> Goal:
        """Return the path's motion after ``lead_s``, when a command given now takes effect."""
        assert self.path is not None
        point: PathPoint = paths.point_at(self.path, self.time_s + self.rate * lead_s)
        return Goal(
            position_enu_m=point.position_enu_m,
            duration_s=0.0,
            sequence=sequence,
            is_on_path=True,
            velocity_enu_m_s=point.velocity_enu_m_s,
            acceleration_enu_m_s2=point.acceleration_enu_m_s2,
            yaw_rad=point.yaw_rad,
            clock_rate_frac=self.rate,
        )


def other_clocks(telemetries: Iterable[Telemetry], show_id: str, now_ns: int) -> list[OtherClock]:
    """Return the clocks of the other vehicles in the same show with recent telemetry.

    Clocks that are not finite are left out, because the comparison would make this vehicle's own
    clock NaN.
    """
    clocks = []
    for other in telemetries:
        since_s = (now_ns - other.stamp_ns) * 1e-9
        time_s = other.path_time_s + other.path_rate_frac * since_s
        is_heard = now_ns - other.stamp_ns < _HEARD_NS
        if other.show_id == show_id and is_heard and math.isfinite(time_s):
            clocks.append(
                OtherClock(time_s=time_s, is_behind=other.is_behind, is_paused=other.is_path_paused)
            )
    return clocks


def part_refusal(
    flight: PathFlight, order: PathOrder | None, vehicle: Vehicle, fleet: FleetConfig
) -> str | None:
    """Return the reason why a part of a path cannot be taken, or None.

    The whole path is checked when its last part arrives.
    """
    most_parts = 1 + paths.MAX_BYTES // paths.PART_BYTES
    if order is None or not 0 <= order.part < order.parts <= most_parts:
        return (
            "An order to load a path needs one of its parts: "
            "see PathOrder in onboard/bus/schema.py."
        )
    if flight.show_id:
        return "The vehicle follows a path now: order hold before another one is loaded."

    parts = _parts_with(flight, order)
    if len(parts) < order.parts:
        return None

    data = _joined(parts)
    if paths.path_id(data) != order.path_id:
        return "The path has changed on its way: its bytes do not have its id. Load it again."
    try:
        return _path_refusal(paths.from_bytes(data), vehicle, fleet)
    except ValueError as error:
        return str(error)


def start_refusal(
    flight: PathFlight, order: PathOrder | None, now_ns: int, position_enu_m: Xyz
) -> str | None:
    """Return the reason why the loaded path cannot be followed from that time, or None."""
    if order is None or not order.show_id:
        return (
            "An order to follow a path needs the path's id and the show's: "
            "see PathOrder in onboard/bus/schema.py."
        )
    if flight.path is None or flight.path_id != order.path_id:
        return "This path is not loaded: load it, all of its parts, before the start."

    wait_s = (order.start_ns - now_ns) * 1e-9
    if not 0.0 < wait_s < START_WITHIN_S:
        return (
            f"The show would begin in {wait_s:.1f} s: order it 0 to {START_WITHIN_S:.0f} s ahead."
        )

    first = paths.point_at(flight.path, 0.0)
    away_m = math.dist(first.position_enu_m, position_enu_m)
    if away_m > AT_START_M:
        return (
            f"The vehicle is {away_m:.2f} m from the first point of its path: "
            f"move it to within {AT_START_M:g} m of it."
        )
    return None


def change_refusal(flight: PathFlight, kind: str) -> str | None:
    """Return the reason why a path cannot be paused, resumed or skipped now, or None.

    Args:
        flight: present state of the path's flight.
        kind: "pause", "resume" or "skip".
    """
    if not flight.show_id:
        return "The vehicle follows no path: order hold to stop it where it is."
    if flight.time_s <= 0.0 and kind != "resume":
        return "Its path has not begun yet: order hold all, and nobody starts."
    if flight.left_s <= 0.0 and kind != "resume":
        return "It is at the end of its path."
    return None


def _target_rate(own: PathFlight, others: Sequence[OtherClock]) -> float:
    """Return the rate that the clock should have."""
    if own.is_paused or any(other.is_paused for other in others):
        return 0.0
    if own.is_behind or any(other.is_behind for other in others):
        return SLOWEST_RATE

    slowest_s = min((other.time_s for other in others), default=own.time_s)
    ahead_s = own.time_s - slowest_s
    return max(1.0 - _AHEAD_GAIN_1_S * max(ahead_s - _CLOCK_AHEAD_S, 0.0), SLOWEST_RATE)


def _parts_with(flight: PathFlight, order: PathOrder) -> dict[int, bytes]:
    """Return all parts of the order's path that have arrived, including the part in this order."""
    parts: dict[int, bytes] = {}
    if flight.path_id == order.path_id:
        parts.update(flight.parts)
    parts[order.part] = order.data
    return parts


def _joined(parts: dict[int, bytes]) -> bytes:
    """Return the parts as one sequence of bytes, in the order of their indices."""
    return b"".join(parts[index] for index in sorted(parts))


def _too_low_refusal(
    times_s: np.ndarray, position_enu_m: np.ndarray, vehicle: Vehicle, fleet: FleetConfig
) -> str | None:
    """Return the reason why a path is too near to the ground, or None.

    Only samples below the highest ground are compared, because an agent checks a path of an hour,
    which has tens of thousands of them, while it flies.
    """
    least_m = least_height_m(vehicle)
    highest_ground_m = max(highest_spot_m(fleet), lowest_ground_in_fence_m(fleet))
    is_low = position_enu_m[:, 2] < highest_ground_m + least_m
    if not is_low.any():
        return None

    low_enu_m = position_enu_m[is_low]
    ground_m = touchable_ground_at_m(fleet, low_enu_m[:, 0], low_enu_m[:, 1])
    height_m = low_enu_m[:, 2] - ground_m
    lowest = int(height_m.argmin())
    if height_m[lowest] < least_m:
        return (
            f"The path is {height_m[lowest]:.2f} m above the ground at {ground_m[lowest]:g} m, at "
            f"{times_s[is_low][lowest]:.1f} s: {least_m:g} m is the least. Raise the path."
        )
    return None


def _path_refusal(path: Path, vehicle: Vehicle, fleet: FleetConfig) -> str | None:
    """Return the reason why a path cannot be flown, or None.

    Its positions, heights, speeds, ends and the jumps between its pieces are checked.
    """
    times_s = np.linspace(0.0, path.duration_s, 2 + int(_CHECK_HZ * path.duration_s))
    # rows: samples; columns: x, y, z and heading
    values, rates, _ = paths.sampled(path, times_s)

    fence = fleet.fleet.geofence_m
    low_enu_m, high_enu_m = np.array([fence.x, fence.y, fence.z]).T
    position_enu_m = values[:, :3]
    is_coordinate_out = (position_enu_m < low_enu_m) | (position_enu_m > high_enu_m)
    is_out = is_coordinate_out.any(-1)  # per sample
    if is_out.any():
        return f"The path leaves the geofence at {times_s[is_out.argmax()]:.1f} s."

    for area in flight_space_of(fleet).areas:
        is_wrong = clearances_m((area,), position_enu_m) < 0.0
        if is_wrong.any():
            wrong = int(is_wrong.argmax())
            x, y, z = position_enu_m[wrong].tolist()
            words = flight_space_of(fleet).refusal((x, y, z))
            return f"At {times_s[wrong]:.1f} s the path lies {words}."

    too_low = _too_low_refusal(times_s, position_enu_m, vehicle, fleet)
    if too_low is not None:
        return too_low

    speed_m_s = np.sqrt((rates[:, :3] ** 2).sum(-1))
    if speed_m_s.max() > _SPEED_ROOM * vehicle.max_speed_m_s:
        return (
            f"The path is flown at {speed_m_s.max():.2f} m/s at {times_s[speed_m_s.argmax()]:.1f} "
            f"s; max_speed_m_s is {vehicle.max_speed_m_s:g}."
        )

    if max(speed_m_s[0], speed_m_s[-1]) > _REST_M_S:
        return "The path does not begin and end at rest."

    jump_m, jump_m_s = paths.jumps(path).max(axis=1, initial=0.0)
    if jump_m > _JUMP_ROOM * paths.MAX_JUMP_M:
        return f"The position jumps by {jump_m:.2f} m from one piece of the path to the next."
    if jump_m_s > _JUMP_ROOM * paths.MAX_JUMP_M_S:
        return f"The velocity jumps by {jump_m_s:.2f} m/s from one piece of the path to the next."
    return None
