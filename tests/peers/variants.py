"""Covey's law with one idea taken away at a time, as values of its own parameters wherever the law has them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from onboard.control.pipeline import PipelineParams
from onboard.types import Neighbours

Params = Callable[[PipelineParams], PipelineParams]


def same(values: Any) -> Any:
    """Nothing taken away."""
    return values


@dataclass(frozen=True, slots=True)
class Variant:
    """``title`` for the table; ``law`` replaces values of LawParams, ``params`` changes the pipeline's.

    ``neighbours`` changes what is heard; ``has_governor`` False: a jam slows nobody down.
    """

    title: str
    law: Mapping[str, Any] = field(default_factory=dict)
    params: Params = same
    neighbours: Callable[[Neighbours], Neighbours] = same
    has_governor: bool = True

    def applied(self, params: PipelineParams) -> PipelineParams:
        """Parameters of one vehicle without the idea."""
        changed = self.params(params)
        return replace(changed, law=replace(changed.law, **self.law))


def _without_prediction(params: PipelineParams) -> PipelineParams:
    law = replace(params.law, lag_s=0.0, vertical_lag_s=0.0)
    return replace(params, law=law, guidance=replace(params.guidance, lag_s=0.0))


def _without_clock(params: PipelineParams) -> PipelineParams:
    return replace(params, clock_slack_m=1e6, clock_stop_m=2e6)


def _without_drag(params: PipelineParams) -> PipelineParams:
    return replace(params, drag_1_s=0.0, observer=replace(params.observer, drag_1_s=0.0))


def _without_observer(params: PipelineParams) -> PipelineParams:
    return replace(params, observer=replace(params.observer, max_disturbance_m_s2=0.0))


def _without_clamp(params: PipelineParams) -> PipelineParams:
    bounded = replace(params.backstepping, max_position_error_m=1e3)
    return replace(params, backstepping=bounded, pursuit_speed_m_s=1e3)


def _measured(neighbours: Neighbours) -> Neighbours:
    return replace(neighbours, commanded_acceleration_enu_m_s2=neighbours.acceleration_enu_m_s2)


def _kappas(first: float, second: float) -> dict[str, float]:
    return {"kappa_1_1_s": first, "kappa_2_1_s": second}
