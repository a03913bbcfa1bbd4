"""The same flights with third-party physics, the multirotors of RotorPy.

RotorPy (Folk, Paulos, Kumar: RotorPy: A Python-Based Multirotor Simulator with Aerodynamics for
Education and Research, 2023) integrates a rigid body with four rotors, their lag and drag. Every
vehicle is RotorPy's preset of PX4's simulated quadrotor (px4_sihsim_quadx), whatever the fleet's
type says about attitude and drag. It takes attitude and collective thrust, as PX4 does.

The attitude gains of the preset saturate the rotors at small errors. They are replaced by gains
that give the lag of PX4's quadrotor. Messages, estimates, wind, gusts and the law are those of all
other campaigns. There is no downwash. Of the differences of vehicles from their types there are
those of the lag and the noise of the thrust; other values of --set that change the vehicles are
refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from onboard.arrays import Array, IntArray
from onboard.config.fleet import ConfigError, SitlProfile, Vehicle
from onboard.constants import GRAVITY_M_S2
from sitl.monte_carlo.campaign_settings import SimulatedErrors
from sitl.monte_carlo.noise import FlightNoise
from sitl.monte_carlo.vehicles import (
    THRUST_NOISE_TIME_S,
    TICK_S,
    TrueMotions,
    wind_of_flight,
)
from sitl.physics import frames
from sitl.physics.wind import GUST_TIME_S, wandered

# keys of --set that have no effect here; of the table "sitl" only the noise of the thrust has one
UNUSED = frozenset(
    {"gain", "drag_mismatch", "hover_mismatch", "lag_error_s"}
    | {f"sitl.{name}" for name in SitlProfile.__struct_fields__ if name != "thrust_noise_frac"}
)
_KP_ATTITUDE_1_S2 = 200.0
_KD_ATTITUDE_1_S = 25.0  # divided by the gain above: the lag of the attitude, 0.125 s
_FACING_EAST = (0.0, 0.0, 0.0, 1.0)  # quaternion of RotorPy: x, y, z, w
# RotorPy's quaternions are x, y, z, w, and ours are w, x, y, z
_XYZW = (1, 2, 3, 0)  # index of RotorPy's components in ours
_WXYZ = (3, 0, 1, 2)  # index of our components in RotorPy's


class RotorPyPhysics:
    """RotorPy's multirotors for a batch of flights: a :class:`sitl.monte_carlo.worlds.World`."""

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
        """Let all vehicles hover at their starts; see :class:`sitl.monte_carlo.vehicles.Physics`.

        Raises:
            ConfigError: RotorPy is not installed, or vehicles fly above each other.
        """
        if wash_diameter_m > 0.0:
            raise ConfigError(
                "--physics rotorpy has no downwash, and this fleet flies vehicles above each "
                "other. Leave fleet.vertical_separation_m out."
            )
        multirotor, preset = _imported()

        flights, count = start_enu_m.shape[:2]
        self._perturbation = perturbation
        self._scripted = scripted
        self._is_scripted = np.asarray(np.isfinite(scripted).all(-1))  # (F, N)
        self._winds = [wind_of_flight(count, perturbation, seed) for seed in seeds]
        self._gust = np.zeros((flights, count, 2))  # acceleration, east and north
        self._thrust_error = np.zeros((flights, count))
        self._thrust_noise = np.array([vehicle.sitl.thrust_noise_frac for vehicle in vehicles])

        hover_frac = np.array([vehicle.hover_thrust_frac for vehicle in vehicles])
        self._newton_per_frac = preset["mass"] * GRAVITY_M_S2 / hover_frac  # (N,)
        # RotorPy's objects and states, both by flight and vehicle
        self._bodies = []
        for f in range(flights):
            bodies_of_flight = []
            for i in range(count):
                params = _differing(preset, perturbation, noise.uniform[f, i])
                bodies_of_flight.append(multirotor(params, control_abstraction="cmd_ctatt"))
            self._bodies.append(bodies_of_flight)
        self._states = [[_hovering(place, preset) for place in flight] for flight in start_enu_m]
        for f, vehicle in np.argwhere(self._is_scripted):
            self._states[f][vehicle]["v"] = scripted[f, vehicle].copy()
        self._acceleration = np.zeros_like(start_enu_m)

    def truth(self) -> TrueMotions:
        """Return the true motion of the flights under way."""
        quaternion_wxyz = self._values("q")[..., _WXYZ]
        w, x, y, z = np.moveaxis(quaternion_wxyz, -1, 0)
        yaw_rad = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return TrueMotions(
            position_enu_m=self._values("x"),
            velocity_enu_m_s=self._values("v"),
            acceleration_enu_m_s2=self._acceleration.copy(),
            quaternion_wxyz=quaternion_wxyz,
            yaw_rad=yaw_rad,
        )

    def advance(self, quaternion_wxyz: Array, thrust_frac: Array, normals: Array) -> None:
        """Fly one tick; see :class:`sitl.monte_carlo.vehicles.Physics`."""
        gust_std = self._perturbation.gust_m_s2
        self._gust = wandered(self._gust, gust_std, GUST_TIME_S, TICK_S, normals[..., 6:8])
        self._thrust_error = wandered(
            self._thrust_error,
            self._thrust_noise,
            THRUST_NOISE_TIME_S,
            TICK_S,
            normals[..., 8],
        )

        air_enu_m_s = np.zeros_like(self._acceleration)
        for f, wind in enumerate(self._winds):
            if not wind.is_calm:
                air_enu_m_s[f] = frames.swap_enu_ned(wind.step())

        before_m_s = self._values("v")
        thrust_n = thrust_frac * (1.0 + self._thrust_error) * self._newton_per_frac
        attitude_xyzw = quaternion_wxyz[..., _XYZW]
        for f, vehicle in np.ndindex(thrust_n.shape):
            if self._is_scripted[f, vehicle]:
                self._move_scripted(f, vehicle)
                continue
            state = self._states[f][vehicle]
            state["wind"] = air_enu_m_s[f, vehicle]
            state["v"][:2] += TICK_S * self._gust[f, vehicle]
            control = {"cmd_thrust": thrust_n[f, vehicle], "cmd_q": attitude_xyzw[f, vehicle]}
            body = self._bodies[f][vehicle]
            self._states[f][vehicle] = body.step(state, control, TICK_S)
        self._acceleration = (self._values("v") - before_m_s) / TICK_S

    def _move_scripted(self, f: int, vehicle: int) -> None:
        """Move a vehicle that flies straight on."""
        state = self._states[f][vehicle]
        state["v"] = self._scripted[f, vehicle].copy()
        state["x"] = state["x"] + TICK_S * state["v"]

    def _values(self, key: str) -> Array:
        """Return one entry of the states of all vehicles, (F, N, ...)."""
        return np.array([[state[key] for state in flight] for flight in self._states])

    def keep(self, flights: IntArray) -> None:
        """Keep only these rows (flights), and drop the others."""
        self._states = [self._states[k] for k in flights]
        self._bodies = [self._bodies[k] for k in flights]
        self._winds = [self._winds[k] for k in flights]
        self._gust = self._gust[flights]
        self._thrust_error = self._thrust_error[flights]
        self._acceleration = self._acceleration[flights]
        self._scripted = self._scripted[flights]
        self._is_scripted = self._is_scripted[flights]


