"""The emulator's vehicles for F flights of N; each differs a little from its vehicle type."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.arrays import Array, IntArray
from onboard.config.fleet import Vehicle
from sitl.monte_carlo.campaign_settings import SimulatedErrors
from sitl.monte_carlo.noise import FlightNoise
from sitl.physics import frames
from sitl.physics.contacts import Downwash, pushed_down_each
from sitl.physics.vehicle import STEP_S, Commands, VehicleProfile, Vehicles
from sitl.physics.wind import GUST_TIME_S, Wind, WindSettings, wandered

TICK_S = 0.02
_STEPS = round(TICK_S / STEP_S)
THRUST_NOISE_TIME_S = 0.1
_WIND_RISES_S = 3.0
_EAST_RAD = 0.5 * math.pi  # heading of a vehicle whose body x axis points along the fleet's x axis


@dataclass(frozen=True, slots=True)
class TrueMotions:
    """True motion of the flights under way, fleet ENU and FLU."""

    position_enu_m: Array  # (F, N, 3)
    velocity_enu_m_s: Array  # (F, N, 3)
    acceleration_enu_m_s2: Array  # (F, N, 3)
    quaternion_wxyz: Array  # (F, N, 4)
    yaw_rad: Array  # (F, N)


# Keys of --set that only a flight with agents uses: the vehicles of a campaign have no motors of
# their own.
UNUSED = frozenset(
    ("sitl.inertia_kg_m2", "sitl.arm_m", "sitl.attitude_integral_s", "sitl.gust_std_m_s2")
)


class Physics:
    """``sitl.physics.vehicle`` for a batch of flights; vehicles begin hovering at their starts.

    Wind, gusts and thrust noise are drawn here for each flight, and applied to the emulator's
    vehicles. The emulator's arrays hold the vehicles of all flights one after the other, (F N,
    ...).
    """

    def __init__(
        self,
        vehicles: list[Vehicle],
        start_enu_m: Array,
        scripted: Array,
        noise: FlightNoise,
        perturbation: SimulatedErrors,
        seeds: Sequence[int],
        wash_diameter_m: float = 0.0,
    ) -> None:
        """Let all vehicles hover at their starts.

        Args:
            vehicles: the N vehicles, the same in each flight.
            start_enu_m: starts (F, N, 3).
            scripted: velocities (F, N, 3) [m/s]; a vehicle whose velocity is not NaN is not a
                multirotor and moves straight on at that velocity.
            noise: constant random numbers of each vehicle.
            perturbation: differences of vehicles from their types, wind and gusts.
            seeds: seeds (F,) of the flights, for their wind.
            wash_diameter_m: diameter of the bodies whose downwash pushes vehicles below them
                down; 0: no downwash.
        """
        flights, count = start_enu_m.shape[:2]
        self._perturbation = perturbation
        self._wash_diameter_m = wash_diameter_m
        self._flights = np.arange(flights)  # index in the batch of each flight under way
        self._count = count

        profiles = []
        for flight in range(flights):
            for index, vehicle in enumerate(vehicles):
                draws = noise.uniform[flight, index]
                profiles.append(_profile(vehicle, perturbation, draws))

        headings = np.full(flights * count, _EAST_RAD)
        start_ned_m = frames.swap_enu_ned(start_enu_m).reshape(-1, 3)
        # this seed has no effect: the profiles have no noise and no bias, which are drawn here
        self._vehicles = Vehicles(profiles, start_ned_m, headings, seed=0)
        states = self._vehicles.states

        max_bias_rad = np.radians([vehicle.sitl.tilt_bias_deg for vehicle in vehicles])  # (N,)
        bias_rad = max_bias_rad[:, None] * noise.uniform[..., 4:6]  # (F, N, 2)
        self._vehicles.tilt_bias_rad = bias_rad.reshape(-1, 2)

        states.thrust_frac[:] = [profile.hover_thrust_frac for profile in profiles]
        self._commands = Commands.level(np.full(flights * count, _EAST_RAD))
        self._commands.motors_on[:] = True
        self._commands.thrust_frac[:] = states.thrust_frac

        self._winds = [wind_of_flight(count, perturbation, seed) for seed in seeds]
        self._gust = np.zeros((flights, count, 2))  # acceleration, east and north
        self._thrust_noise = np.array([vehicle.sitl.thrust_noise_frac for vehicle in vehicles])
        self._thrust_error = np.zeros((flights, count))

        self._scripted = scripted
        self._is_scripted = np.asarray(np.isfinite(scripted).all(-1))  # (F, N)
        self._start_ned_m = states.position_ned_m.copy()
        rows = self._is_scripted.reshape(-1)
        states.velocity_ned_m_s[rows] = frames.swap_enu_ned(scripted.reshape(-1, 3)[rows])

    def truth(self) -> TrueMotions:
        """Return the true motion of the flights under way."""
        states = self._vehicles.states
        acceleration_ned = self._in_the_air(states.acceleration_ned_m_s2)
        acceleration_ned[..., :2] += self._gust[..., ::-1]  # north, east from east, north

        return TrueMotions(
            position_enu_m=frames.swap_enu_ned(self._in_the_air(states.position_ned_m)),
            velocity_enu_m_s=frames.swap_enu_ned(self._in_the_air(states.velocity_ned_m_s)),
            acceleration_enu_m_s2=frames.swap_enu_ned(acceleration_ned),
            quaternion_wxyz=frames.enu_flu_from_ned_frd(self._in_the_air(states.attitude)),
            yaw_rad=frames.wrap(_EAST_RAD - self._in_the_air(states.yaw_rad)),
        )

    def advance(self, quaternion_wxyz: Array, thrust_frac: Array, normals: Array) -> None:
        """Fly one tick.

        Args:
            quaternion_wxyz: attitudes (F, N, 4) of the attitude setpoints.
            thrust_frac: thrusts (F, N) of the attitude setpoints.
            normals: standard normal numbers (F, N, 9), of which the first six are for the sensors.
        """
        self._blow()
        gust_std = self._perturbation.gust_m_s2
        self._gust = wandered(self._gust, gust_std, GUST_TIME_S, TICK_S, normals[..., 6:8])
        self._thrust_error = wandered(
            self._thrust_error,
            self._thrust_noise,
            THRUST_NOISE_TIME_S,
            TICK_S,
            normals[..., 8],
        )

        # Each `reshape` returns a view of the emulator's array, by flight and vehicle. Values that
        # are written to the view are in the emulator's array.
        by_flight = (-1, self._count)
        attitude = self._commands.attitude.reshape(*by_flight, 4)
        # The conversion is its own inverse: here it gives NED, FRD from ENU, FLU.
        attitude[self._flights] = frames.enu_flu_from_ned_frd(quaternion_wxyz)
        throttle = self._commands.thrust_frac.reshape(by_flight)
        throttle[self._flights] = thrust_frac * (1.0 + self._thrust_error)

        gust_step_m_s = STEP_S * self._gust[..., ::-1]  # north, east from east, north
        downwash_step_m_s = STEP_S * self._pushed_down()
        for _ in range(_STEPS):
            velocity = self._vehicles.states.velocity_ned_m_s.reshape(*by_flight, 3)
            velocity[self._flights, :, :2] += gust_step_m_s
            velocity[self._flights, :, 2] += downwash_step_m_s
            self._vehicles.step(self._commands)

        if self._is_scripted.any():
            self._move_scripted()

    def _blow(self) -> None:
        """Advance the wind by one tick."""
        air = self._vehicles.air_ned_m_s.reshape(-1, self._count, 3)
        for flight, wind in zip(self._flights, self._winds, strict=True):
            if not wind.is_calm:
                air[flight] = wind.step()

    def _pushed_down(self) -> Array | float:
        """Return the downward acceleration (F, N) from the downwash of vehicles above."""
        if self._wash_diameter_m <= 0.0:
            return 0.0
        wash = Downwash()
        position_ned_m = self._in_the_air(self._vehicles.states.position_ned_m)
        return pushed_down_each(position_ned_m, self._wash_diameter_m, wash.push_m_s2, wash.spread)

    def _move_scripted(self) -> None:
        """Set position and velocity of the vehicles that move straight on."""
        states = self._vehicles.states
        flight, vehicle = np.nonzero(self._is_scripted)
        row = self._flights[flight] * self._count + vehicle

        velocity = frames.swap_enu_ned(self._scripted[flight, vehicle])
        time_s = self._vehicles.steps * STEP_S
        states.velocity_ned_m_s[row] = velocity
        states.position_ned_m[row] = self._start_ned_m[row] + velocity * time_s

    def keep(self, flights: IntArray) -> None:
        """Keep only the flights in these rows; the emulator still moves the others, unused."""
        self._flights = self._flights[flights]
        self._winds = [self._winds[row] for row in flights]
        self._gust = self._gust[flights]
        self._thrust_error = self._thrust_error[flights]
        self._scripted = self._scripted[flights]
        self._is_scripted = self._is_scripted[flights]

    def _in_the_air(self, values: Array) -> Array:
        """Return a copy (F, N, ...) of the emulator's values for the flights under way."""
        by_flight = values.reshape(-1, self._count, *values.shape[1:])
        return np.asarray(by_flight[self._flights])


