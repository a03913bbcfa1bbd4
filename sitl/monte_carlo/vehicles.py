"""The emulator's vehicles for F flights of N at once, each a little different from what its type
says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from onboard.arrays import Array, IntArray
from onboard.config.fleet import Vehicle
from sitl.monte_carlo.noise import Noise
from sitl.monte_carlo.settings import Perturbation
from sitl.physics import frames
from sitl.physics.contacts import Downwash, pushed_down_each
from sitl.physics.vehicle import STEP_S, Commands, VehicleProfile, Vehicles

TICK_S = 0.02
_STEPS = round(TICK_S / STEP_S)
_GUST_TIME_S = 1.0
_THRUST_NOISE_TIME_S = 0.1
_EAST_RAD = 0.5 * math.pi  # heading of body x along fleet x


@dataclass(frozen=True, slots=True)
class Truth:
    """True motion, fleet ENU and FLU: (F, N, 3), (F, N, 4) and (F, N)."""

    position_enu_m: Array
    velocity_enu_m_s: Array
    acceleration_enu_m_s2: Array
    quaternion_wxyz: Array
    yaw_rad: Array


class Physics:
    """``sitl.physics.vehicle`` for a batch of flights; vehicles begin hovering at their starts.

    Gusts and thrust noise are drawn here, per flight, and act on the emulator's vehicles from
    outside. A vehicle with a ``scripted`` velocity (F, N, 3), not NaN, is no multirotor: it moves
    straight on. Bodies of a ``wash_diameter_m`` push down on whoever flies below them; 0: nobody
    does.
    """

    def __init__(
        self,
        vehicles: list[Vehicle],
        start_enu_m: Array,
        scripted: Array,
        noise: Noise,
        perturbation: Perturbation,
        wash_diameter_m: float = 0.0,
    ) -> None:
        flights, count = start_enu_m.shape[:2]
        self._p, self._wash_diameter_m = perturbation, wash_diameter_m
        self._flights, self._count = np.arange(flights), count
        profiles = [
            _profile(vehicle, perturbation, noise.uniform[f, i])
            for f in range(flights)
            for i, vehicle in enumerate(vehicles)
        ]
        self._vehicles = Vehicles(
            profiles,
            frames.swap_enu_ned(start_enu_m).reshape(-1, 3),
            np.full(flights * count, _EAST_RAD),
            seed=0,
        )
        self._thrust_noise = np.array([vehicle.sitl.thrust_noise_frac for vehicle in vehicles])
        bias = (
            np.radians([vehicle.sitl.tilt_bias_deg for vehicle in vehicles])[:, None]
            * noise.uniform[..., 4:6]
        )
        self._vehicles.tilt_bias_rad = bias.reshape(-1, 2)
        self._vehicles.states.thrust_frac[:] = [profile.hover_thrust_frac for profile in profiles]
        self._commands = Commands.level(np.full(flights * count, _EAST_RAD))
        self._commands.motors_on[:] = True
        self._commands.thrust_frac[:] = self._vehicles.states.thrust_frac
        self._gust = np.zeros((flights, count, 2))
        self._thrust_error = np.zeros((flights, count))
        self._scripted = scripted
        self._is_scripted = np.asarray(np.isfinite(scripted).all(-1))
        self._start_ned_m = self._vehicles.states.position_ned_m.copy()
        first = self._is_scripted.reshape(-1)
        self._vehicles.states.velocity_ned_m_s[first] = frames.swap_enu_ned(
            scripted.reshape(-1, 3)[first]
        )

    def truth(self) -> Truth:
        """Of the flights that go on."""
        s = self._vehicles.states
        acceleration = self._of(s.acceleration_ned_m_s2)
        acceleration[..., :2] += self._gust[..., ::-1]
        acceleration = frames.swap_enu_ned(acceleration)
        position, velocity = (
            frames.swap_enu_ned(self._of(v)) for v in (s.position_ned_m, s.velocity_ned_m_s)
        )
        attitude = frames.enu_flu_from_ned_frd(self._of(s.attitude))
        return Truth(
            position, velocity, acceleration, attitude, frames.wrap(_EAST_RAD - self._of(s.yaw_rad))
        )

    def advance(self, quaternion_wxyz: Array, thrust_frac: Array, normals: Array) -> None:
        """Fly one tick under attitude setpoints (F, N, 4) and (F, N)."""
        self._gust = wandered(self._gust, self._p.gust_m_s2, _GUST_TIME_S, normals[..., 6:8])
        self._thrust_error = wandered(
            self._thrust_error, self._thrust_noise, _THRUST_NOISE_TIME_S, normals[..., 8]
        )
        all_, s = self._vehicles, self._vehicles.states
        quaternion = frames.enu_flu_from_ned_frd(quaternion_wxyz)  # its own inverse
        shape = (-1, self._count)
        self._commands.attitude.reshape(*shape, 4)[self._flights] = quaternion
        self._commands.thrust_frac.reshape(shape)[self._flights] = thrust_frac * (
            1.0 + self._thrust_error
        )
        kick = STEP_S * self._gust[..., ::-1]  # north, east
        push = STEP_S * self._pushed_down()
        for _ in range(_STEPS):
            velocity = s.velocity_ned_m_s.reshape(*shape, 3)
            velocity[self._flights, :, :2] += kick
            velocity[self._flights, :, 2] += push
            all_.step(self._commands)
        if self._is_scripted.any():
            self._move_scripted()

    def _pushed_down(self) -> Array | float:
        """Return the acceleration (F, N) by the air of those above, as the emulator's downwash has
        it.
        """
        diameter_m, wash = self._wash_diameter_m, Downwash()
        if diameter_m <= 0.0:
            return 0.0
        place = self._of(self._vehicles.states.position_ned_m)
        return pushed_down_each(place, diameter_m, wash.push_m_s2, wash.spread)

    def _move_scripted(self) -> None:
        s = self._vehicles.states
        flight, vehicle = np.nonzero(self._is_scripted)
        row = self._flights[flight] * self._count + vehicle
        velocity = frames.swap_enu_ned(self._scripted[flight, vehicle])
        s.velocity_ned_m_s[row] = velocity
        s.position_ned_m[row] = self._start_ned_m[row] + velocity * (self._vehicles.steps * STEP_S)

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only; the others are carried along unwatched."""
        self._flights = self._flights[flights]
        self._gust, self._thrust_error = self._gust[flights], self._thrust_error[flights]
        self._scripted, self._is_scripted = self._scripted[flights], self._is_scripted[flights]

    def _of(self, values: Array) -> Array:
        return np.asarray(values.reshape(-1, self._count, *values.shape[1:])[self._flights])


