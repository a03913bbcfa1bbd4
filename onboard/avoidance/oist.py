"""Output-to-Input Saturation for N neighbours: the baseline thrust in, a safe thrust out, equal types.

Every neighbour, obstacle and wall gives a hard row (distance); while the baseline violates it, a soft row asks to turn
about the other one, and one more keeps the speed down. The safe horizontal thrust is the projection of the baseline on
all rows and on what tilt and thrust can deliver; the vertical thrust is never touched, so height is not traded for
separation. Rows (rows.py) are evaluated where the vehicle will be when the command takes effect (prediction.py).
README.md beside this file has the symbols and the deviations from the paper.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from onboard.avoidance import constraints, kernels, prediction
from onboard.avoidance.kernels import HUGE, LONGEST_LEAD_S, VIOLATED_M_S2
from onboard.avoidance.oist_paper import saturate_thrust
from onboard.avoidance.params import DIRECTION, ROTATION, LawNumbers
from onboard.avoidance.params import LawParams as LawParams
from onboard.avoidance.projection import Rows, project
from onboard.rollout import compiled
from onboard.types import (
    GRAVITY_M_S2,
    Array,
    BoolArray,
    IntArray,
    LawOutput,
    LawStatus,
    Neighbours,
    State,
    Thrust,
    light,
)


@light
@dataclass(frozen=True, slots=True)
class LawMemory:
    """Own past commands; relaxed_share (...): low-passed share of ticks whose hard rows had to be relaxed.

    held_s (...): how long the law has kept the vehicle from going where it wants; below 0 for as long as it calls for a
    roundabout because of that.
    """

    history: prediction.CommandHistory
    relaxed_share: Array
    held_s: Array


def initial(batch_shape: tuple[int, ...]) -> LawMemory:
    """Memory before the first command."""
    return LawMemory(prediction.initial(batch_shape), np.zeros(batch_shape), np.zeros(batch_shape))


def predict(memory: LawMemory, state: State, *, params: LawParams) -> tuple[Array, Array]:
    """Own position and velocity (..., 3) when a command of now takes effect, at t + L (line P1).

    The vertical axis obeys the motors and not the attitude: the commands count over its own, shorter lag, and the rest
    of L is at constant velocity. With the paper's law, or where the policy says so, there is no prediction.
    """
    if params.name == "paper" or params.config.prediction == "none":
        return state.position_enu_m, state.velocity_enu_m_s
    if state.age_s.size == 1:
        return prediction.predict_one(memory.history, state, params.lag_s, min(params.vertical_lag_s, params.lag_s))
    age = np.clip(np.nan_to_num(state.age_s, nan=0.0), 0.0, prediction.MAX_MESSAGE_AGE_S)
    if compiled.uses_kernel(age.size):
        return prediction.predict_batch(
            memory.history, state, age, params.lag_s, min(params.vertical_lag_s, params.lag_s)
        )
    p, v = state.position_enu_m, state.velocity_enu_m_s
    position, velocity = prediction.predict_own(memory.history, p, v, params.lag_s + age)
    vertical = min(params.vertical_lag_s, params.lag_s)
    position_z, velocity_z = prediction.predict_own(memory.history, p, v, vertical + age)
    position[..., 2] = position_z[..., 2] + (params.lag_s - vertical) * velocity_z[..., 2]
    velocity[..., 2] = velocity_z[..., 2]
    return position, velocity


def speed_share(memory: LawMemory, *, params: LawParams) -> Array:
    """Share (...) of the speed limit that is left in a jam (line G): relaxed rows slow the pursuit down, by policy."""
    if params.config.jam == "ignore":
        return np.ones_like(memory.relaxed_share)
    return np.maximum(0.1, 1.0 - 1.5 * memory.relaxed_share)


def relaxed_blend(dt_s: float) -> float:
    """How far ``LawMemory.relaxed_share`` moves in one tick; 0.07 in 20 ms."""
    return float(1.0 - 0.93 ** (dt_s / 0.02))


def saturate(
    memory: LawMemory,
    thrust_baseline: Thrust,
    predicted: tuple[Array, Array],
    state: State,
    neighbours: Neighbours,
    *,
    params: LawParams,
    dt_s: float,
    compensation_enu_m_s2: Array | None = None,
    intent_enu_m_s: Array | None = None,
) -> tuple[LawMemory, LawOutput]:
    """Safe thrust for this tick.

    Implements: (17)-(22) for N neighbours, or the paper's pair law, or the identity, by ``params.name``.

    Args:
        thrust_baseline: (..., 3) of the backstepping.
        predicted: own position and velocity (..., 3) from :func:`predict`.
        state: own estimate, used as it is by the paper's law.
        neighbours: (..., K) as received.
        compensation_enu_m_s2: (..., 3) what will be added to the command against drag and gusts; the tilt disc is
            taken about its negative, so that safe thrust and compensation fit into the tilt limit together.
        intent_enu_m_s: (..., 3) velocity that the vehicle would fly if it were alone; None: the one it has.
    Returns:
        Memory and output. Bad input gives a bounded thrust with status INFEASIBLE, never a warning; the predicted
        state is then NaN, since there is none.
    Properties: rotation- and translation-equivariant about the vertical; independent of the neighbours' order.
    """
    raw = thrust_baseline.thrust_enu_m_s2
    batch = raw.shape[:-1]
    if not batch and params.name == "covey":
        given = (compensation_enu_m_s2, predicted[1] if intent_enu_m_s is None else intent_enu_m_s)
        return _saturate_one(memory, raw, predicted, state, neighbours, params, dt_s, *given)
    is_own_finite = is_plausible(raw) & is_plausible(predicted[0]) & is_plausible(predicted[1])
    level = np.array([0.0, 0.0, GRAVITY_M_S2])
    thrust = np.where(is_own_finite[..., None], _bounded(raw), level)
    position, velocity = _bounded(predicted[0]), _bounded(predicted[1])
    shift, is_shift_finite = np.zeros((*batch, 2)), np.ones(batch, bool)
    if compensation_enu_m_s2 is not None:
        is_shift_finite = is_plausible(compensation_enu_m_s2)
        shift = np.where(is_shift_finite[..., None], compensation_enu_m_s2[..., :2], 0.0)
    intent = velocity if intent_enu_m_s is None else _bounded(intent_enu_m_s)
    radius = horizontal_limit(thrust[..., 2], params=params)
    wanted = _into_disc(thrust[..., :2] + shift, radius)
    crowd = np.zeros(batch)
    slack = np.zeros(batch)
    active = np.full(batch, -1, np.int64)
    if params.name == "off":
        safe = wanted
        status = np.full(batch, int(LawStatus.INACTIVE), np.int64)
    elif params.name == "paper":
        safe, status, active = _paper(wanted - shift, state, neighbours, params)
        safe = _into_disc(safe + shift, radius)
    else:
        std = (state.position_std_m, state.velocity_std_m_s)
        own = (position[..., :2], velocity[..., :2], intent[..., :2])
        floor = np.where(memory.held_s < 0.0, params.numbers.crowd_count, 0.0)
        safe, status, slack, crowd, active = _covey(wanted, shift, radius, own, std, floor, neighbours, params)
    status = np.where(is_own_finite & is_shift_finite, status, int(LawStatus.INFEASIBLE))
    command = np.concatenate([safe - shift, thrust[..., 2:]], axis=-1)
    acceleration = command - level
    change = safe - wanted
    share = memory.relaxed_share + relaxed_blend(dt_s) * ((status == int(LawStatus.RELAXED)) - memory.relaxed_share)
    held_s = _held_s(memory.held_s, velocity, intent, active >= 0, dt_s)
    memory = LawMemory(prediction.record(memory.history, acceleration, dt_s), share, held_s)
    output = LawOutput(
        thrust=Thrust(command),
        predicted_position_enu_m=np.where(is_own_finite[..., None], position, np.nan),
        predicted_velocity_enu_m_s=np.where(is_own_finite[..., None], velocity, np.nan),
        commanded_acceleration_enu_m_s2=acceleration,
        status=status,
        intervention_m_s2=np.sqrt(np.einsum("...c,...c->...", change, change)),
        slack_m_s2=slack,
        crowd_count=crowd,
        active_neighbour=active,
        lead_time_s=np.full(batch, 0.0 if params.name == "paper" else params.numbers.lead_time_s),
        intent_enu_m_s=intent,
    )
    return memory, output


def is_plausible(vector: Array) -> BoolArray:
    """Whether all components (..., 3) are finite and small enough to be squared, (...)."""
    if vector.ndim == 1:
        x, y, z = vector.tolist()
        return np.array(abs(x) < HUGE and abs(y) < HUGE and abs(z) < HUGE)
    return np.asarray((np.abs(vector) < HUGE).all(-1))


def horizontal_limit(thrust_z_m_s2: Array, *, params: LawParams) -> Array:
    """Largest horizontal thrust (...) [m/s^2] that leaves the vertical one as it is, by tilt and by full throttle."""
    vertical = np.clip(thrust_z_m_s2, 0.0, params.max_thrust_m_s2)
    by_tilt = vertical * math.tan(params.max_tilt_rad)
    return np.minimum(by_tilt, np.sqrt(params.max_thrust_m_s2**2 - vertical**2))


def _saturate_one(
    memory: LawMemory,
    raw: Array,
    predicted: tuple[Array, Array],
    state: State,
    neighbours: Neighbours,
    params: LawParams,
    dt_s: float,
    compensation_enu_m_s2: Array | None,
    intent_enu_m_s: Array,
) -> tuple[LawMemory, LawOutput]:
    """:func:`saturate` for one vehicle, in floats."""
    is_own_finite = bool(is_plausible(raw) and is_plausible(predicted[0]) and is_plausible(predicted[1]))
    s_x, s_y, is_shift_finite = 0.0, 0.0, True
    if compensation_enu_m_s2 is not None:
        is_shift_finite = bool(is_plausible(compensation_enu_m_s2))
        s_x, s_y = compensation_enu_m_s2[:2].tolist() if is_shift_finite else (0.0, 0.0)
    f_x, f_y, f_z = raw.tolist() if is_own_finite else (0.0, 0.0, GRAVITY_M_S2)
    position, velocity = predicted if is_own_finite else (_bounded(predicted[0]), _bounded(predicted[1]))
    up = min(max(f_z, 0.0), params.max_thrust_m_s2)
    radius = min(up * math.tan(params.max_tilt_rad), math.sqrt(params.max_thrust_m_s2**2 - up * up))
    w_x, w_y = f_x + s_x, f_y + s_y
    size = math.sqrt(w_x * w_x + w_y * w_y)
    if size > radius:
        w_x, w_y = w_x * (radius / max(size, 1e-12)), w_y * (radius / max(size, 1e-12))
    intent = _bounded(intent_enu_m_s)
    std = (float(state.position_std_m), float(state.velocity_std_m_s))
    floor = float(params.numbers.crowd_count) if memory.held_s < 0.0 else 0.0
    own = (*position[:2].tolist(), *velocity[:2].tolist(), *intent[:2].tolist(), *std, floor)
    x, y, status, slack, crowd, active = kernel_rows(
        np.array((w_x, w_y, s_x, s_y, radius, *own)), neighbours, params
    ).tolist()
    status = status if is_own_finite and is_shift_finite else float(LawStatus.INFEASIBLE)
    acceleration = np.array((x - s_x, y - s_y, f_z - GRAVITY_M_S2))
    share = float(memory.relaxed_share)
    share += relaxed_blend(dt_s) * ((status == LawStatus.RELAXED) - share)
    nowhere = np.full(3, np.nan)
    output = LawOutput(
        thrust=Thrust(np.array((x - s_x, y - s_y, f_z))),
        predicted_position_enu_m=position if is_own_finite else nowhere,
        predicted_velocity_enu_m_s=velocity if is_own_finite else nowhere,
        commanded_acceleration_enu_m_s2=acceleration,
        status=np.array(int(status)),
        intervention_m_s2=np.array(math.sqrt((x - w_x) * (x - w_x) + (y - w_y) * (y - w_y))),
        slack_m_s2=np.array(slack),
        crowd_count=np.array(crowd),
        active_neighbour=np.array(int(active)),
        lead_time_s=np.array(params.numbers.lead_time_s),
        intent_enu_m_s=intent,
    )
    held_s = kernels.held_on(float(memory.held_s), own[2], own[3], own[4], own[5], active >= 0.0, dt_s)
    return LawMemory(prediction.record(memory.history, acceleration, dt_s), np.array(share), np.array(held_s)), output


def _held_s(held_s: Array, velocity: Array, intent: Array, is_active: BoolArray, dt_s: float) -> Array:
    """The next ``LawMemory.held_s`` (...): counts while the law keeps a vehicle that wants to go from getting on.

    Two parked neighbours with a gap too narrow between them hold a vehicle for ever: each row asks for a turn that the
    other forbids. Held for HELD_S it calls for a roundabout, which leads around both. DEVIATION D4.
    """
    wish_2 = intent[..., 0] * intent[..., 0] + intent[..., 1] * intent[..., 1]
    along = velocity[..., 0] * intent[..., 0] + velocity[..., 1] * intent[..., 1]
    is_held = is_active & (wish_2 > kernels.HELD_WISH_M2_S2) & (along < kernels.HELD_FRAC * wish_2)
    count = np.where(held_s < 0.0, np.minimum(held_s + dt_s, 0.0), np.where(is_held, held_s + dt_s, 0.0))
    return np.asarray(np.where(count >= kernels.HELD_S, -kernels.ROUNDABOUT_S, count))


def _covey(
    wanted: Array,
    shift: Array,
    radius: Array,
    own: tuple[Array, Array, Array],
    own_std: tuple[Array, Array],
    floor: Array,
    neighbours: Neighbours,
    p: LawParams,
) -> tuple[Array, IntArray, Array, Array, IntArray]:
    """Projection of ``wanted`` (shifted by the compensation) on the rows of all neighbours; lines P3, D, R, Q."""
    if compiled.uses_kernel(radius.size):
        floats = np.empty((*radius.shape, 14))
        floats[..., 0:2], floats[..., 2:4], floats[..., 4] = wanted, shift, radius
        floats[..., 5:7], floats[..., 7:9], floats[..., 9:11], floats[..., 11], floats[..., 12] = (*own, *own_std)
        floats[..., 13] = floor
        out = kernel_rows(floats, neighbours, p)
        return out[..., 0:2], out[..., 2].astype(np.int64), out[..., 3], out[..., 4], out[..., 5].astype(np.int64)
    n, (position, velocity, intent) = p.numbers, own
    q, w_j, u_j, is_seen, is_bad = _received(neighbours, n)
    e, w = position[..., None, :] - q, velocity[..., None, :] - w_j
    distance_2 = np.einsum("...kc,...kc->...k", e, e)
    is_seen &= distance_2 <= n.range_m**2
    coincident = is_seen & (distance_2 < constraints.COINCIDENT_M**2)
    e = np.where(coincident[..., None], constraints.way_out(w), e)
    std = neighbours.velocity_std_m_s
    their_std = (neighbours.position_std_m, np.zeros(is_seen.shape) if std is None else std)
    d = constraints.design_distance(own_std, their_std, neighbours.is_cooperative, n)
    wish, is_going = _wishes(intent, w, neighbours, n)
    crowd = np.maximum((is_seen & is_going & (distance_2 < 4.0 * d * d)).sum(-1), floor)
    order = np.argsort(np.where(is_seen, distance_2, np.inf), axis=-1, kind="stable")[..., : n.max_neighbours]
    is_on = np.take_along_axis(is_seen, order, -1)
    d, theirs = (np.take_along_axis(array, order, -1) for array in (d, neighbours.crowd_count))
    is_full = ~np.take_along_axis(neighbours.is_cooperative, order, -1) | bool(n.is_full)
    e, w, u_j, wish = (np.take_along_axis(array, order[..., None], -2) for array in (e, w, u_j, wish))
    # hard: neighbours, what stands still, walls
    obstacle, obstacle_bound, obstacle_turn, obstacle_turn_bound = constraints.obstacle_rows(
        position, velocity, intent, p.capsules_enu_m, n=n
    )
    pair, pair_bound = constraints.distance_rows(e, w, d, u_j, is_full, n=n)
    fence, fence_bound = constraints.fence_rows(position, velocity, n=n)
    normals = np.concatenate([pair, obstacle, fence], axis=-2)
    bounds = _net(np.concatenate([pair_bound, obstacle_bound, fence_bound], axis=-1), normals, shift)
    is_on = np.asarray(np.concatenate([is_on, np.isfinite(obstacle_bound), np.isfinite(fence_bound)], axis=-1))
    lack = np.where(is_on, bounds - np.einsum("...kc,...c->...k", normals, wanted), -np.inf)
    is_violated = np.asarray(lack > VIOLATED_M_S2)
    is_avoiding = np.asarray(is_violated.any(-1))
    place = np.concatenate([order, np.full((*is_avoiding.shape, lack.shape[-1] - order.shape[-1]), -2)], axis=-1)
    worst = np.take_along_axis(place, np.argmax(lack, axis=-1)[..., None], -1)[..., 0]
    active = np.where(is_avoiding, worst, -1).astype(np.int64)
    flagged = is_bad | coincident.any(-1)
    if not is_avoiding.any() and n.rotation != ROTATION["always"]:
        status = np.where(flagged, int(LawStatus.INFEASIBLE), int(LawStatus.INACTIVE))
        return wanted, status, np.zeros(status.shape), crowd, active
    # soft, the last one dropped first: speed, then turning about the nearest neighbour, ..., about obstacles
    count = np.maximum(crowd[..., None], np.where(np.isfinite(theirs), theirs, 0.0))
    own_velocity = np.broadcast_to(velocity[..., None, :], e.shape)
    turn, turn_bound = constraints.rotation_rows(e, w, wish, own_velocity, d, count >= n.crowd_count, is_full, n=n)
    speed, speed_bound, is_moving = constraints.speed_row(velocity, n=n)
    soft = np.concatenate([speed, turn, obstacle_turn], axis=-2)
    turn_bound = _net(turn_bound, turn, shift)
    if n.rotation == ROTATION["violated"]:
        given = np.einsum("...kc,...c->...k", turn, wanted)
        fade = np.clip(lack[..., : turn.shape[-2]] / max(n.rotation_fade_m_s2, 1e-9), 0.0, 1.0)
        turn_bound = given + fade * (turn_bound - given)
    speed_bound, obstacle_turn_bound = _net(speed_bound, speed, shift), _net(obstacle_turn_bound, obstacle_turn, shift)
    soft_bounds = np.concatenate([speed_bound, turn_bound, obstacle_turn_bound], axis=-1)
    turning = slice(None, lack.shape[-1] - 4)  # walls are not turned about
    has_turn = np.where(n.rotation == ROTATION["always"], is_on, is_violated & (n.rotation != ROTATION["never"]))
    is_soft = np.concatenate([is_moving & is_avoiding[..., None], has_turn[..., turning]], axis=-1)
    reach = np.sqrt(np.einsum("...kc,...kc->...k", normals, normals)) * radius[..., None]
    can_bind = is_on & (bounds > -reach)  # the others hold for every thrust of the disc
    result = project(wanted, Rows(normals, bounds, can_bind), Rows(soft, soft_bounds, is_soft), radius_m_s2=radius)
    status = np.where(flagged, int(LawStatus.INFEASIBLE), result.status)
    return result.point_m_s2, status, result.slack_m_s2, crowd, active


def kernel_rows(floats: Array, neighbours: Neighbours, p: LawParams) -> Array:
    """The same by the kernel, vehicle by vehicle: ``floats`` (..., 14) in, results (..., 6) out; see compiled.covey."""
    batch, count = floats.shape[:-1], neighbours.is_present.shape[-1]
    size = math.prod(batch)
    lead, std, intent = neighbours.lead_time_s, neighbours.velocity_std_m_s, neighbours.intent_enu_m_s
    scalars = (
        neighbours.age_s,
        np.full(neighbours.age_s.shape, np.nan) if lead is None else lead,
        neighbours.position_std_m,
        np.zeros(neighbours.age_s.shape) if std is None else std,
        neighbours.crowd_count,
    )
    vectors = (
        neighbours.position_enu_m,
        neighbours.velocity_enu_m_s,
        neighbours.predicted_position_enu_m,
        neighbours.predicted_velocity_enu_m_s,
        neighbours.commanded_acceleration_enu_m_s2,
        np.full(neighbours.position_enu_m.shape, np.nan) if intent is None else intent,
    )
    masks = (neighbours.is_present, neighbours.is_cooperative)
    if not compiled.is_compiled(size):
        one = slice(None) if not batch else (0,) * len(batch)
        return compiled.covey_one(
            floats[one].tolist(),
            [vector[one].ravel().tolist() for vector in vectors],
            [scalar[one].tolist() for scalar in scalars],
            [mask[one].tolist() for mask in masks],
            p,
        ).reshape(*batch, 6)
    return compiled.covey_batch(
        floats.reshape(size, 14),
        [compiled.flat(vector, size, 3 * count) for vector in vectors],
        [compiled.flat(scalar, size, count) for scalar in scalars],
        [compiled.flat(mask, size, count) for mask in masks],
        p,
    ).reshape(*batch, 6)


def _wishes(intent: Array, w: Array, neighbours: Neighbours, n: LawNumbers) -> tuple[Array, BoolArray]:
    """Relative velocity (..., K, 2) by which each pair chooses its turn, and who (..., K) wants to go anywhere."""
    theirs = neighbours.intent_enu_m_s
    if n.direction != DIRECTION["intent"] or theirs is None:
        return w, np.ones(w.shape[:-1], bool)
    known = np.isfinite(theirs).all(-1) & neighbours.is_cooperative
    other = _bounded(theirs[..., :2])
    wish = np.where(known[..., None], intent[..., None, :] - other, w)
    return wish, np.asarray(~known | (np.einsum("...kc,...kc->...k", other, other) > constraints.SETTLED_M_S**2))


def _net(bounds: Array, normals: Array, shift: Array) -> Array:
    """Bounds for the thrust with its compensation, of which the rows constrain what is left as net motion."""
    return np.asarray(bounds + np.einsum("...kc,...c->...k", normals, shift))


def _received(neighbours: Neighbours, n: LawNumbers) -> tuple[Array, Array, Array, BoolArray, BoolArray]:
    """Neighbours carried to our own time: position, velocity, command (..., K, 2), who counts, and who is unusable."""
    own_word = np.isfinite(neighbours.predicted_position_enu_m).all(-1)
    own_word &= np.isfinite(neighbours.predicted_velocity_enu_m_s).all(-1)
    own_word &= np.isfinite(neighbours.commanded_acceleration_enu_m_s2).all(-1) & neighbours.is_cooperative
    age = np.where(np.isfinite(neighbours.age_s), neighbours.age_s, prediction.MAX_MESSAGE_AGE_S)
    lead = np.full(age.shape, n.lead_time_s)
    if neighbours.lead_time_s is not None:
        told = neighbours.lead_time_s
        lead = np.where(np.isfinite(told), np.clip(np.nan_to_num(told), 0.0, LONGEST_LEAD_S), lead)
    command = np.where(own_word[..., None], _bounded(neighbours.commanded_acceleration_enu_m_s2[..., :2]), 0.0)
    plain_velocity = _bounded(neighbours.velocity_enu_m_s[..., :2])
    position, velocity = prediction.predict_neighbour(
        _bounded(neighbours.predicted_position_enu_m[..., :2]),
        _bounded(neighbours.predicted_velocity_enu_m_s[..., :2]),
        command,
        plain_velocity,
        age,
        lead,
        n.lead_time_s,
    )
    usable = own_word
    if not own_word.all():  # plain estimate at constant velocity up to our own lead time
        seen = np.isfinite(neighbours.position_enu_m).all(-1) & np.isfinite(neighbours.velocity_enu_m_s).all(-1)
        ahead = np.clip(age, 0.0, prediction.MAX_MESSAGE_AGE_S) + n.lead_time_s
        plain = _bounded(neighbours.position_enu_m[..., :2]) + ahead[..., None] * plain_velocity
        position = np.where(own_word[..., None], position, plain)
        velocity = np.where(own_word[..., None], velocity, plain_velocity)
        usable = own_word | seen
    is_bad = np.asarray((neighbours.is_present & ~usable).any(-1))
    return position, velocity, command, neighbours.is_present & usable, is_bad


def _paper(wanted: Array, state: State, neighbours: Neighbours, p: LawParams) -> tuple[Array, IntArray, IntArray]:
    """The pair law against the ring's successor, on plain estimates as the paper has it."""
    mask = neighbours.is_present & neighbours.is_paper_obstacle
    if mask.shape[-1] == 0:
        return wanted, np.full(mask.shape[:-1], int(LawStatus.INACTIVE)), np.full(mask.shape[:-1], -1)
    index = np.argmax(mask, axis=-1)
    has_one = mask.any(-1)
    picked = [
        np.take_along_axis(array, index[..., None, None], -2)[..., 0, :2]
        for array in (neighbours.position_enu_m, neighbours.velocity_enu_m_s, neighbours.acceleration_enu_m_s2)
    ]
    is_finite = has_one.copy()
    for vector in picked:
        is_finite &= np.isfinite(vector).all(-1)
    own_p, own_v = _bounded(state.position_enu_m[..., :2]), _bounded(state.velocity_enu_m_s[..., :2])
    q, v_o, a_o = (_bounded(vector) for vector in picked)
    result = saturate_thrust(own_p, own_v, wanted, q, v_o, a_o, params=p.paper)
    acts = is_finite & result.is_usable
    safe = np.where(acts[..., None], result.thrust_xy_m_s2, wanted)
    status = np.where(acts & result.is_changed, int(LawStatus.SATURATED), int(LawStatus.INACTIVE))
    status = np.where(has_one & ~acts, int(LawStatus.INFEASIBLE), status)
    return safe, status, np.where(acts & result.is_changed, index, -1).astype(np.int64)


def _into_disc(vector: Array, radius: Array) -> Array:
    size = np.sqrt(np.einsum("...c,...c->...", vector, vector))
    share = np.where(size > radius, radius / np.maximum(size, 1e-12), 1.0)
    return np.asarray(vector * share[..., None])


def _finite(array: Array) -> Array:
    """The array without NaN and inf; nothing is copied when there is nothing to mend, which is nearly always."""
    if np.isfinite(array).all():
        return array
    return np.nan_to_num(array, nan=0.0, posinf=HUGE, neginf=-HUGE)


def _bounded(array: Array) -> Array:
    return np.minimum(np.maximum(_finite(array), -HUGE), HUGE)
