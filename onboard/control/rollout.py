"""The closed loop of the pipeline over emulated vehicles, batched over flights and vehicles.

Each vehicle flies on its own estimate from noisy, late mocap samples, and hears the others late and with losses.
Flights are repeatable: each draws from its own seed, alone or in a batch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from onboard.config import FleetConfig
from onboard.control import estimate, pipeline
from onboard.control.plant import TICK_S, Noise, Perturbation, Plant, World, plant_of
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
_FIELDS = 20  # per message: plain p, v, a, predicted p, v, command (3 each), position std, crowd count


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


def fleet_models(
    fleet: FleetConfig, names: Sequence[str], *, law: str | None = None
) -> tuple[list[pipeline.PipelineParams], list[Plant]]:
    """Parameters and plants of the named vehicles, as :func:`fly` takes them; ``law`` overrides the fleet file's."""
    params = [pipeline.pipeline_params(fleet, name, law=law) for name in names]
    return params, [plant_of(fleet.vehicles[name]) for name in names]


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
    dt_s = TICK_S
    flights, count = scenario.start_enu_m.shape[:2]
    legs = scenario.legs_enu_m.shape[1]
    noise = Noise(seeds, count)
    start = scenario.start_enu_m.copy()
    start[..., :2] += noise_values.start_m * noise.starts
    world = World(start, plants, noise, noise_values)
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
