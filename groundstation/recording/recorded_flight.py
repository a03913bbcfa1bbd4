"""What happened in a recorded flight: every vehicle's values as arrays over one time.

A record has millions of messages. Whoever draws or judges a flight wants curves: so the record is
read once, from its begin to its end, into this one value. All times are seconds since the record's
begin, on the record's common clock, as replay and verdict count them.

A value that is missing, null, infinite or absurd is NaN. Nothing here is trusted to be complete: a
record of another version lacks fields, one that was cut off lacks its end, and a flight with real
vehicles has no ground truth.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from groundstation.recording.audit import OrderTrace
from onboard.arrays import Array
from onboard.bus.schema import Event, PreflightReport
from onboard.config.fleet import FleetConfig


@dataclass(frozen=True, slots=True)
class Ticks:
    """Runs of one vehicle's control pipeline: n of them."""

    time_s: Array  # (n,), rising

    period_s: Array  # (n,), since the tick before
    position_enu_m: Array  # (n, 3), own estimate
    velocity_enu_m_s: Array  # (n, 3)
    setpoint_position_enu_m: Array  # (n, 3), of the trajectory
    thrust_baseline_enu_m_s2: Array  # (n, 3), before the law
    thrust_safe_enu_m_s2: Array  # (n, 3), after the law
    intervention_m_s2: Array  # (n,), by how much the law changes the thrust
    slack_m_s2: Array  # (n,), by how much the law's constraints had to be relaxed
    setpoint_quaternion_enu_flu_wxyz: Array  # (n, 4), that PX4 is sent
    attitude_quaternion_enu_flu_wxyz: Array  # (n, 4), that PX4 reports
    setpoint_thrust_frac: Array  # (n,), throttle
    attitude_age_s: Array  # (n,), since PX4's attitude arrived

    # where its lag brings it, and what the law commands, without gravity
    predicted_position_enu_m: Array  # (n, 3)
    predicted_velocity_enu_m_s: Array  # (n, 3)
    commanded_acceleration_enu_m_s2: Array  # (n, 3)

    # the neighbour that the law intervenes mostly for: index in Flight.vehicles, -1 for none
    avoided: Array  # (n,)
    ages_s: dict[str, Array]  # neighbour -> (n,), age of the state that this vehicle had of it

    @property
    def size(self) -> int:
        """Number of ticks."""
        return int(self.time_s.size)


@dataclass(frozen=True, slots=True)
class TelemetryRows:
    """Telemetry of one vehicle: n messages."""

    time_s: Array  # (n,), rising

    position_enu_m: Array  # (n, 3)
    goal_position_enu_m: Array  # (n, 3), of the order
    battery_frac: Array  # (n,), charge
    battery_voltage_v: Array  # (n,)
    wind_enu_m_s: Array  # (n, 2), mean velocity of the air
    gust_m_s: Array  # (n,)
    max_wind_m_s: Array  # (n,), its limit of the mean
    corrections_age_s: Array  # (n,), of RTK; NaN without
    state_age_s: Array  # (n,), of its own position
    autopilot_age_s: Array  # (n,), since a packet of PX4
    neighbour_age_s: Array  # (n,), of the neighbour that has been silent for longest
    loop_period_p99_ms: Array  # (n,), of the last ten seconds
    loop_lateness_p99_ms: Array  # (n,)
    mocap_delay_s: Array  # (n,)
    hover_thrust_frac: Array  # (n,)

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
    fixes: list[str]  # of the satellite receiver; empty without
    orders: list[str]  # kind of the newest order

    law: str  # the last one that it reported
    config_hash: str  # of fleet file and law, the last one


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
    """Slowly changing values of the states that one vehicle published: n of them, some a second."""

    time_s: Array  # (n,), rising
    position_std_m: Array  # (n,), standard deviation of its estimate's position
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
        """Times (n,) [s] and positions (n, 3) [m], ENU: the best that is known.

        Ground truth, else the vehicle's own estimate, else what its telemetry says.
        """
        if self.has_truth:
            return self.truth.time_s, self.truth.position_enu_m
        if self.ticks.size > 1:
            return self.ticks.time_s, self.ticks.position_enu_m
        return self.telemetry.time_s, self.telemetry.position_enu_m


