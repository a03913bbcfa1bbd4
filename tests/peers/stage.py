"""A peer in the place of Covey's law: the same inputs, the same limits after it, the same types out.

The pipeline around it, from the estimate to the attitude, stays as it is.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from onboard.control import oist, prediction
from onboard.types import Array, LawOutput, LawStatus, Neighbours, State, Thrust
from tests.peers.encounter import Encounter, Step, length
from tests.peers.methods import NEIGHBOURS


def encounter_of(
    baseline: Thrust, predicted: tuple[Array, Array], neighbours: Neighbours, params: oist.LawParams, speed_m_s: float
) -> Encounter:
    """The nearest neighbours as the law would see them, flattened over the batch."""
    wanted = baseline.thrust_enu_m_s2
    count = int(np.prod(wanted.shape[:-1], dtype=np.int64))
    theirs, their_velocity = prediction.predict_neighbour(
        np.nan_to_num(neighbours.predicted_position_enu_m[..., :2]),
        np.nan_to_num(neighbours.predicted_velocity_enu_m_s[..., :2]),
        np.nan_to_num(neighbours.commanded_acceleration_enu_m_s2[..., :2]),
        np.nan_to_num(neighbours.age_s, nan=prediction.MAX_MESSAGE_AGE_S),
    )
    gap = (predicted[0][..., None, :2] - theirs).reshape(count, -1, 2)
    closing = (predicted[1][..., None, :2] - their_velocity).reshape(count, -1, 2)
    distance = length(gap)
    is_on = neighbours.is_present.reshape(count, -1) & (distance < params.range_m)
    nearest = np.argsort(np.where(is_on, distance, np.inf), axis=1, kind="stable")[:, :NEIGHBOURS]
    thrust = wanted.reshape(count, 3)
    return Encounter(
        wanted_m_s2=thrust[:, :2],
        velocity_m_s=predicted[1].reshape(count, 3)[:, :2],
        gap_m=np.take_along_axis(gap, nearest[..., None], 1),
        closing_m_s=np.take_along_axis(closing, nearest[..., None], 1),
        is_on=np.take_along_axis(is_on, nearest, 1),
        reach_m_s2=oist.horizontal_limit(thrust[:, 2], params=params),
        d_m=params.d_design_m,
        speed_m_s=speed_m_s,
    )


class PeerLaw:
    """Stands where the pipeline has ``onboard.control.oist``: everything is the law's but :meth:`saturate`."""

    initial = staticmethod(oist.initial)
    predict = staticmethod(oist.predict)
    speed_share = staticmethod(oist.speed_share)
    is_plausible = staticmethod(oist.is_plausible)
    LawParams = oist.LawParams

    def __init__(self, step: Step, values: Mapping[str, float], speed_m_s: float) -> None:
        self.step, self.values, self.speed_m_s = step, values, speed_m_s
        self.busy_s, self.vehicle_steps = 0.0, 0

    def saturate(
        self,
        memory: oist.LawMemory,
        thrust_baseline: Thrust,
        predicted: tuple[Array, Array],
        state: State,
        neighbours: Neighbours,
        *,
        params: oist.LawParams,
        dt_s: float,
        compensation_enu_m_s2: Array | None = None,
    ) -> tuple[oist.LawMemory, LawOutput]:
        """As the law's own, with the peer's answer."""
        begun = time.perf_counter()
        encounter = encounter_of(thrust_baseline, predicted, neighbours, params, self.speed_m_s)
        found = self.step(encounter, self.values)
        self.busy_s += time.perf_counter() - begun
        self.vehicle_steps += len(found)
        wanted = thrust_baseline.thrust_enu_m_s2
        thrust = np.concatenate([found.reshape(*wanted.shape[:-1], 2), wanted[..., 2:]], axis=-1)
        memory, output = oist.saturate(
            memory,
            Thrust(thrust),
            predicted,
            state,
            neighbours,
            params=replace(params, name="off"),
            dt_s=dt_s,
            compensation_enu_m_s2=compensation_enu_m_s2,
        )
        change = length(output.commanded_acceleration_enu_m_s2[..., :2] - wanted[..., :2])
        status = np.where(change > 1e-9, int(LawStatus.SATURATED), int(LawStatus.INACTIVE))
        return memory, replace(
            output,
            intervention_m_s2=change,
            status=np.where(output.status == int(LawStatus.INFEASIBLE), output.status, status),
        )
