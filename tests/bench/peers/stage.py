"""Between the pipeline's types and a peer's: what it is told, and its answer under the same limits as the law's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from onboard.avoidance import constraints, oist, prediction
from onboard.types import Array, LawOutput, LawStatus, Neighbours, State, Thrust
from tests.bench.peers.encounter import Encounter, Step, length
from tests.bench.peers.methods import NEIGHBOURS

Inputs = tuple[oist.LawMemory, Thrust, tuple[Array, Array], State, Neighbours]


def encounter_of(inputs: Inputs, params: oist.LawParams, speed_m_s: float) -> Encounter:
    """The nearest neighbours as the law would see them, flattened over the batch."""
    _, baseline, predicted, state, neighbours = inputs
    wanted, n = baseline.thrust_enu_m_s2, params.numbers
    count, others = int(np.prod(wanted.shape[:-1], dtype=np.int64)), neighbours.is_present.shape[-1]
    lead = neighbours.lead_time_s
    theirs, their_velocity = prediction.predict_neighbour(
        _either(neighbours.predicted_position_enu_m, neighbours.position_enu_m),
        _either(neighbours.predicted_velocity_enu_m_s, neighbours.velocity_enu_m_s),
        np.nan_to_num(neighbours.commanded_acceleration_enu_m_s2[..., :2]),
        np.nan_to_num(neighbours.velocity_enu_m_s[..., :2]),
        np.nan_to_num(neighbours.age_s, nan=prediction.MAX_MESSAGE_AGE_S),
        np.full(neighbours.age_s.shape, n.lead_time_s) if lead is None else np.nan_to_num(lead, nan=n.lead_time_s),
        n.lead_time_s,
    )
    unknown = np.zeros(neighbours.age_s.shape)
    their_std = (
        neighbours.position_std_m,
        unknown if neighbours.velocity_std_m_s is None else neighbours.velocity_std_m_s,
    )
    d = constraints.design_distance(
        (state.position_std_m, state.velocity_std_m_s), their_std, neighbours.is_cooperative, n
    )
    gap = (predicted[0][..., None, :2] - theirs).reshape(count, others, 2)
    closing = (predicted[1][..., None, :2] - their_velocity).reshape(count, others, 2)
    distance = length(gap)
    is_on = neighbours.is_present.reshape(count, others) & (distance < n.range_m)
    nearest = np.argsort(np.where(is_on, distance, np.inf), axis=1, kind="stable")[:, :NEIGHBOURS]
    thrust = wanted.reshape(count, 3)
    return Encounter(
        wanted_m_s2=thrust[:, :2],
        velocity_m_s=predicted[1].reshape(count, 3)[:, :2],
        gap_m=np.take_along_axis(gap, nearest[..., None], 1),
        closing_m_s=np.take_along_axis(closing, nearest[..., None], 1),
        is_on=np.take_along_axis(is_on, nearest, 1),
        reach_m_s2=oist.horizontal_limit(thrust[:, 2], params=params),
        d_m=np.take_along_axis(d.reshape(count, others), nearest, 1),
        speed_m_s=speed_m_s,
    )


def answer(
    step: Step, values: Mapping[str, float], inputs: Inputs, options: Mapping[str, Any], speed_m_s: float
) -> Array:
    """Horizontal acceleration (..., 2) that the peer commands."""
    found = step(encounter_of(inputs, options["params"], speed_m_s), values)
    return found.reshape(*inputs[1].thrust_enu_m_s2.shape[:-1], 2)


def sent(found: Array, inputs: Inputs, options: Mapping[str, Any]) -> tuple[oist.LawMemory, LawOutput]:
    """The answer through the law's own limits, remembered and published like the law's."""
    memory, baseline, predicted, state, neighbours = inputs
    wanted = baseline.thrust_enu_m_s2
    thrust = Thrust(np.concatenate([found, wanted[..., 2:]], axis=-1))
    passed_on = {**options, "params": options["params"].changed(name="off")}
    memory, output = oist.saturate(memory, thrust, predicted, state, neighbours, **passed_on)
    change = length(output.commanded_acceleration_enu_m_s2[..., :2] - wanted[..., :2])
    is_held = (change > 1e-9) & (output.status == int(LawStatus.INACTIVE))
    status = np.where(is_held, int(LawStatus.SATURATED), output.status)
    return memory, replace(output, intervention_m_s2=change, status=status)


def _either(first: Array, second: Array) -> Array:
    """Horizontal part of the first where it is a number, else of the second."""
    chosen = np.where(np.isfinite(first).all(-1, keepdims=True), first, second)
    return np.nan_to_num(chosen[..., :2])
