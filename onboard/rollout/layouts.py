"""Layouts of all values that batches keep as rows of floats (:mod:`onboard.rollout.rows`)."""

from __future__ import annotations

from typing import NamedTuple

from onboard.avoidance import interface, oist, own_law, pairs, prediction
from onboard.avoidance.params import Capsule
from onboard.control import pipeline
from onboard.estimation import kalman, wind
from onboard.rollout.rows import Layout, zero
from onboard.types import Goal, LawOutput, Neighbour, State, Tick, TrajectorySetpoint
from onboard.vectors import ZERO_3


class EstimatorMemory(NamedTuple):
    """Memory of the estimate of one vehicle."""

    motion: kalman.KalmanMemory
    wind: wind.WindMemory


class CoveyResults(NamedTuple):
    """What is computed of one vehicle before its user's law is called, and needed after it."""

    before: pipeline.BeforeLaw
    memory: oist.LawMemory  # of Covey's law, after the tick
    output: LawOutput  # of Covey's law


class OwnLawView(NamedTuple):
    """What a user's law gets of the vehicle itself, besides its estimate."""

    own: pairs.Own
    baseline: interface.Baseline
    predicted: prediction.Motion


ZERO_PARAMS = zero(pipeline.PipelineParams)
_ZERO_MEMORY = pipeline.initial(ZERO_PARAMS, ZERO_3)
_ZERO_BEFORE_LAW = pipeline.BeforeLaw(
    observer=_ZERO_MEMORY.observer,
    hover_thrust=_ZERO_MEMORY.hover_thrust,
    clock_rate=_ZERO_MEMORY.clock_rate,
    trajectory=_ZERO_MEMORY.trajectory,
    setpoint=zero(TrajectorySetpoint),
    baseline=zero(interface.Baseline),
    motion=zero(prediction.Motion),
    is_usable=False,
)

STATE = Layout(zero(State))
GOAL = Layout(zero(Goal))
NEIGHBOUR = Layout(zero(Neighbour))
OBSTACLE = Layout(zero(Capsule))
TICK = Layout(zero(Tick))
PARAMS = Layout(ZERO_PARAMS)
MEMORY = Layout(_ZERO_MEMORY)
COVEY_RESULTS = Layout(CoveyResults(_ZERO_BEFORE_LAW, _ZERO_MEMORY.law, zero(LawOutput)))
OWN_LAW_VIEW = Layout(zero(OwnLawView))
LAW_NEIGHBOUR = Layout(zero(own_law.LawNeighbour))
FILTER_PARAMS = Layout(kalman.KalmanParams())
FILTER = Layout(EstimatorMemory(kalman.initial(ZERO_3, kalman.KalmanParams()), wind.initial()))

ALL = (
    STATE,
    GOAL,
    NEIGHBOUR,
    TICK,
    OBSTACLE,
    PARAMS,
    MEMORY,
    COVEY_RESULTS,
    OWN_LAW_VIEW,
    LAW_NEIGHBOUR,
    FILTER_PARAMS,
    FILTER,
)
