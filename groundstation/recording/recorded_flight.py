"""A recorded flight as arrays: the values of every vehicle over a common time.

A record has millions of messages, but figures and reports need curves. So ``flight_reading`` reads
the record once into a :class:`Flight`. All times are seconds since the start of the record, on its
common clock, as in replay and verdict.

A value that is missing, null, infinite or absurd is NaN. Any part may be incomplete: a record of
another version lacks fields, a record that was cut off lacks its end, and a flight with real
vehicles has no ground truth.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.recording.audit import OrderTrace
from onboard.arrays import Array, IntArray
from onboard.bus.schema import Event, PreflightReport
from onboard.config.fleet import FleetConfig

LIFTED_M = 0.05  # a vehicle this far above its first position has left the ground
PATH_GAP_S = 0.5  # a longer time without a position is a gap of a path, which no line crosses


@dataclass(frozen=True, slots=True)
class Ticks:
    """Ticks (passes) of one vehicle's control pipeline: n of them."""

    time_s: Array  # (n,), rising

    period_s: Array  # (n,), since the tick before
    position_enu_m: Array  # (n, 3), own estimate
    velocity_enu_m_s: Array  # (n, 3), own estimate
    setpoint_position_enu_m: Array  # (n, 3), trajectory setpoint
    thrust_baseline_enu_m_s2: Array  # (n, 3), before the law
    thrust_safe_enu_m_s2: Array  # (n, 3), after the law
    intervention_m_s2: Array  # (n,), size of the law's change of the thrust
    slack_m_s2: Array  # (n,), slack by which the law relaxed its constraints
    setpoint_quaternion_enu_flu_wxyz: Array  # (n, 4), attitude setpoint sent to PX4
    attitude_quaternion_enu_flu_wxyz: Array  # (n, 4), attitude that PX4 reports
    setpoint_thrust_frac: Array  # (n,), thrust setpoint sent to PX4
    attitude_age_s: Array  # (n,), since PX4's attitude arrived

    predicted_position_enu_m: Array  # (n, 3), where a command of this tick takes effect
    predicted_velocity_enu_m_s: Array  # (n, 3)
    commanded_acceleration_enu_m_s2: Array  # (n, 3), after the law, without gravity

    # index in Flight.vehicles of the neighbour for which the law intervenes most; -1 for none
    avoided: Array  # (n,)
    ages_s: dict[str, Array]  # neighbour -> (n,), age of its state at this vehicle

    @property
    def size(self) -> int:
        """Number of ticks."""
        return int(self.time_s.size)


@dataclass(frozen=True, slots=True)
class TelemetryRows:
    """Telemetry of one vehicle: n messages."""

    time_s: Array  # (n,), rising

    position_enu_m: Array  # (n, 3)
    goal_position_enu_m: Array  # (n, 3), goal of the order
    battery_frac: Array  # (n,), charge
    battery_voltage_v: Array  # (n,)
    wind_enu_m_s: Array  # (n, 2), mean velocity of the air
    gust_m_s: Array  # (n,)
    max_wind_m_s: Array  # (n,), wind limit of the vehicle
    corrections_age_s: Array  # (n,), age of the RTK corrections; NaN if it gets none
    state_age_s: Array  # (n,), age of its own position
    autopilot_age_s: Array  # (n,), since the last packet of PX4
    neighbour_age_s: Array  # (n,), greatest age of a neighbour's state
    loop_period_p99_ms: Array  # (n,), over the last ten seconds
    loop_lateness_p99_ms: Array  # (n,)
    mocap_delay_s: Array  # (n,)
    hover_thrust_frac: Array  # (n,)
    is_airborne: Array  # (n,), 0 or 1; NaN if the message does not say it

    # counted since the agent's start, (n,) each
    late_ticks: Array
    missed_ticks: Array
    malformed_messages: Array
    refused_messages: Array
    dropped_messages: Array
    late_messages: Array

    # (n,) texts each
    states: list[str]
    modes: list[str]
    fixes: list[str]  # kind of the satellite fix; empty if it flies without satellites
    orders: list[str]  # kind of the newest order

    law: str  # name of the law that it reported last
    config_hash: str  # hash of fleet file and law that it reported last


@dataclass(frozen=True, slots=True)
class TruthRows:
    """True motion of one simulated vehicle: n samples."""

    time_s: Array  # (n,), rising
    position_enu_m: Array  # (n, 3)
    velocity_enu_m_s: Array  # (n, 3)
    quaternion_enu_flu_wxyz: Array  # (n, 4)
    is_on_ground: Array  # (n,), 0 or 1
    is_collided: Array  # (n,), 0 or 1


