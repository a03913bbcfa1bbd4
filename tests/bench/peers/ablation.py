"""Covey's law with one idea taken away, or one value changed, at a time."""

from __future__ import annotations

from collections.abc import Callable

from onboard.control.pipeline import PipelineParams
from onboard.rollout.rows import Rows
from tests.bench.peers.contestants import COVEY, Contestant

_FAR = 1e6


def _law(title: str, *sets: str) -> Contestant:
    """The law with other policies or values of the fleet file."""
    return Contestant(title, sets=tuple(f"law.{item}" for item in sets))


def _kappas(first: float, second: float) -> Contestant:
    return _law(f"kappas {first:g}, {second:g}", f"kappa_1_1_s={first}", f"kappa_2_1_s={second}")


def _pipeline(title: str, change: Callable[[PipelineParams], PipelineParams]) -> Contestant:
    return Contestant(title, change=change)


def _without_clock(params: PipelineParams) -> PipelineParams:
    return params._replace(clock_slack_m=_FAR, clock_stop_m=2.0 * _FAR)


def _without_drag(params: PipelineParams) -> PipelineParams:
    return params._replace(drag_1_s=0.0, observer=params.observer._replace(drag_1_s=0.0))


def _without_observer(params: PipelineParams) -> PipelineParams:
    return params._replace(observer=params.observer._replace(max_disturbance_m_s2=0.0))


def _without_clamp(params: PipelineParams) -> PipelineParams:
    free = params.backstepping._replace(max_position_error_m=_FAR, max_height_error_m=_FAR)
    return params._replace(backstepping=free, pursuit_speed_m_s=_FAR)


def _margin(added_m: float) -> Callable[[PipelineParams], PipelineParams]:
    def change(params: PipelineParams) -> PipelineParams:
        spacing = params.law.spacing
        wider = spacing._replace(margin_m=spacing.margin_m + added_m)
        return params._replace(law=params.law._replace(spacing=wider))

    return change


def _measured(neighbours: Rows) -> Rows:
    changed = neighbours.copy()
    changed["commanded_acceleration_enu_m_s2"] = neighbours["acceleration_enu_m_s2"]
    return changed


VARIANTS = {
    "covey": COVEY,
    "no-prediction": _law("no prediction over the own lag", "prediction=none"),
    "no-prediction-slow": _law(
        "no prediction, kappas 1, 5", "prediction=none", "kappa_1_1_s=1", "kappa_2_1_s=5"
    ),
    "measured": Contestant("neighbours' measured acceleration", hear=_measured),
    "full": _law("each takes the whole row", "responsibility=full"),
    "half": _law("half each, no shortfall", "responsibility=half"),
    "gamma-1": _law("shortfall gain 1", "shortfall_gain=1.0"),
    "no-rotation": _law("no rotation rows", "rotation=never"),
    "violated": _law("rotation rows only with a violation", "rotation=violated"),
    "always": _law("rotation rows always", "rotation=always"),
    "fixed": _law("always counter-clockwise", "direction=fixed"),
    "crowd": _law("direction by motion, not intention", "direction=crowd"),
    "pair": _law("the same without the crowd rule", "direction=pair"),
    "no-governor": _law("no jam governor", "jam=ignore"),
    "no-fade": _law("turning rows at full strength at once", "rotation_fade_m_s2=0.001"),
    "no-speed": _law("no speed rows", "avoid_speed_frac=100.0"),
    "no-clock": _pipeline("the clock never slows", _without_clock),
    "no-clamp": _pipeline("no clamp of the position error", _without_clamp),
    "no-drag": _pipeline("no drag term", _without_drag),
    "no-observer": _pipeline("no disturbance observer", _without_observer),
    "kappas-1-5": _kappas(1.0, 5.0),
    "kappas-3-6": _kappas(3.0, 6.0),
    "kappas-5-10": _kappas(5.0, 10.0),
    "margin-5cm": _pipeline("5 cm less margin", _margin(-0.05)),
    "neighbours-6": _law("6 neighbours within 3 m", "max_neighbours=6", "range_m=3.0"),
}