def wind_of_flight(count: int, perturbation: SimulatedErrors, seed: int) -> Wind:
    """Return the wind of one flight; the seed decides its direction."""
    rng = np.random.default_rng([seed, 6])  # different random numbers from the scenario's
    bearing_rad = float(rng.uniform(-math.pi, math.pi))
    speed_m_s = perturbation.wind_m_s
    settings = WindSettings(
        gust_std_m_s=perturbation.gust_m_s,
        gust_time_s=perturbation.gust_s,
    )
    wind = Wind(count, settings, seed=seed, step_s=TICK_S)

    # Flights do not begin with a sudden wind. It rises within the first seconds.
    if speed_m_s > 0.0:
        mean = (speed_m_s * math.cos(bearing_rad), speed_m_s * math.sin(bearing_rad), 0.0)
        wind.change_mean(mean, _WIND_RISES_S)
    return wind


def _profile(vehicle: Vehicle, perturbation: SimulatedErrors, draws: Array) -> VehicleProfile:
    """Return the profile of one vehicle; ``draws`` (8,) are uniform in [-1, 1)."""
    lag_draw, gain_draw, drag_draw, hover_draw, *_ = draws.tolist()
    # the same factor for the dead time and for 1/wn
    lag_factor = 1.0 + perturbation.lag_mismatch * lag_draw
    gain_factor = 1.0 + perturbation.gain * gain_draw
    drag_factor = 1.0 + perturbation.drag_mismatch * drag_draw
    hover_factor = 1.0 + perturbation.hover_mismatch * hover_draw

    return VehicleProfile(
        mass_kg=vehicle.mass_kg,
        hover_thrust_frac=vehicle.hover_thrust_frac * hover_factor,
        attitude_delay_s=vehicle.attitude_delay_s * lag_factor + perturbation.lag_error_s,
        attitude_wn_rad_s=vehicle.attitude_wn_rad_s / lag_factor,
        attitude_zeta=vehicle.attitude_zeta,
        drag_1_s=vehicle.drag_1_s * drag_factor,
        static_gain=vehicle.sitl.static_gain * gain_factor,
        yaw_wn_rad_s=vehicle.sitl.yaw_wn_rad_s,
        thrust_delay_s=vehicle.sitl.thrust_delay_s,
        motor_lag_s=vehicle.sitl.motor_lag_s,
        thrust_curve_frac=vehicle.sitl.thrust_curve_frac,
        max_tilt_rate_deg_s=vehicle.sitl.max_tilt_rate_deg_s,
        max_yaw_rate_deg_s=vehicle.sitl.max_yaw_rate_deg_s,
    )