@dataclass(frozen=True, slots=True)
class StateRows:
    """Slowly changing values of one vehicle's published states: n of them, a few in a second."""

    time_s: Array  # (n,), rising
    position_std_m: Array  # (n,), standard deviation of the estimated position
    velocity_std_m_s: Array  # (n,)
    is_cooperative: Array  # (n,), 0 or 1


@dataclass(frozen=True, slots=True)
class VehicleFlight:
    """One vehicle's part of a flight."""

    name: str
    ticks: Ticks
    telemetry: TelemetryRows
    truth: TruthRows
    states: StateRows
    preflight: PreflightReport | None = None  # the last one

    @property
    def has_truth(self) -> bool:
        """Whether its true motion is known."""
        return self.truth.time_s.size > 1

    @property
    def path(self) -> tuple[Array, Array]:
        """Times (n,) [s] and positions (n, 3) [m], ENU, from the best source in the record.

        That is the ground truth, or else the vehicle's own estimate, or else its telemetry.
        """
        if self.has_truth:
            return self.truth.time_s, self.truth.position_enu_m
        if self.ticks.size > 1:
            return self.ticks.time_s, self.ticks.position_enu_m
        return self.telemetry.time_s, self.telemetry.position_enu_m

    @property
    def is_up(self) -> NDArray[np.bool_]:
        """Whether the vehicle is off the ground (n,), at each time of ``path``.

        Ground truth says it, or else the telemetry, as ``is_off_ground`` describes.
        """
        if self.has_truth:
            on_ground: NDArray[np.bool_] = self.truth.is_on_ground > 0.5
            return ~on_ground

        times_s, positions_enu_m = self.path
        telemetry = self.telemetry
        height_m = positions_enu_m[:, 2]
        return is_off_ground(telemetry.time_s, telemetry.is_airborne, times_s, height_m)

    @property
    def lift_off_s(self) -> float | None:
        """Time at which the vehicle leaves the ground; None if it stays there."""
        times_s, positions_enu_m = self.path
        index = lift_off_index(self.is_up, positions_enu_m[:, 2])
        if index is None:
            return None
        return float(times_s[index])


@dataclass(frozen=True, slots=True)
class PersonTrack:
    """Where the motion capture saw one person: n samples."""

    time_s: Array  # (n,), rising
    position_enu_m: Array  # (n, 3)


@dataclass(frozen=True, slots=True)
class Flight:
    """One recorded flight."""

    title: str
    begin_ns: int  # stamp on the record's common clock from which all times count
    length_s: float
    # by name; vehicles of the fleet file come first in its order, then all others by name
    vehicles: dict[str, VehicleFlight]
    events: list[tuple[float, Event]]  # by time
    orders: list[OrderTrace]

    fleet: FleetConfig | None = None  # the fleet file beside the record
    # persons of that file whom the motion capture saw, by name
    people: dict[str, PersonTrack] = field(default_factory=dict)
    verdict: dict[str, Any] = field(default_factory=dict)  # content of verdict.json, or empty
    mission: str = ""  # text of the mission file
    made: dict[str, str] = field(default_factory=dict)  # program and computer that wrote the record
    notes: tuple[str, ...] = ()  # sentences about what is missing or damaged

    @property
    def has_truth(self) -> bool:
        """Whether every vehicle's true motion is known."""
        return bool(self.vehicles) and all(vehicle.has_truth for vehicle in self.vehicles.values())

    @property
    def begin_s(self) -> float:
        """The earliest time on a vehicle's path; 0 if there is none."""
        begins_s = []
        for vehicle in self.vehicles.values():
            times_s, _ = vehicle.path
            if times_s.size:
                begins_s.append(float(times_s[0]))
        return min(begins_s, default=0.0)


def is_off_ground(
    telemetry_s: Array, is_airborne: Array, times_s: Array, height_m: Array
) -> NDArray[np.bool_]:
    """Return where a vehicle without ground truth is off the ground.

    The telemetry says it: a record may begin in flight, and a vehicle that a person carries does
    not fly. Only in a record without telemetry, the height above the first position says it.

    Args:
        telemetry_s: times (m,) of the vehicle's telemetry, rising [s].
        is_airborne: what the telemetry says (m,): 1 in the air, 0 not, NaN not known.
        times_s: times (n,) of the vehicle's path, rising [s].
        height_m: heights (n,) of that path; NaN where not known.

    Returns:
        Whether the vehicle is off the ground at each time of its path (n,).
    """
    is_known = np.isfinite(is_airborne)
    if not is_known.any():
        return _has_lifted(height_m)

    # the last message before each time; before the first message, that one
    last_index = np.searchsorted(telemetry_s[is_known], times_s, side="right") - 1
    last_index = np.clip(last_index, 0, None)
    is_up: NDArray[np.bool_] = is_airborne[is_known][last_index] > 0.5
    return is_up


