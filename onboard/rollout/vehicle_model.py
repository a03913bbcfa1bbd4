"""Model of the vehicles' motion in rollouts, with errors drawn at random from a seed.

Each vehicle is a point mass moved by its thrust. The direction of the thrust follows the attitude
setpoint through a dead time and a second-order lag, with a static gain and a bias that the control
does not know. The magnitude of the thrust follows the throttle through the motors' lag.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.arrays import Array
from onboard.config.fleet import Vehicle
from onboard.constants import GRAVITY_M_S2
from onboard.rollout.rows import Rows
from onboard.types import TICK_S

_SUBSTEPS = 4  # integration steps of the motion in one control tick
_NOISE_BLOCK_TICKS = 100  # random numbers are drawn for this many ticks at once

# indices of a vehicle's constant random numbers; the last two are not used, but drawing fewer
# would change all later numbers of a seed
_LAG, _GAIN, _DRAG, _HOVER, _BIAS_EAST, _BIAS_NORTH = range(6)
_CONSTANT_COUNT = 8


@dataclass(frozen=True, slots=True)
class Plant:
    """True properties of a vehicle. The control knows only those in the fleet file."""

    # response of the tilt to its setpoint: natural frequency, damping ratio, dead time
    wn_rad_s: float
    zeta: float
    delay_s: float

    drag_1_s: float  # deceleration divided by speed
    hover_thrust_frac: float
    static_gain: float = 1.0  # steady-state slope of the thrust, divided by its setpoint
    tilt_bias_deg: float = 0.0
    motor_lag_s: float = 0.05  # time constant of the motors


@dataclass(frozen=True, slots=True)
class Perturbation:
    """Sizes of the errors in a flight; the defaults are those of a lab."""

    # half widths of uniform errors, as shares of the plant's values
    lag_share: float = 0.10
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
    """Return the plant that the fleet file, with its table ``sitl``, describes for a vehicle."""
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
    """Random numbers of F flights with N vehicles each. Every flight draws from its own seed."""

    def __init__(self, seeds: Sequence[int], count: int) -> None:
        self.generators = [np.random.default_rng(seed) for seed in seeds]
        self.count = count

        constants = [rng.uniform(-1.0, 1.0, (_CONSTANT_COUNT, count)) for rng in self.generators]
        self.constants = np.stack(constants, axis=1)
        self.starts = np.stack(
            [rng.normal(size=(count, 2)) for rng in self.generators]
        )  # (F, N, 2)
        # index of the next tick in the block of random numbers; a new block is drawn at its end
        self.tick = _NOISE_BLOCK_TICKS

    def constant(self, index: int) -> Array:
        """Return uniform numbers (F, N) in [-1, 1), which stay the same during a flight."""
        return np.asarray(self.constants[index])

    def next(self) -> tuple[Array, Array, Array]:
        """Return the numbers of one tick.

        Returns:
            standard normal numbers for the mocap and for the gusts, both (F, N, 3), and uniform
            numbers in [0, 1) for the links between vehicles (F, N, N).
        """
        if self.tick == _NOISE_BLOCK_TICKS:
            self._draw_block()
            self.tick = 0

        k = self.tick
        self.tick += 1
        return self.normal[k, 0], self.normal[k, 1], self.uniform[k]

    def _draw_block(self) -> None:
        ticks = _NOISE_BLOCK_TICKS
        n = self.count
        normal = [rng.standard_normal((ticks, 2, n, 3)) for rng in self.generators]
        uniform = [rng.random((ticks, n, n)) for rng in self.generators]
        self.normal = np.stack(normal, axis=2)  # (ticks, mocap or gusts, F, N, 3)
        self.uniform = np.stack(uniform, axis=1)  # (ticks, F, N, N)


class VehicleModels:
    """True motion of F x N vehicles. :meth:`advance` changes it in place."""

    def __init__(
        self, start: Array, plants: Sequence[Plant], noise: Noise, perturbation: Perturbation
    ) -> None:
        shape = start.shape[:-1]
        p = perturbation

        def values(name: str) -> Array:
            by_vehicle = np.array([getattr(plant, name) for plant in plants], dtype=np.float64)
            return np.broadcast_to(by_vehicle, shape)

        # motion
        self.position = start.copy()
        self.velocity = np.zeros_like(start)
        self.drag = values("drag_1_s") * (1.0 + p.drag_share * noise.constant(_DRAG))
        self.gust = np.zeros_like(start)

        # horizontal response: the slopes of the thrust to east and north (tangents of the tilt)
        # follow the slopes of the attitude setpoint
        self.wn = values("wn_rad_s") * (1.0 + p.lag_share * noise.constant(_LAG))
        self.zeta = values("zeta")
        self.gain = values("static_gain") * (1.0 + p.gain_share * noise.constant(_GAIN))
        bias = np.tan(np.radians(values("tilt_bias_deg")))
        bias_x = bias * np.sign(noise.constant(_BIAS_EAST))
        bias_y = bias * np.sign(noise.constant(_BIAS_NORTH))
        self.bias = np.stack([bias_x, bias_y], axis=-1)
        self.slope = np.zeros((*shape, 2))
        self.slope_rate = np.zeros((*shape, 2))

        # vertical response
        self.hover = values("hover_thrust_frac") * (1.0 + p.hover_share * noise.constant(_HOVER))
        self.motor_lag = values("motor_lag_s")
        self.thrust = np.full(shape, GRAVITY_M_S2)

        # dead times in substeps, and the setpoints of the last substeps, newest first: slopes to
        # east and north, and throttle
        self.delay = [round(plant.delay_s * _SUBSTEPS / TICK_S) for plant in plants]
        depth = max(self.delay) + 1
        self.queue = np.zeros((depth, *shape, 3))
        self.queue[..., 2] = np.broadcast_to(values("hover_thrust_frac"), (depth, *shape))

    @property
    def quaternion_wxyz(self) -> Array:
        """Attitudes (F, N, 4), FLU to ENU, with the heading to the east."""
        # the shortest rotation from the vertical to the thrust's direction (slope_x, slope_y, 1)
        q = np.zeros((*self.thrust.shape, 4))
        q[..., 0] = 1.0 + np.sqrt(1.0 + np.einsum("...c,...c->...", self.slope, self.slope))
        q[..., 1] = -self.slope[..., 1]
        q[..., 2] = self.slope[..., 0]
        return np.asarray(q / np.sqrt(np.einsum("...c,...c->...", q, q))[..., None])

    def advance(self, attitude: Rows, gust_noise: Array, p: Perturbation, dt_s: float) -> None:
        """Move all vehicles by one control tick.

        Args:
            attitude: attitude setpoints (F, N).
            gust_noise: standard normal numbers (F, N, 3).
            p: size and correlation time of the gusts.
            dt_s: length of the tick.
        """
        # slopes of the setpoint's up axis, and throttle
        q = attitude["quaternion_wxyz"]
        up_x = 2.0 * (q[..., 1] * q[..., 3] + q[..., 0] * q[..., 2])
        up_y = 2.0 * (q[..., 2] * q[..., 3] - q[..., 0] * q[..., 1])
        up_z = 1.0 - 2.0 * (q[..., 1] ** 2 + q[..., 2] ** 2)
        sent = np.stack([up_x / up_z, up_y / up_z, attitude["thrust_frac"]], axis=-1)

        # a first-order process with the correlation time and the standard deviation of the gusts
        keep = math.exp(-dt_s / p.gust_time_s)
        self.gust = keep * self.gust + p.gust_m_s2 * math.sqrt(1.0 - keep * keep) * gust_noise

        for _ in range(_SUBSTEPS):
            self._substep(sent, dt_s / _SUBSTEPS)

    def _substep(self, sent: Array, step_s: float) -> None:
        """Move all vehicles by part of a tick.

        Args:
            sent: slopes and throttle (F, N, 3).
            step_s: length of the part.
        """
        # the setpoints of one dead time ago
        self.queue = np.concatenate([sent[None], self.queue[:-1]])
        by_vehicle = [self.queue[delay, :, n] for n, delay in enumerate(self.delay)]
        delayed = np.stack(by_vehicle, axis=1)

        # slopes: second order
        setpoint = self.gain[..., None] * delayed[..., :2] + self.bias
        damping = (2.0 * self.zeta * self.wn)[..., None] * self.slope_rate
        slope_acceleration = self.wn[..., None] ** 2 * (setpoint - self.slope) - damping
        self.slope_rate = self.slope_rate + step_s * slope_acceleration
        self.slope = self.slope + step_s * self.slope_rate

        # thrust: first order
        blend = 1.0 - np.exp(-step_s / self.motor_lag)
        commanded = delayed[..., 2] / self.hover * GRAVITY_M_S2
        self.thrust = self.thrust + blend * (commanded - self.thrust)

        # the thrust acts along the body's up axis (slope_x, slope_y, 1) / length
        length = np.sqrt(1.0 + np.einsum("...c,...c->...", self.slope, self.slope))
        vertical = (self.thrust / length)[..., None]
        force = np.concatenate([vertical * self.slope, vertical], axis=-1)
        acceleration = force - self.drag[..., None] * self.velocity + self.gust
        acceleration[..., 2] -= GRAVITY_M_S2

        moved = step_s * self.velocity
        self.position = self.position + moved + 0.5 * step_s * step_s * acceleration
        self.velocity = self.velocity + step_s * acceleration
