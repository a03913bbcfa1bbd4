"""Model of the vehicle for rollouts, with its own errors, seeded.

A point mass under a thrust whose direction follows the attitude setpoint through dead time and a
second-order lag (with a static gain and a bias that the control does not know) and whose size
follows the throttle through the motors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.arrays import Array
from onboard.config.fleet import Vehicle
from onboard.rollout.rows import Rows
from onboard.types import GRAVITY_M_S2, TICK_S

_SUBSTEPS = 4
_NOISE_BLOCK_TICKS = 100


@dataclass(frozen=True, slots=True)
class Plant:
    """Properties of a vehicle as they really are; the control knows the configured part of them at
    best.
    """

    wn_rad_s: float
    zeta: float
    delay_s: float
    drag_1_s: float
    hover_thrust_frac: float
    static_gain: float = 1.0
    tilt_bias_deg: float = 0.0
    motor_lag_s: float = 0.05


@dataclass(frozen=True, slots=True)
class Perturbation:
    """Errors of a flight, as a lab has them."""

    lag_share: float = 0.10  # half widths of uniform errors, of the vehicle's own values
    gain_share: float = 0.05
    drag_share: float = 0.15
    hover_share: float = 0.03
    gust_m_s2: float = 0.1  # standard deviation per axis
    gust_time_s: float = 1.5  # correlation time
    mocap_noise_m: float = 0.003
    mocap_delay_ticks: int = 1
    message_delay_ticks: int = 2
    message_loss: float = 0.10  # share of the messages
    start_m: float = 0.05  # standard deviation of the start positions, horizontal


def plant_of(vehicle: Vehicle) -> Plant:
    """Return the plant that a vehicle's configuration describes, the emulator's part of it
    included.
    """
    return Plant(
        wn_rad_s=vehicle.attitude_wn_rad_s,
        zeta=vehicle.attitude_zeta,
        delay_s=vehicle.attitude_delay_s,
        drag_1_s=vehicle.drag_1_s,
        hover_thrust_frac=vehicle.hover_thrust_frac,
        static_gain=vehicle.sitl.static_gain,
        tilt_bias_deg=vehicle.sitl.tilt_bias_deg,
        motor_lag_s=vehicle.sitl.motor_lag_s,
    )


class Noise:
    """Random numbers of F flights, each from its own seed, in blocks of ticks."""

    def __init__(self, seeds: Sequence[int], count: int) -> None:
        self.generators = [np.random.default_rng(seed) for seed in seeds]
        self.count = count
        self.constants = np.stack(
            [rng.uniform(-1.0, 1.0, (8, count)) for rng in self.generators], axis=1
        )
        self.starts = np.stack([rng.normal(size=(count, 2)) for rng in self.generators])
        self.tick = _NOISE_BLOCK_TICKS

    def constant(self, index: int) -> Array:
        """Return the uniform numbers (F, N) in [-1, 1) of one property."""
        return np.asarray(self.constants[index])

    def next(self) -> tuple[Array, Array, Array]:
        """Return standard normal numbers for mocap and gusts (F, N, 3), and uniform ones for links
        (F, N, N).
        """
        if self.tick == _NOISE_BLOCK_TICKS:
            n, block = self.count, _NOISE_BLOCK_TICKS
            self.normal = np.stack(
                [rng.standard_normal((block, 2, n, 3)) for rng in self.generators], axis=2
            )
            self.uniform = np.stack([rng.random((block, n, n)) for rng in self.generators], axis=1)
            self.tick = 0
        k, self.tick = self.tick, self.tick + 1
        return self.normal[k, 0], self.normal[k, 1], self.uniform[k]


class VehicleModels:
    """True motion of F x N vehicles; the one mutable thing in here."""

    def __init__(
        self, start: Array, plants: Sequence[Plant], noise: Noise, perturbation: Perturbation
    ) -> None:
        shape = start.shape[:-1]
        p = perturbation

        def values(name: str) -> Array:
            return np.broadcast_to(
                np.array([getattr(plant, name) for plant in plants], dtype=np.float64), shape
            )

        self.position, self.velocity = start.copy(), np.zeros_like(start)
        self.wn = values("wn_rad_s") * (1.0 + p.lag_share * noise.constant(0))
        self.zeta = values("zeta")
        self.gain = values("static_gain") * (1.0 + p.gain_share * noise.constant(1))
        self.drag = values("drag_1_s") * (1.0 + p.drag_share * noise.constant(2))
        self.hover = values("hover_thrust_frac") * (1.0 + p.hover_share * noise.constant(3))
        bias = np.tan(np.radians(values("tilt_bias_deg")))
        self.bias = np.stack(
            [bias * np.sign(noise.constant(4)), bias * np.sign(noise.constant(5))], axis=-1
        )
        self.motor_lag = values("motor_lag_s")
        self.delay = [round(plant.delay_s * _SUBSTEPS / TICK_S) for plant in plants]
        self.slope = np.zeros((*shape, 2))
        self.slope_rate = np.zeros((*shape, 2))
        self.thrust = np.full(shape, GRAVITY_M_S2)
        self.gust = np.zeros_like(start)
        depth = max(self.delay) + 1
        self.queue = np.zeros((depth, *shape, 3))
        self.queue[..., 2] = np.broadcast_to(values("hover_thrust_frac"), (depth, *shape))

    @property
    def quaternion_wxyz(self) -> Array:
        """Attitudes (F, N, 4), FLU to ENU, with the heading to the east."""
        q = np.zeros((*self.thrust.shape, 4))
        q[..., 0] = 1.0 + np.sqrt(1.0 + np.einsum("...c,...c->...", self.slope, self.slope))
        q[..., 1], q[..., 2] = -self.slope[..., 1], self.slope[..., 0]
        return np.asarray(q / np.sqrt(np.einsum("...c,...c->...", q, q))[..., None])

    def advance(self, attitude: Rows, gust_noise: Array, p: Perturbation, dt_s: float) -> None:
        """One control tick under attitude setpoints (F, N)."""
        q = attitude["quaternion_wxyz"]
        up_x = 2.0 * (q[..., 1] * q[..., 3] + q[..., 0] * q[..., 2])
        up_y = 2.0 * (q[..., 2] * q[..., 3] - q[..., 0] * q[..., 1])
        up_z = 1.0 - 2.0 * (q[..., 1] ** 2 + q[..., 2] ** 2)
        sent = np.stack([up_x / up_z, up_y / up_z, attitude["thrust_frac"]], axis=-1)
        keep = math.exp(-dt_s / p.gust_time_s)
        self.gust = keep * self.gust + p.gust_m_s2 * math.sqrt(1.0 - keep * keep) * gust_noise
        h = dt_s / _SUBSTEPS
        blend = 1.0 - np.exp(-h / self.motor_lag)
        for _ in range(_SUBSTEPS):
            self.queue = np.concatenate([sent[None], self.queue[:-1]])
            delayed = np.stack(
                [self.queue[delay, :, n] for n, delay in enumerate(self.delay)], axis=1
            )
            setpoint = self.gain[..., None] * delayed[..., :2] + self.bias
            damping = (2.0 * self.zeta * self.wn)[..., None] * self.slope_rate
            push = self.wn[..., None] ** 2 * (setpoint - self.slope) - damping
            self.slope_rate = self.slope_rate + h * push
            self.slope = self.slope + h * self.slope_rate
            self.thrust = self.thrust + blend * (
                delayed[..., 2] / self.hover * GRAVITY_M_S2 - self.thrust
            )
            length = np.sqrt(1.0 + np.einsum("...c,...c->...", self.slope, self.slope))
            along = (self.thrust / length)[..., None]
            force = np.concatenate([along * self.slope, along], axis=-1)
            acceleration = force - self.drag[..., None] * self.velocity + self.gust
            acceleration[..., 2] -= GRAVITY_M_S2
            self.position = self.position + h * self.velocity + 0.5 * h * h * acceleration
            self.velocity = self.velocity + h * acceleration