def lift_off_index(is_up: NDArray[np.bool_], height_m: Array) -> int | None:
    """Return the index at which a vehicle leaves the ground; None if it stays there.

    Args:
        is_up: whether the vehicle is off the ground (n,), in the order of time.
        height_m: heights (n,); NaN where not known.

    Returns:
        The first index with a height of more than LIFTED_M above the ground; 0 if the record begins
        in flight.
    """
    if is_up[:1].any():
        return 0
    lifted = np.flatnonzero(is_up & _has_lifted(height_m))
    if not lifted.size:
        return None
    return int(lifted[0])


def _has_lifted(height_m: Array) -> NDArray[np.bool_]:
    """Return where each height is more than LIFTED_M above the first one that is known (n,)."""
    known_m = height_m[np.isfinite(height_m)]
    if not known_m.size:
        return np.zeros(height_m.shape, np.bool_)
    lifted: NDArray[np.bool_] = height_m > known_m[0] + LIFTED_M
    return lifted


def at_times(times_s: Array, values: Array, wanted_s: Array, max_gap_s: float) -> Array:
    """Return values at other times: the last one before each; NaN if that one is too old.

    Args:
        times_s: times (n,) of the values, rising.
        values: values (n, ...).
        wanted_s: times (m,) of the result.
        max_gap_s: greatest age of a value.

    Returns:
        Values (m, ...).
    """
    shape = (wanted_s.size, *values.shape[1:])
    if not times_s.size:
        return np.full(shape, np.nan)

    # index of the last value before each wanted time; -1 if there is none
    last_index = np.searchsorted(times_s, wanted_s, side="right") - 1
    has_value = last_index >= 0
    last_index = np.clip(last_index, 0, None)
    is_known = has_value & (wanted_s - times_s[last_index] <= max_gap_s)

    result = np.full(shape, np.nan)
    result[is_known] = values[last_index[is_known]]
    return result


def between_times(times_s: Array, values: Array, wanted_s: Array, max_gap_s: float) -> Array:
    """Return values at other times, interpolated linearly; NaN in gaps.

    Args:
        times_s: times (n,) of the values, rising.
        values: values (n, k).
        wanted_s: times (m,) of the result.
        max_gap_s: longest time between two values that does not count as a gap.

    Returns:
        Values (m, k).
    """
    result = np.full((wanted_s.size, values.shape[1]), np.nan)
    if times_s.size < 2:
        return result

    # index of the next value after each wanted time, so that the one before it exists
    next_index = np.clip(np.searchsorted(times_s, wanted_s, side="left"), 1, times_s.size - 1)
    gap_s = times_s[next_index] - times_s[next_index - 1]
    is_inside = (wanted_s >= times_s[0]) & (wanted_s <= times_s[-1]) & (gap_s <= max_gap_s)
    for column in range(values.shape[1]):
        on_lines = np.interp(wanted_s, times_s, values[:, column])
        result[is_inside, column] = on_lines[is_inside]
    return result


def largest_indexes(times_s: Array, values: Array, edges_s: Array) -> IntArray:
    """Return the index of the largest value in each interval of time; -1 in those without a value.

    Of equal values it is the last one.

    Args:
        times_s: times (n,) of the values, rising.
        values: values (n,).
        edges_s: edges (m + 1,) of the intervals, rising.

    Returns:
        Indexes (m,).
    """
    result = np.full(edges_s.size - 1, -1, np.int64)
    known = np.flatnonzero(np.isfinite(values))
    cells = np.searchsorted(edges_s, times_s[known], side="right") - 1
    is_inside = (cells >= 0) & (cells < result.size)
    known = known[is_inside]
    cells = cells[is_inside]

    largest = np.full(result.size, -np.inf)
    np.maximum.at(largest, cells, values[known])
    is_largest = values[known] == largest[cells]
    result[cells[is_largest]] = known[is_largest]
    return result


def largest_in_cells(times_s: Array, values: Array, edges_s: Array) -> Array:
    """Return the largest value in each interval of time; NaN in intervals without a value.

    Args:
        times_s: times (n,) of the values, rising.
        values: values (n,).
        edges_s: edges (m + 1,) of the intervals, rising.

    Returns:
        Values (m,).
    """
    largest = largest_indexes(times_s, values, edges_s)
    result = np.full(largest.size, np.nan)
    has_any = largest >= 0
    result[has_any] = values[largest[has_any]]
    return result