@dataclass(frozen=True, slots=True)
class Flight:
    """One recorded flight."""

    title: str
    begin_ns: int  # zero of all times here, on the record's common clock
    length_s: float
    vehicles: dict[str, VehicleFlight]  # by name, in the fleet file's order, then by name
    events: list[tuple[float, Event]]  # by time
    orders: list[OrderTrace]

    fleet: FleetConfig | None = None  # of the file beside the record
    verdict: dict[str, Any] = field(default_factory=dict)  # of verdict.json; empty without one
    mission: str = ""  # text of the mission file
    made: dict[str, str] = field(default_factory=dict)  # by which program, as the record says
    notes: tuple[str, ...] = ()  # sentences about what is missing or damaged

    @property
    def has_truth(self) -> bool:
        """Whether every vehicle's true motion is known."""
        return bool(self.vehicles) and all(one.has_truth for one in self.vehicles.values())

    @property
    def begin_s(self) -> float:
        """The earliest time of a vehicle's value; 0 where there is none."""
        begins_s = [
            float(times_s[0]) for one in self.vehicles.values() if (times_s := one.path[0]).size
        ]
        return min(begins_s, default=0.0)


def at_times(times_s: Array, values: Array, wanted_s: Array, max_gap_s: float) -> Array:
    """Return values at other times: the last one before each, NaN after a gap.

    Args:
        times_s: (n,), rising.
        values: (n, ...).
        wanted_s: (m,).
        max_gap_s: a value that is older than that is not shown any more.

    Returns:
        Values (m, ...).
    """
    shape = (wanted_s.size, *values.shape[1:])
    if not times_s.size:
        return np.full(shape, np.nan)

    last = np.searchsorted(times_s, wanted_s, side="right") - 1
    is_known = last >= 0
    last = np.clip(last, 0, None)
    is_known &= wanted_s - times_s[last] <= max_gap_s

    found = np.full(shape, np.nan)
    found[is_known] = values[last[is_known]]
    return found


def between_times(times_s: Array, values: Array, wanted_s: Array, max_gap_s: float) -> Array:
    """Return values at other times, on straight lines between the known ones; NaN in gaps.

    Args:
        times_s: (n,), rising.
        values: (n, k).
        wanted_s: (m,).
        max_gap_s: between two known values; a longer time is a gap.

    Returns:
        Values (m, k).
    """
    found = np.full((wanted_s.size, values.shape[1]), np.nan)
    if times_s.size < 2:
        return found

    after = np.clip(np.searchsorted(times_s, wanted_s, side="left"), 1, times_s.size - 1)
    gap_s = times_s[after] - times_s[after - 1]
    is_inside = (wanted_s >= times_s[0]) & (wanted_s <= times_s[-1]) & (gap_s <= max_gap_s)
    for column in range(values.shape[1]):
        on_lines = np.interp(wanted_s, times_s, values[:, column])
        found[is_inside, column] = on_lines[is_inside]
    return found


def largest_in_cells(times_s: Array, values: Array, edges_s: Array) -> Array:
    """Return the largest value in each cell of time; NaN in cells without any.

    Args:
        times_s: (n,), rising.
        values: (n,).
        edges_s: (m + 1,) of the cells, rising.

    Returns:
        Values (m,).
    """
    found = np.full(edges_s.size - 1, np.nan)
    is_known = np.isfinite(values)
    cells = np.searchsorted(edges_s, times_s[is_known], side="right") - 1
    is_inside = (cells >= 0) & (cells < found.size)

    largest = np.full(found.size, -np.inf)
    np.maximum.at(largest, cells[is_inside], values[is_known][is_inside])
    has_any = largest > -np.inf
    found[has_any] = largest[has_any]
    return found