def _profile(vehicle: Vehicle, p: Perturbation, draws: Array) -> VehicleProfile:
    """Return the profile of one vehicle; ``draws`` (8,) uniform in [-1, 1). Dead time and 1/wn are
    stretched alike.
    """
    stretch = 1.0 + p.lag_mismatch * float(draws[0])
    return VehicleProfile(
        mass_kg=vehicle.mass_kg,
        hover_thrust_frac=vehicle.hover_thrust_frac * (1.0 + p.hover_mismatch * float(draws[3])),
        attitude_delay_s=vehicle.attitude_delay_s * stretch + p.lag_error_s,
        attitude_wn_rad_s=vehicle.attitude_wn_rad_s / stretch,
        attitude_zeta=vehicle.attitude_zeta,
        drag_1_s=vehicle.drag_1_s * (1.0 + p.drag_mismatch * float(draws[2])),
        static_gain=vehicle.sitl.static_gain * (1.0 + p.gain * float(draws[1])),
        yaw_wn_rad_s=vehicle.sitl.yaw_wn_rad_s,
        thrust_delay_s=vehicle.sitl.thrust_delay_s,
        motor_lag_s=vehicle.sitl.motor_lag_s,
        thrust_curve_frac=vehicle.sitl.thrust_curve_frac,
        max_tilt_rate_deg_s=vehicle.sitl.max_tilt_rate_deg_s,
        max_yaw_rate_deg_s=vehicle.sitl.max_yaw_rate_deg_s,
    )


def wandered(value: Array, std: Array | float, time_s: float, normals: Array) -> Array:
    """Return an Ornstein-Uhlenbeck process one tick later; with a correlation time of 0 white
    noise.
    """
    keep = math.exp(-TICK_S / time_s) if time_s > 0.0 else 0.0
    return keep * value + std * math.sqrt(1.0 - keep * keep) * normals
