"""The distance rows (half-planes) of the law in a recorded flight, computed from the record.

The record holds the inputs of the law. Ticks contain each vehicle's predicted motion, its thrust
before the law, the ages of its neighbours' states, and the neighbour for which the law intervened.
States contain the accuracy of each estimate. From these the law's own functions compute the row
that keeps the distance from that neighbour (line D of the law). It is a half-plane ``normal . a >=
bound`` of the horizontal acceleration, before drag and disturbance are compensated. The thrust
before the law lies outside of it, and the thrust after the law inside.

Rows for turning, obstacles and the fence are left out, and so are users' own laws. The record
of states is thinned when it is read, so an accuracy may be older than the one that the law used.
"""

from __future__ import annotations

import math

import numpy as np

from groundstation.recording.recorded_flight import Flight, VehicleFlight
from onboard.avoidance.constraints import distance_row
from onboard.avoidance.half_planes import HalfPlane, unit_row
from onboard.avoidance.interface import Baseline, own_at
from onboard.avoidance.pairs import nearest_pairs
from onboard.avoidance.params import LawParams, law_params
from onboard.avoidance.prediction import Motion
from onboard.types import Neighbour, State, Thrust
from onboard.vectors import ZERO_3, Vec3

_LAW = "covey"
_SAME_TICK_S = 0.011  # half a period, and rounding


class RecordedLaw:
    """The law of a recorded flight.

    Args:
        flight: the flight; without its fleet file no row can be computed.
    """

    def __init__(self, flight: Flight) -> None:
        self._vehicles = flight.vehicles
        self._names = tuple(flight.vehicles)
        self._params: dict[str, LawParams] = {}
        if flight.fleet is None:
            return
        for name, vehicle in flight.vehicles.items():
            if name in flight.fleet.vehicles and vehicle.telemetry.law == _LAW:
                self._params[name] = law_params(flight.fleet, name, _LAW)

    def row(self, name: str, tick: int) -> HalfPlane | None:
        """Return the row of the neighbour for which the law intervenes most.

        Args:
            name: name of the vehicle.
            tick: index of its tick.

        Returns:
            The half-plane, with a normal of unit length and a bound in m/s^2; None if the law
            intervenes for no neighbour, or if values are missing in the record.
        """
        vehicle = self._vehicles[name]
        ticks = vehicle.ticks
        params = self._params.get(name)
        avoided_index = int(ticks.avoided[tick])  # -1: the law intervenes for no neighbour
        if params is None or avoided_index < 0:
            return None

        time_s = float(ticks.time_s[tick])
        neighbour = self._neighbour(vehicle, self._names[avoided_index], tick)
        if neighbour is None:
            return None

        baseline = Baseline(
            thrust=Thrust(_vector(ticks.thrust_baseline_enu_m_s2[tick])),
            compensation_enu_m_s2=ZERO_3,
            intent_enu_m_s=ZERO_3,
        )
        predicted = Motion(
            position_enu_m=_vector(ticks.predicted_position_enu_m[tick]),
            velocity_enu_m_s=_vector(ticks.predicted_velocity_enu_m_s[tick]),
        )
        position_std_m, velocity_std_m_s = _accuracy(vehicle, time_s)
        state = State(
            position_enu_m=_vector(ticks.position_enu_m[tick]),
            velocity_enu_m_s=_vector(ticks.velocity_enu_m_s[tick]),
            acceleration_enu_m_s2=ZERO_3,
            yaw_rad=0.0,
            age_s=0.0,
            position_std_m=position_std_m,
            velocity_std_m_s=velocity_std_m_s,
        )
        own = own_at(baseline, predicted, state, params)
        pairs = nearest_pairs(own, [neighbour], params).pairs
        if not own.has_motion or not pairs:
            return None
        return unit_row(distance_row(pairs[0], pairs[0].d_m, params))

    def _neighbour(self, vehicle: VehicleFlight, name: str, tick: int) -> Neighbour | None:
        """Return a neighbour as the vehicle knew it at one of its ticks."""
        ages_s = vehicle.ticks.ages_s.get(name)
        other = self._vehicles[name]
        if ages_s is None or not math.isfinite(ages_s[tick]):
            return None

        # the neighbour's tick of that time holds the values that it published
        stamp_s = float(vehicle.ticks.time_s[tick]) - float(ages_s[tick])
        index = _nearest(other, stamp_s)
        if index is None:
            return None

        ticks = other.ticks
        position_std_m, velocity_std_m_s = _accuracy(other, stamp_s)
        params = self._params.get(name)
        return Neighbour(
            position_enu_m=_vector(ticks.position_enu_m[index]),
            velocity_enu_m_s=_vector(ticks.velocity_enu_m_s[index]),
            acceleration_enu_m_s2=ZERO_3,
            predicted_position_enu_m=_vector(ticks.predicted_position_enu_m[index]),
            predicted_velocity_enu_m_s=_vector(ticks.predicted_velocity_enu_m_s[index]),
            commanded_acceleration_enu_m_s2=_vector(ticks.commanded_acceleration_enu_m_s2[index]),
            intent_enu_m_s=ZERO_3,
            age_s=float(ages_s[tick]),
            lead_time_s=math.nan if params is None else params.lead_time_s,
            position_std_m=position_std_m,
            velocity_std_m_s=velocity_std_m_s,
            crowd_count=0.0,
            is_cooperative=_is_cooperative(other, stamp_s),
            is_paper_obstacle=False,
            table_index=0,
            radius_m=0.0,
        )


def _nearest(vehicle: VehicleFlight, time_s: float) -> int | None:
    """Return the index of a vehicle's tick at a time; None if there is no tick near it."""
    times_s = vehicle.ticks.time_s
    after = int(np.searchsorted(times_s, time_s))
    near = [index for index in (after - 1, after) if 0 <= index < times_s.size]
    index = min(near, key=lambda index: abs(float(times_s[index]) - time_s), default=None)
    if index is None or abs(float(times_s[index]) - time_s) > _SAME_TICK_S:
        return None
    return index


def _accuracy(vehicle: VehicleFlight, time_s: float) -> tuple[float, float]:
    """Return the standard deviations [m, m/s] that a vehicle published last; NaN if unknown."""
    index = _last_state(vehicle, time_s)
    if index < 0:
        return math.nan, math.nan
    states = vehicle.states
    return float(states.position_std_m[index]), float(states.velocity_std_m_s[index])


def _is_cooperative(vehicle: VehicleFlight, time_s: float) -> bool:
    """Return whether a vehicle cooperates by its last state; True if it has published none."""
    index = _last_state(vehicle, time_s)
    return index < 0 or vehicle.states.is_cooperative[index] > 0.0


def _last_state(vehicle: VehicleFlight, time_s: float) -> int:
    """Return the index of the last state that a vehicle published by a time; -1 if none."""
    return int(np.searchsorted(vehicle.states.time_s, time_s, side="right")) - 1


def _vector(values: np.ndarray) -> Vec3:
    x, y, z = values
    return Vec3(float(x), float(y), float(z))
