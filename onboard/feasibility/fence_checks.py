"""The finding about braking before the edges of allowed and forbidden areas. Pure."""

from __future__ import annotations

import math

from onboard.avoidance.params import law_params
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.flight_space import flight_space_of
from onboard.config.wind_limit import GUST_SHARE, GUSTY, tilt_acceleration_m_s2, wind_limit_m_s
from onboard.feasibility.finding import Finding, at_least

_MIN_BRAKE_M_S2 = 0.05  # avoids a division by zero if the wind takes all of the tilt
_GUST_SIGMAS = 3.0  # strongest gust, in standard deviations
# errors of lag, gain and position, measured in light wind with the weak drones of paper.toml
_ERRORS_M = 0.10

# A buffer that is too narrow is a warning and never a refusal, because the whole buffer is needed
# only in a wind as strong as max_wind_m_s.
_NEVER_REFUSED_M = -math.inf


def braking_room_m(fleet: FleetConfig, vehicle: Vehicle) -> float:
    """Return how far a vehicle in wind may overshoot the point where the law stops it [m].

    The law's row for an edge brakes early enough from the top speed, and includes the lag. So in
    calm air only the errors of lag, gain and position add to the stopping distance. Wind towards
    the edge takes up part of the tilt. If the remaining tilt brakes less than the row requires, the
    stopping distance grows. A gust pushes the vehicle for its lag before the vehicle reacts.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
    """
    params = law_params(fleet, vehicle.name)
    speed_m_s = params.top_speed_m_s
    required_m_s2 = params.gains.static_kappa_1_1_s * speed_m_s

    push_m_s2 = 0.0
    gust_m_s2 = 0.0
    wind_m_s = wind_limit_m_s(fleet, vehicle)
    if math.isfinite(wind_m_s):
        push_m_s2 = GUSTY * vehicle.drag_1_s * wind_m_s
        gust_m_s2 = _GUST_SIGMAS * GUST_SHARE * vehicle.drag_1_s * wind_m_s

    available_m_s2 = max(_MIN_BRAKE_M_S2, tilt_acceleration_m_s2(vehicle) - push_m_s2)
    longer_m = 0.0
    if available_m_s2 < required_m_s2:
        longer_m = 0.5 * speed_m_s * speed_m_s * (1.0 / available_m_s2 - 1.0 / required_m_s2)

    # the vehicle gains velocity during its lag, and drifts until kappa_2 has removed that velocity
    gust_m_s = gust_m_s2 * vehicle.lag_s
    return _ERRORS_M + longer_m + gust_m_s * (0.5 * vehicle.lag_s + 1.0 / params.gains.kappa_2_1_s)


def braking_in_wind(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Check that the narrowest buffer suffices for braking in the strongest wind.

    Args:
        fleet: the fleet file, with fences.
        vehicle: one of its vehicles.
    """
    narrowest = min(flight_space_of(fleet).areas, key=lambda area: area.buffer_m)
    wind_m_s = wind_limit_m_s(fleet, vehicle)
    air = "in still air"
    if math.isfinite(wind_m_s):
        air = f"in the {wind_m_s:.1f} m/s of its max_wind_m_s, with gusts,"

    return at_least(
        name="braking before fences",
        value=narrowest.buffer_m + fleet.law.fence_margin_m,
        bound=braking_room_m(fleet, vehicle),
        unit="m",
        sentence=(
            f"The law brakes <value> before the edge of the fence '{narrowest.name}' (buffer_m "
            f"and law.fence_margin_m); {air} {vehicle.name} needs <relation> <bound>"
        ),
        remedy="Widen buffer_m, or lower max_wind_m_s or max_speed_m_s.",
        refuse_below=_NEVER_REFUSED_M,
    )
