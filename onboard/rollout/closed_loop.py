"""The closed loop of the pipeline over emulated vehicles, batched over flights and vehicles.

Each vehicle flies on its own estimate from noisy, late mocap samples, and hears the others late and with losses.
Flights are repeatable: each draws from its own seed, alone or in a batch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.config.fleet import FleetConfig
from onboard.control import pipeline
from onboard.estimation import kalman
from onboard.rollout import batch
from onboard.rollout.vehicle_model import TICK_S, Noise, Perturbation, Plant, World, plant_of
from onboard.types import GRAVITY_M_S2, Array, BoolArray, Goal, IntArray, LawStatus


@dataclass(frozen=True, slots=True)
class Scenario:
    """start_enu_m (F, N, 3); legs_enu_m (F, L, N, 3) flown one after the other; duration_s (L,) asked for each.

    A leg ends when all have arrived, or after timeout_s. is_parked (N,): who stands on the ground all the while, and
    does not avoid anybody; nobody where it is empty.
    """

    start_enu_m: Array
    legs_enu_m: Array
    duration_s: Array
    timeout_s: float = 40.0
    is_parked: tuple[bool, ...] = ()


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
    controller = batch.FleetPipeline(params, start)
    filter_params = kalman.EstimateParams(
        position_noise_m=noise_values.mocap_noise_m,
        drag_1_s=np.array([p.drag_1_s for p in params])[None, :].repeat(flights, axis=0),
    )
    own = kalman.initial(start, params=filter_params)
    mocap = [start.copy() for _ in range(noise_values.mocap_delay_ticks + 1)]
    outbox = [batch.message(kalman.state(own), None) for _ in range(noise_values.message_delay_ticks + 1)]
    inbox = np.repeat(outbox[0][:, None], count, axis=1)  # (F, receiver, sender, fields)
    age = np.full((flights, count, count), noise_values.message_delay_ticks * dt_s)
    others = batch.all_others(count)
    parked = np.array(scenario.is_parked or [False] * count)
    is_cooperative = np.broadcast_to(~parked, age.shape)
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
        own = kalman.predict(
            own, world.specific_force - np.array([0.0, 0.0, GRAVITY_M_S2]), params=filter_params, dt_s=dt_s
        )
        own = kalman.correct(own, mocap[-1], noise_values.mocap_delay_ticks * dt_s, params=filter_params)
        state = kalman.state(own)
        # what arrives
        arrived = luck >= noise_values.message_loss
        inbox = np.where(arrived[..., None], outbox[-1][:, None], inbox)
        age = np.where(arrived, noise_values.message_delay_ticks * dt_s, age + dt_s)
        # one tick of everybody
        goal_position = scenario.legs_enu_m[rows, np.minimum(leg, legs - 1)]
        duration = np.broadcast_to(scenario.duration_s[np.minimum(leg, legs - 1)][:, None], (flights, count))
        sequence = np.broadcast_to(leg[:, None], (flights, count))
        tick = controller.step(
            state,
            Goal(goal_position, duration, sequence),
            batch.heard(inbox, age, others, is_cooperative),
            dt_s=dt_s,
        )
        outbox = [batch.message(state, tick.law), *outbox[:-1]]
        status, command = tick.law.status, tick.law.thrust.thrust_enu_m_s2
        world.advance(tick.attitude, gust_noise, noise_values, dt_s)
        world.position[:, parked], world.velocity[:, parked] = start[:, parked], 0.0
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
        is_there = np.asarray((stay >= settle_s)[:, ~parked].all(-1))
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
