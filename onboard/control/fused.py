"""A pass of the pipeline for a batch in three calls of compiled code, where the array forms make some four hundred.

For batches with one set of numbers and sound input; ``step`` returns None for any other, and pipeline.step
goes through the array forms, which are the oracle: a test compares the two.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from onboard.avoidance import oist
from onboard.avoidance.prediction import CommandHistory
from onboard.control import trajectory
from onboard.estimation.disturbance_observer import ObserverMemory
from onboard.estimation.hover_thrust import HoverThrustMemory
from onboard.rollout import compiled
from onboard.types import (
    GRAVITY_M_S2,
    Array,
    AttitudeSetpoint,
    Goal,
    LawOutput,
    LawStatus,
    Neighbours,
    State,
    Thrust,
    Tick,
    TrajectorySetpoint,
)

if TYPE_CHECKING:
    from onboard.control.pipeline import PipelineMemory, PipelineParams

Numbers = tuple[tuple[float, ...], ...]


def numbers(params: PipelineParams, dt_s: float, is_gentle: bool, is_flying: bool) -> tuple[Numbers, Numbers] | None:
    """What ``kernel_pass.before`` and ``after`` compute with; None where vehicles of the batch differ."""
    o, h, b, g, a, law = (
        params.observer, params.hover_thrust, params.backstepping, params.guidance, params.allocation, params.law,
    )  # fmt: skip
    values = (
        o.bandwidth_rad_s, o.wn_rad_s, o.zeta, o.vertical_lag_s, o.drag_1_s, o.max_disturbance_m_s2, h.configured_frac,
        h.min_thrust_frac, h.max_thrust_frac, b.position_gain_1_s, b.velocity_gain_1_s, b.coupling_1_s2,
        b.max_position_error_m, b.max_acceleration_m_s2, b.max_vertical_acceleration_m_s2, g.max_speed_m_s,
        a.max_tilt_rad, a.min_thrust_frac, a.max_thrust_frac,
    )  # fmt: skip
    if not all(isinstance(value, (float, int)) for value in values):
        return None
    width, wn, zeta, vertical, drag, most, hover, low, high, k_1, k_2, c, widest, largest, highest, _, tilt, *limits = (
        float(value) for value in values
    )
    decay = math.exp(-width * dt_s)
    tan_tilt = math.tan(law.max_tilt_rad)
    lag = law.lag_s
    before = (
        (dt_s, float(is_gentle)),
        (o.delay_s, wn, zeta, 1.0 - decay * decay, (1.0 - decay) ** 2 / dt_s, drag, most,
         1.0 - math.exp(-dt_s / vertical)),
        (1.0 - math.exp(-dt_s / h.motor_lag_s), h.time_constant_s, h.min_height_m, h.max_acceleration_m_s2, low, high,
         (1.0 - h.max_deviation) * hover, (1.0 + h.max_deviation) * hover, float(is_flying)),
        (params.clock_slack_m, params.clock_stop_m, 1.0 - math.exp(-dt_s / params.clock_time_s)),
        (float(law.config.prediction != "none"), lag, min(law.vertical_lag_s, lag)),
        (k_1, k_2, c, widest, largest, highest),
        (params.pursuit_speed_m_s, law.max_speed_m_s),
        (0.5 * GRAVITY_M_S2 * tan_tilt, 0.5 * (law.max_thrust_m_s2 - GRAVITY_M_S2), law.max_thrust_m_s2, tan_tilt),
        (float(law.config.jam != "ignore"), float(law.numbers.crowd_count)),
    )  # fmt: skip
    after = (
        (dt_s, 0.0),
        (math.tan(tilt), *limits),
        (1.0 - math.exp(-dt_s / params.activity_time_s), oist.relaxed_blend(dt_s), float(LawStatus.RELAXED)),
    )
    return tuple(tuple(map(float, part)) for part in before), after


_KNOWN: dict[tuple[int, float, bool, bool], tuple[PipelineParams, tuple[Numbers, Numbers] | None]] = {}


def _known_numbers(params: PipelineParams, *how: float | bool) -> tuple[Numbers, Numbers] | None:
    """:func:`numbers`, kept for the last few parameters and tick lengths."""
    key = (id(params), *how)
    found = _KNOWN.get(key)  # type: ignore[arg-type]
    if found is None or found[0] is not params:
        if len(_KNOWN) > 500:
            _KNOWN.clear()
        found = _KNOWN[key] = params, numbers(params, *how)  # type: ignore[arg-type, index]
    return found[1]


def step(
    memory: PipelineMemory, state: State, goal: Goal, neighbours: Neighbours, params: PipelineParams, dt_s: float,
    *, is_gentle: bool, is_flying: bool,
) -> tuple[PipelineMemory, Tick] | None:  # fmt: skip
    """One tick of a batch as pipeline.step makes it with a yaw of 0; None when that is not for this way."""
    leg, law, observer, lift = memory.guidance, memory.law, memory.observer, memory.hover_thrust
    shape = state.position_enu_m.shape[:-1]
    size = math.prod(shape)
    if params.law.name != "covey" or not size or not compiled.uses_kernel(max(size, 2)):
        return None
    known = _known_numbers(params, dt_s, is_gentle, is_flying)
    if known is None:
        return None
    # which way a row goes must not depend on the other rows: a batch of one, and rows with a new leg, go through here
    leg = trajectory.planned(leg, goal, params=params.guidance)
    flat = compiled.flat
    slots, kept = observer.commands_enu_m_s2.shape[-2], law.history.duration_s.shape[-1]
    history = flat(law.history.acceleration_enu_m_s2, size, 3 * kept), flat(law.history.duration_s, size, kept)
    vectors = (
        state.position_enu_m, state.velocity_enu_m_s, state.acceleration_enu_m_s2, goal.position_enu_m,
        observer.velocity_enu_m_s, observer.disturbance_enu_m_s2, observer.response_enu_m_s2,
        observer.response_rate_enu_m_s3, memory.sent_enu_m_s2,
    )  # fmt: skip
    way = (
        leg.start_position_enu_m, leg.start_velocity_enu_m_s, leg.start_acceleration_enu_m_s2, leg.via_position_enu_m,
        leg.goal_position_enu_m,
    )  # fmt: skip
    scalars = (
        leg.first_duration_s, leg.second_duration_s, leg.elapsed_s, lift.hover_thrust_frac, lift.effective_thrust_frac,
        memory.thrust_frac, memory.cos_tilt, memory.activity, memory.clock_rate, law.relaxed_share, law.held_s,
        state.age_s, state.position_std_m, state.velocity_std_m_s,
    )  # fmt: skip
    rows = tuple([flat(scalar, size) for scalar in scalars])
    out, out_1, commands = np.empty((12, size, 3)), np.empty((4, size)), np.empty((size, slots, 3))
    floats = np.empty((size, 14))
    is_sound = compiled.before_batch(
        tuple([flat(vector, size, 3) for vector in vectors]), tuple([flat(vector, size, 3) for vector in way]), rows,
        flat(observer.commands_enu_m_s2, size, slots, 3), *history, known[0], out, out_1, commands, floats,
    )  # fmt: skip
    if not is_sound:
        return None
    result = oist.kernel_rows(floats.reshape(*shape, 14), neighbours, params.law)
    sent, quaternion, told = np.empty((3, size, 3)), np.empty((size, 4)), np.empty((6, size))
    recorded = np.empty_like(history[0]), np.empty_like(history[1])
    compiled.after_batch(
        result.reshape(size, 6), floats, out, out_1[0], (rows[7], rows[9], rows[10]), *history, known[1], sent,
        quaternion, told, *recorded,
    )  # fmt: skip
    seen, disturbance, response, rate, s_p, s_v, s_a, p, v, baseline, _, intent = out.reshape(12, *shape, 3)
    hover, effective, clock, elapsed = out_1.reshape(4, *shape)
    thrust, acceleration, command = sent.reshape(3, *shape, 3)
    relaxed, held_s, throttle, cos_tilt, activity, moved = told.reshape(6, *shape)
    after = type(memory)(
        trajectory.GuidanceMemory(*way, *scalars[:2], elapsed, np.clip(clock, 0.0, 1.0), leg.sequence),
        oist.LawMemory(
            CommandHistory(recorded[0].reshape(*shape, kept, 3), recorded[1].reshape(*shape, kept)), relaxed, held_s
        ),
        ObserverMemory(seen, disturbance, response, rate, commands.reshape(*shape, slots, 3)),
        HoverThrustMemory(hover, effective),
        command, clock, activity, throttle, cos_tilt,
    )  # fmt: skip
    kinds = result[..., 2::3].astype(np.int64)
    output = LawOutput(
        Thrust(thrust), p, v, acceleration, kinds[..., 0], moved, result[..., 3], result[..., 4], kinds[..., 1],
        _filled(params.law.numbers.lead_time_s, shape), intent,
    )  # fmt: skip
    attitude = AttitudeSetpoint(quaternion.reshape(*shape, 4), throttle)
    is_finite = np.ones(shape, bool)
    return after, Tick(state, TrajectorySetpoint(s_p, s_v, s_a), Thrust(baseline), output, attitude, hover, is_finite)


def _filled(value: float, shape: tuple[int, ...]) -> Array:
    found = np.empty(shape)
    found.fill(value)
    return found