def _imported() -> tuple[Any, dict[str, Any]]:
    """Return RotorPy's class of multirotors, and its preset of PX4's quadrotor."""
    try:
        from rotorpy.vehicles.multirotor import Multirotor
        from rotorpy.vehicles.px4_sihsim_quadx_params import quad_params
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"--physics rotorpy needs the package 'rotorpy' ({error}). Install it: "
            "pip install 'rotorpy>=3.0,<4'"
        ) from None
    return Multirotor, quad_params


def _differing(
    preset: dict[str, Any], perturbation: SimulatedErrors, draws: Array
) -> dict[str, Any]:
    """Return the parameters of one vehicle: the preset, with its lag times a drawn factor.

    The factor is that of the vehicles in :mod:`sitl.monte_carlo.vehicles`.
    """
    lag_draw, *_ = draws.tolist()
    lag_factor = 1.0 + perturbation.lag_mismatch * lag_draw
    return {
        **preset,
        "kp_att": _KP_ATTITUDE_1_S2,
        "kd_att": _KD_ATTITUDE_1_S * lag_factor,
        "tau_m": preset["tau_m"] * lag_factor,
    }


def _hovering(start_enu_m: Array, preset: dict[str, Any]) -> dict[str, Array]:
    """Return the state of a vehicle that hovers."""
    rotors = preset["num_rotors"]
    force_of_rotor_n = preset["mass"] * GRAVITY_M_S2 / rotors
    speed_rad_s = np.sqrt(force_of_rotor_n / preset["k_eta"])
    return {
        "x": np.array(start_enu_m),
        "v": np.zeros(3),
        "q": np.array(_FACING_EAST),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": np.full(rotors, speed_rad_s),
    }
