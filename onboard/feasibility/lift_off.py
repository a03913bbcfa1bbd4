"""How far the wind blows a vehicle aside at its lift-off."""

from __future__ import annotations

from onboard.config.fleet import Vehicle
from onboard.config.wind_limit import tilt_acceleration_m_s2

# The wind pushes a vehicle from its lift-off until its tilt balances the push: a time until it
# notices the push, then some lags until it is tilted. Fitted to lift-offs of single vehicles with
# lags of 0.15 and 0.27 s that climb with 1 m/s by a mocap, within 0.1 m. Others are blown farther
# (docs/wind.md).
_NOTICED_S = 0.2
_TILTING_LAGS = 1.5


def blown_aside_m(vehicle: Vehicle, wind_m_s: float) -> float:
    """Return about how far a vehicle is blown aside if it does not know the wind [m].

    Args:
        vehicle: the vehicle, with a known drag.
        wind_m_s: mean wind; it must leave tilt to brake with.
    Raises:
        ValueError: The wind takes all of the tilt.
    """
    push_m_s2 = vehicle.drag_1_s * wind_m_s
    braking_m_s2 = tilt_acceleration_m_s2(vehicle) - push_m_s2
    if braking_m_s2 <= 0.0:
        raise ValueError(f"A wind of {wind_m_s:.1f} m/s takes all of the tilt of {vehicle.name}.")

    pushed_s = _NOTICED_S + _TILTING_LAGS * vehicle.lag_s
    speed_m_s = push_m_s2 * pushed_s
    return 0.5 * speed_m_s * pushed_s + speed_m_s * speed_m_s / (2.0 * braking_m_s2)
