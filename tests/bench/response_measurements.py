"""Responses of the emulated vehicle, measured as PX4 was: steps, climb, closed loop, errors of the
estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sitl.emulator.emulator import Emulator, Environment, VehicleSpec
from sitl.physics import frames
from sitl.physics.frames import Array
from sitl.physics.vehicle import GRAVITY_M_S2, STEP_S, Commands, VehicleProfile, Vehicles
from sitl.px4.estimator import PERIOD_S, Estimator
from sitl.px4.estimator_errors import GPS, ErrorLevel
from sitl.px4.modes import Mode
from sitl.px4.versions import VERSIONS

SIH = VehicleProfile()
_DURATION_S = 2.6


def step_response(axis: int, size_deg: float, profile: VehicleProfile = SIH) -> tuple[Array, Array]:
    """Times (k,) [s] and shares (k,) reached of a step of the attitude about roll (0), pitch (1) or
    yaw (2).
    """
    vehicles, commands = hovering(profile)
    size = math.radians(size_deg)
    tilt = np.zeros((1, 2))
    yaw = np.zeros(1)
    if axis < 2:
        tilt[0, axis] = size
    else:
        yaw[0] = size
    commands.attitude[:] = frames.from_yaw_and_tilt(yaw, tilt)
    reached = []
    for _ in range(round(_DURATION_S / STEP_S)):
        vehicles.step(commands)
        s = vehicles.states
        reached.append(float(s.tilt_rad[0, axis] if axis < 2 else s.yaw_rad[0]))
    return STEP_S * np.arange(1, len(reached) + 1, dtype=np.float64), np.unwrap(
        np.array(reached)
    ) / size


def first_s(times: Array, shares: Array, level: float) -> float:
    """Time at which a share is first reached."""
    return float(times[np.argmax(shares >= level)])


def hovering(profile: VehicleProfile) -> tuple[Vehicles, Commands]:
    """A vehicle that hovers 50 m high, and its commands."""
    vehicles = Vehicles([profile], np.array([[0.0, 0.0, -50.0]]), np.zeros(1), seed=1)
    commands = Commands.level(np.zeros(1))
    commands.motors_on[:] = True
    commands.thrust_frac[:] = profile.hover_thrust_frac
    vehicles.states.thrust_frac[:] = profile.hover_thrust_frac
    for _ in range(50):
        vehicles.step(commands)
    return vehicles, commands


def climb(extra_frac: float = 0.1, duration_s: float = 1.0) -> tuple[Array, Array]:
    """Times (k,) and climb speed (k,) [m/s] after the thrust was raised in hover."""
    vehicles, commands = hovering(SIH)
    commands.thrust_frac[:] += extra_frac
    speeds = []
    for _ in range(round(duration_s / STEP_S)):
        vehicles.step(commands)
        speeds.append(-float(vehicles.states.velocity_ned_m_s[0, 2]))
    return STEP_S * np.arange(1, len(speeds) + 1, dtype=np.float64), np.array(speeds)


def closed_loop(
    *, sideways_m_s2: float, upward_m_s2: float, duration_s: float = 12.0
) -> tuple[Array, Array]:
    """Random attitude setpoints at 50 Hz, changed every 0.2 s, through a whole emulated PX4 whose
    estimate is right.

    Args:
        sideways_m_s2, upward_m_s2: largest accelerations asked for.
    Returns:
        commanded and true acceleration (k, 2) northward and upward, one row per physics step.
    """
    spec = VehicleSpec(
        name="sih", system_id=1, profile=SIH, start_enu_m=(0.0, 0.0, 0.0), px4=VERSIONS["1.16"]
    )
    emulator = Emulator([spec], environment=Environment(error_scale=0.0), seed=0)
    rng = np.random.default_rng(3)
    pilot = emulator.autopilots[0]
    states = emulator.world.vehicles.states
    north = 0.0
    lift = GRAVITY_M_S2
    rows = []
    begin_s = 6.0
    while emulator.time_s < begin_s + duration_s:
        step = emulator.world.vehicles.steps
        if step % 5 == 0:
            if step % 50 == 0 and emulator.time_s > begin_s - 0.5:
                north = float(rng.uniform(-sideways_m_s2, sideways_m_s2))
                lift = GRAVITY_M_S2 + float(rng.uniform(-upward_m_s2, upward_m_s2))
            lift = lift if emulator.time_s > begin_s - 0.5 else 1.3 * GRAVITY_M_S2
            tilt = math.atan2(north, lift)
            # Nose east: north is to the left of it.
            q = frames.from_yaw_and_tilt(np.float64(0.5 * math.pi), np.array([-tilt, 0.0]))  # type: ignore[arg-type]
            thrust = math.hypot(north, lift) / GRAVITY_M_S2 * SIH.hover_thrust_frac
            emulator.attitude_setpoint(0, q.tolist(), [0.0] * 3, thrust, 7)
            if emulator.time_s > 4.5 and not pilot.is_armed:
                pilot.request(emulator.time_s, Mode.OFFBOARD)
                pilot.request_arm(emulator.time_s, True, 0.0)
        emulator.step()
        force = states.acceleration_ned_m_s2[0] + SIH.drag_1_s * states.velocity_ned_m_s[0]
        rows.append((emulator.time_s, north, force[0], lift, GRAVITY_M_S2 - force[2]))
    kept = np.array([row for row in rows if row[0] > begin_s])
    return kept[:, 1:3], kept[:, 3:5]


def fit(asked: Array, answered: Array) -> tuple[float, float, float]:
    """Dead time [s], natural frequency [rad/s] and damping of the second-order lag between two
    signals (k,).
    """

    def miss(p: tuple[float, float, float]) -> float:
        delay, wn, zeta = p
        out = second_order(asked, delay, wn, zeta)
        return float(np.square(out - answered)[125:].sum())

    best = (0.05, 10.0, 0.7)
    steps = (0.016, 2.0, 0.16)
    least = miss(best)
    for _ in range(24):
        candidates = [
            (best[0] + a * steps[0], best[1] + b * steps[1], best[2] + c * steps[2])
            for a, b, c in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
        ]
        scored = [(miss(p), p) for p in candidates if min(p) > 0.0]
        nearest = min(scored)
        if nearest[0] < least:
            least, best = nearest
        else:
            steps = (0.5 * steps[0], 0.5 * steps[1], 0.5 * steps[2])
    return best


def second_order(asked: Array, delay_s: float, wn_rad_s: float, zeta: float) -> Array:
    """A signal (k,) behind a dead time and a second-order lag, one sample per physics step."""
    times = np.arange(asked.shape[0]) * STEP_S
    heard = np.interp(times - delay_s, times, asked).tolist()
    x = heard[0]
    v = 0.0
    out = []
    for goal in heard:
        v += STEP_S * (wn_rad_s * wn_rad_s * (goal - x) - 2.0 * zeta * wn_rad_s * v)
        x += STEP_S * v
        out.append(x)
    return np.array(out)


def delay_by_correlation_s(asked: Array, answered: Array) -> float:
    """Lag at which two signals (k,) are most alike."""
    a = asked - asked.mean()
    b = answered - answered.mean()
    lags = range(100)
    return max(lags, key=lambda lag: float((a[: a.size - lag] * b[lag:]).mean())) * STEP_S


def lag_s(asked: Array, answered: Array) -> float:
    """Mean lag of a response to steps: the area between both over the sum of the steps taken."""
    change = np.abs(np.diff(asked)).sum()
    return float(np.abs(asked - answered).sum() * STEP_S / change)


@dataclass(frozen=True, slots=True)
class ErrorFigures:
    """Errors of one source: standard deviations (3,) of position and velocity, correlation of the
    velocity error.
    """

    position_m: Array
    velocity_m_s: Array
    correlation_s: float
    lags_s: Array
    correlation: Array


def estimate_errors(
    level: ErrorLevel, vehicles: int = 60, duration_s: float = 40.0
) -> ErrorFigures:
    """Let vehicles hover on a source and look at what they believe."""
    estimator = Estimator(np.zeros((vehicles, 3)), seed=4)
    for sensors in estimator.sensors:
        sensors.has_gps = level is GPS
        sensors.vision_level = level
    still = np.zeros((vehicles, 3))
    flies = np.zeros(vehicles, dtype=np.bool_)
    position = []
    velocity = []
    place = np.zeros(3)
    for k in range(round(duration_s / PERIOD_S)):
        if level is not GPS and k % 5 == 0:
            for i in range(vehicles):
                estimator.fuse_vision(i, k * PERIOD_S, place, delay_s=0.0)
        estimator.step(k * PERIOD_S, still, still, flies)
        if k * PERIOD_S > 10.0:
            position.append(
                estimator.position_ned_m - estimator.offset_ned_m - estimator.bias_ned_m
            )
            velocity.append(estimator.velocity_ned_m_s.copy())
    p = np.array(position)
    v = np.array(velocity)
    scaled = (v / np.array(level.velocity_m_s)).reshape(v.shape[0], -1)
    lags = np.unique(np.geomspace(1, 0.4 * v.shape[0], 60).astype(int))
    alike = np.array([float((scaled[:-lag] * scaled[lag:]).mean()) for lag in lags]) / float(
        (scaled**2).mean()
    )
    below = int(np.argmax(alike < math.exp(-1.0)))
    found_s = float(np.interp(-math.exp(-1.0), -alike[: below + 1], lags[: below + 1])) * PERIOD_S
    return ErrorFigures(
        position_m=p.std(axis=(0, 1)),
        velocity_m_s=v.std(axis=(0, 1)),
        correlation_s=found_s,
        lags_s=lags * PERIOD_S,
        correlation=alike,
    )
