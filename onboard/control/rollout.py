"""The closed loop of the pipeline over an emulated vehicle, batched over flights and vehicles.

The vehicle is a point mass under a thrust whose direction follows the attitude setpoint through dead time and a
second-order lag (with its own error in gain, bias and lag) and whose size follows the throttle through the motors.
Each flies on its own estimate from noisy, late mocap samples, and hears the others late and with losses. Flights are
repeatable: each draws from its own seed, alone or in a batch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from onboard.config import Vehicle
from onboard.control import estimate, pipeline
from onboard.types import (
    GRAVITY_M_S2,
    Array,
    AttitudeSetpoint,
    BoolArray,
    Goal,
    IntArray,
    LawStatus,
    Neighbours,
    State,
    Tick,
)

_T = TypeVar("_T", bound=np.generic)
_SUBSTEPS = 4
_NOISE_BLOCK_TICKS = 100
_FIELDS = 20  # per message: plain p, v, a, predicted p, v, command (3 each), position std, crowd count


@dataclass(frozen=True, slots=True)
class Plant:
    """What the emulated vehicle really is; the control knows the configured part of it at best."""

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
    """Errors of a flight: standard deviations, or half widths of uniform ones where a share is given.

    lag_share, gain_share, drag_share, hover_share: of the vehicle's own values. gust_m_s2 per axis, correlated over
    gust_time_s. start_m: of the take-off spots. Mocap as a lab has it; messages late and lost.
    """

    lag_share: float = 0.10
    gain_share: float = 0.05
    drag_share: float = 0.15
    hover_share: float = 0.03
    gust_m_s2: float = 0.1
    gust_time_s: float = 1.5
    mocap_noise_m: float = 0.003
    mocap_delay_ticks: int = 1
    message_delay_ticks: int = 2
    message_loss: float = 0.10
    start_m: float = 0.05


@dataclass(frozen=True, slots=True)
class Scenario:
    """start_enu_m (F, N, 3); legs_enu_m (F, L, N, 3) flown one after the other; duration_s (L,) asked for each.

    A leg ends when all have arrived, or after timeout_s.
    """

    start_enu_m: Array
    legs_enu_m: Array
    duration_s: Array
    timeout_s: float = 40.0


@dataclass(frozen=True, slots=True)
class Flight:
    """Outcome per flight (F,): separations are true ones, in the plane.

    arrival_s (F, L): when the last vehicle arrived, after the leg's start (inf: not in time). final_error_m (F, L):
    largest distance from the slot at the end of the leg. slew_m_s3: rms of the command's change. max_speed_m_s.
    trace_enu_m (T, F, N, 3): true positions each tick when asked for, else empty.
    """

    min_separation_m: Array
    is_success: BoolArray
    arrival_s: Array
    final_error_m: Array
    violation_s: Array
    relaxed_share: Array
    slew_m_s3: Array
    max_speed_m_s: Array
    duration_s: Array
    trace_enu_m: Array
    trace_status: IntArray


def plant_of(vehicle: Vehicle) -> Plant:
    """The plant that a vehicle's configuration describes, the emulator's part of it included."""
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


class _World:
    """True motion of F x N vehicles; the one mutable thing in here."""

    def __init__(self, start: Array, plants: Sequence[Plant], noise: _Noise, perturbation: Perturbation) -> None:
        shape = start.shape[:-1]
        p = perturbation

        def values(name: str) -> Array:
            return np.broadcast_to(np.array([getattr(plant, name) for plant in plants], dtype=np.float64), shape)

        self.position, self.velocity = start.copy(), np.zeros_like(start)
        self.wn = values("wn_rad_s") * (1.0 + p.lag_share * noise.constant(0))
        self.zeta = values("zeta")
        self.gain = values("static_gain") * (1.0 + p.gain_share * noise.constant(1))
        self.drag = values("drag_1_s") * (1.0 + p.drag_share * noise.constant(2))
        self.hover = values("hover_thrust_frac") * (1.0 + p.hover_share * noise.constant(3))
        bias = np.tan(np.radians(values("tilt_bias_deg")))
        self.bias = np.stack([bias * np.sign(noise.constant(4)), bias * np.sign(noise.constant(5))], axis=-1)
        self.motor_lag = values("motor_lag_s")
        self.delay = [round(plant.delay_s * _SUBSTEPS / 0.02) for plant in plants]
        self.slope = np.zeros((*shape, 2))
        self.slope_rate = np.zeros((*shape, 2))
        self.thrust = np.full(shape, GRAVITY_M_S2)
        self.gust = np.zeros_like(start)
        depth = max(self.delay) + 1
        self.queue = np.zeros((depth, *shape, 3))
        self.queue[..., 2] = np.broadcast_to(values("hover_thrust_frac"), (depth, *shape))
        self.specific_force = np.zeros_like(start)

    def advance(self, attitude: AttitudeSetpoint, gust_noise: Array, p: Perturbation, dt_s: float) -> None:
        """One control tick under an attitude setpoint."""
        q = attitude.quaternion_wxyz
        up_x = 2.0 * (q[..., 1] * q[..., 3] + q[..., 0] * q[..., 2])
        up_y = 2.0 * (q[..., 2] * q[..., 3] - q[..., 0] * q[..., 1])
        up_z = 1.0 - 2.0 * (q[..., 1] ** 2 + q[..., 2] ** 2)
        sent = np.stack([up_x / up_z, up_y / up_z, attitude.thrust_frac], axis=-1)
        keep = math.exp(-dt_s / p.gust_time_s)
        self.gust = keep * self.gust + p.gust_m_s2 * math.sqrt(1.0 - keep * keep) * gust_noise
        h = dt_s / _SUBSTEPS
        blend = 1.0 - np.exp(-h / self.motor_lag)
        for _ in range(_SUBSTEPS):
            self.queue = np.concatenate([sent[None], self.queue[:-1]])
            heard = np.stack([self.queue[delay, :, n] for n, delay in enumerate(self.delay)], axis=1)
            asked = self.gain[..., None] * heard[..., :2] + self.bias
            damping = (2.0 * self.zeta * self.wn)[..., None] * self.slope_rate
            push = self.wn[..., None] ** 2 * (asked - self.slope) - damping
            self.slope_rate = self.slope_rate + h * push
            self.slope = self.slope + h * self.slope_rate
            self.thrust = self.thrust + blend * (heard[..., 2] / self.hover * GRAVITY_M_S2 - self.thrust)
            length = np.sqrt(1.0 + np.einsum("...c,...c->...", self.slope, self.slope))
            along = (self.thrust / length)[..., None]
            self.specific_force = np.concatenate([along * self.slope, along], axis=-1)
            acceleration = self.specific_force - self.drag[..., None] * self.velocity + self.gust
            acceleration[..., 2] -= GRAVITY_M_S2
            self.position = self.position + h * self.velocity + 0.5 * h * h * acceleration
            self.velocity = self.velocity + h * acceleration


class _Noise:
    """Random numbers of F flights, each from its own seed, in blocks of ticks."""

    def __init__(self, seeds: Sequence[int], count: int) -> None:
        self.generators = [np.random.default_rng(seed) for seed in seeds]
        self.count = count
        self.constants = np.stack([rng.uniform(-1.0, 1.0, (8, count)) for rng in self.generators], axis=1)
        self.starts = np.stack([rng.normal(size=(count, 2)) for rng in self.generators])
        self.tick = _NOISE_BLOCK_TICKS

    def constant(self, index: int) -> Array:
        return np.asarray(self.constants[index])

    def next(self) -> tuple[Array, Array, Array]:
        """Standard normal for mocap and gusts (F, N, 3) and uniform for links (F, N, N)."""
        if self.tick == _NOISE_BLOCK_TICKS:
            n, block = self.count, _NOISE_BLOCK_TICKS
            self.normal = np.stack([rng.standard_normal((block, 2, n, 3)) for rng in self.generators], axis=2)
            self.uniform = np.stack([rng.random((block, n, n)) for rng in self.generators], axis=1)
            self.tick = 0
        k, self.tick = self.tick, self.tick + 1
        return self.normal[k, 0], self.normal[k, 1], self.uniform[k]


def fly(
    scenario: Scenario,
    params: Sequence[pipeline.PipelineParams],
    plants: Sequence[Plant],
    seeds: Sequence[int],
    *,
    perturbation: Perturbation | None = None,
    safety_distance_m: float = 0.8,
    arrival_m: float = 0.15,
    settle_s: float = 1.0,
    dt_s: float = 0.02,
    has_trace: bool = False,
) -> Flight:
    """Fly a scenario once per seed, all flights at once.

    Args:
        scenario: leading axis F of one entry per seed.
        params, plants: one per vehicle, N each; vehicles with equal params are computed together.
        seeds: F seeds.
        settle_s: a vehicle has arrived when it has stayed within ``arrival_m`` for this long.
    Returns:
        Outcome per flight. Success: every leg arrived in time.
    """
    noise_values = perturbation if perturbation is not None else Perturbation()
    flights, count = scenario.start_enu_m.shape[:2]
    legs = scenario.legs_enu_m.shape[1]
    noise = _Noise(seeds, count)
    start = scenario.start_enu_m.copy()
    start[..., :2] += noise_values.start_m * noise.starts
    world = _World(start, plants, noise, noise_values)
    groups = _groups(params)
    memories = [pipeline.initial(params[group[0]], start[:, group]) for group in groups]
    filter_params = estimate.EstimateParams(
        position_noise_m=noise_values.mocap_noise_m,
        drag_1_s=np.array([p.drag_1_s for p in params])[None, :].repeat(flights, axis=0),
    )
    own = estimate.initial(start, params=filter_params)
    mocap = [start.copy() for _ in range(noise_values.mocap_delay_ticks + 1)]
    outbox = [_message(own, None, groups) for _ in range(noise_values.message_delay_ticks + 1)]
    inbox = np.repeat(outbox[0][:, None], count, axis=1)  # (F, receiver, sender, fields)
    age = np.full((flights, count, count), noise_values.message_delay_ticks * dt_s)
    others = np.array([[j for j in range(count) if j != i] for i in range(count)], dtype=np.int64).reshape(count, -1)
    leg = np.zeros(flights, np.int64)
    leg_time, stay = np.zeros(flights), np.zeros((flights, count))
    arrival = np.full((flights, legs), np.inf)
    error = np.full((flights, legs), np.inf)
    is_open = np.ones(flights, bool)
    closest = np.full(flights, np.inf)
    tally = {name: np.zeros(flights) for name in ("violation", "relaxed", "slew", "ticks", "speed")}
    last = np.zeros((flights, count, 3))
    upper = np.triu_indices(count, 1)
    trace: list[Array] = []
    statuses: list[IntArray] = []
    rows = np.arange(flights)
    for _ in range(math.ceil(scenario.timeout_s * legs / dt_s)):
        mocap_noise, gust_noise, luck = noise.next()
        # own estimate
        mocap = [world.position + noise_values.mocap_noise_m * mocap_noise, *mocap[:-1]]
        own = estimate.predict(
            own, world.specific_force - np.array([0.0, 0.0, GRAVITY_M_S2]), params=filter_params, dt_s=dt_s
        )
        own = estimate.correct(own, mocap[-1], noise_values.mocap_delay_ticks * dt_s, params=filter_params)
        state = estimate.state(own)
        # what arrives
        arrived = luck >= noise_values.message_loss
        inbox = np.where(arrived[..., None], outbox[-1][:, None], inbox)
        age = np.where(arrived, noise_values.message_delay_ticks * dt_s, age + dt_s)
        # one tick of everybody
        goal_position = scenario.legs_enu_m[rows, np.minimum(leg, legs - 1)]
        duration = np.broadcast_to(scenario.duration_s[np.minimum(leg, legs - 1)][:, None], (flights, count))
        sequence = np.broadcast_to(leg[:, None], (flights, count))
        ticks: list[Tick] = []
        for k, group in enumerate(groups):
            memories[k], tick = pipeline.step(
                memories[k],
                _take(state, group),
                Goal(goal_position[:, group], duration[:, group], sequence[:, group]),
                _heard(inbox, age, others, group),
                params=params[group[0]],
                dt_s=dt_s,
            )
            ticks.append(tick)
        outbox = [_message(own, ticks, groups), *outbox[:-1]]
        attitude = AttitudeSetpoint(
            _merge([tick.attitude.quaternion_wxyz for tick in ticks], groups),
            _merge([tick.attitude.thrust_frac for tick in ticks], groups),
        )
        status = _merge([tick.law.status for tick in ticks], groups)
        command = _merge([tick.law.thrust.thrust_enu_m_s2 for tick in ticks], groups)
        world.advance(attitude, gust_noise, noise_values, dt_s)
        # judged on true positions
        gap = world.position[:, upper[0], :2] - world.position[:, upper[1], :2]
        nearest = np.sqrt(np.einsum("fpc,fpc->fp", gap, gap)).min(-1, initial=np.inf)
        closest = np.where(is_open, np.minimum(closest, nearest), closest)
        slew = (command - last)[..., :2] / dt_s
        last = command
        tally["violation"] += is_open * (nearest < safety_distance_m) * dt_s
        tally["relaxed"] += is_open * (status == int(LawStatus.RELAXED)).mean(-1)
        tally["slew"] += is_open * np.einsum("fnc,fnc->f", slew, slew) / count
        tally["ticks"] += is_open
        speed = np.sqrt(np.einsum("fnc,fnc->fn", world.velocity, world.velocity)).max(-1)
        tally["speed"] = np.maximum(tally["speed"], is_open * speed)
        if has_trace:
            trace.append(world.position.copy())
            statuses.append(status)
        away = np.sqrt(((world.position - goal_position) ** 2).sum(-1))
        stay = np.where(away < arrival_m, stay + dt_s, 0.0)
        leg_time = leg_time + dt_s
        is_there = np.asarray((stay >= settle_s).all(-1))
        is_over = is_open & (is_there | (leg_time >= scenario.timeout_s))
        if is_over.any():
            done = np.flatnonzero(is_over)
            arrival[done, leg[done]] = np.where(is_there[done], leg_time[done] - settle_s, np.inf)
            error[done, leg[done]] = away[done].max(-1)
            leg[done] += 1
            leg_time[done] = 0.0
            stay[done] = 0.0
            is_open &= leg < legs
            if not is_open.any():
                break
    length = np.maximum(tally["ticks"], 1.0)
    return Flight(
        min_separation_m=closest,
        is_success=np.isfinite(arrival).all(-1),
        arrival_s=arrival,
        final_error_m=error,
        violation_s=tally["violation"],
        relaxed_share=tally["relaxed"] / length,
        slew_m_s3=np.sqrt(tally["slew"] / length),
        max_speed_m_s=tally["speed"],
        duration_s=tally["ticks"] * dt_s,
        trace_enu_m=np.array(trace),
        trace_status=np.array(statuses, dtype=np.int64),
    )


def _groups(params: Sequence[pipeline.PipelineParams]) -> list[list[int]]:
    groups: list[list[int]] = []
    for index, own in enumerate(params):
        for group in groups:
            if params[group[0]] == own:
                group.append(index)
                break
        else:
            groups.append([index])
    return groups


def _merge(parts: Sequence[NDArray[_T]], groups: Sequence[Sequence[int]]) -> NDArray[_T]:
    """Results of the groups (F, len(group), ...) in the order of the vehicles."""
    order = np.argsort([index for group in groups for index in group])
    merged: NDArray[_T] = np.concatenate(parts, axis=1)[:, order]
    return merged


def _take(state: State, group: Sequence[int]) -> State:
    return State(
        state.position_enu_m[:, group],
        state.velocity_enu_m_s[:, group],
        state.acceleration_enu_m_s2[:, group],
        state.yaw_rad[:, group],
        state.age_s[:, group],
        state.position_std_m[:, group],
        state.velocity_std_m_s[:, group],
    )


def _message(own: estimate.EstimateMemory, ticks: Sequence[Tick] | None, groups: Sequence[Sequence[int]]) -> Array:
    """What each vehicle publishes, (F, N, fields)."""
    out = np.zeros((*own.position_enu_m.shape[:-1], _FIELDS))
    out[..., 0:3], out[..., 3:6], out[..., 6:9] = own.position_enu_m, own.velocity_enu_m_s, own.acceleration_enu_m_s2
    out[..., 18] = np.sqrt(own.covariance[..., 0])
    if ticks is None:
        out[..., 9:12] = own.position_enu_m
        return out
    out[..., 9:12] = _merge([tick.law.predicted_position_enu_m for tick in ticks], groups)
    out[..., 12:15] = _merge([tick.law.predicted_velocity_enu_m_s for tick in ticks], groups)
    out[..., 15:18] = _merge([tick.law.commanded_acceleration_enu_m_s2 for tick in ticks], groups)
    out[..., 19] = _merge([tick.law.crowd_count for tick in ticks], groups)
    return out


def _heard(inbox: Array, age: Array, others: IntArray, group: Sequence[int]) -> Neighbours:
    """Neighbours (F, len(group), K) as a group of receivers heard them."""
    receivers = np.array(group)[:, None]
    senders = others[list(group)]
    fields = inbox[:, receivers, senders]
    shape = fields.shape[:-1]
    count = inbox.shape[1]
    present = np.ones(shape, bool)
    return Neighbours(
        position_enu_m=fields[..., 0:3],
        velocity_enu_m_s=fields[..., 3:6],
        acceleration_enu_m_s2=fields[..., 6:9],
        predicted_position_enu_m=fields[..., 9:12],
        predicted_velocity_enu_m_s=fields[..., 12:15],
        commanded_acceleration_enu_m_s2=fields[..., 15:18],
        age_s=age[:, receivers, senders],
        position_std_m=fields[..., 18],
        crowd_count=fields[..., 19],
        is_present=present,
        is_cooperative=present,
        is_paper_obstacle=np.broadcast_to(senders == (receivers + 1) % count, shape),
    )
