"""The values that pass between two stages of the pipeline: frozen, batched, in fleet ENU.

Every array carries leading batch axes: vectors are ``(..., 3)``, scalars ``(...)``, neighbours ``(..., K, 3)`` with a
mask ``(..., K)``. The drone uses no batch axis; a campaign uses one axis of flights (and one of vehicles).
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, field, fields, make_dataclass
from enum import IntEnum
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

GRAVITY_M_S2 = 9.80665

_T = TypeVar("_T")


def light(cls: type[_T]) -> type[_T]:
    """For a frozen dataclass of which a tick makes many: to the type checker it stays frozen, at run time it is cheap.

    A frozen dataclass sets each field by a call past its own lock, four times as dear as setting it. Here the lock is
    left to mypy, which sees every module of the project.
    """
    entries: list[Any] = []
    for one in fields(cls):  # type: ignore[arg-type]
        given = field() if one.default is MISSING else field(default=one.default)
        entries.append((one.name, one.type, given))
    plain: Any = make_dataclass(cls.__name__, entries)
    cls.__init__ = plain.__init__  # type: ignore[method-assign]
    del cls.__setattr__, cls.__delattr__
    return cls


class LawStatus(IntEnum):
    """What the avoidance law did to the thrust of this tick; never dropped."""

    INACTIVE = 0  # the baseline thrust already satisfies every row
    SATURATED = 1  # changed, all hard rows satisfied
    RELAXED = 2  # no thrust satisfies all hard rows: the smallest common slack was granted
    INFEASIBLE = 3  # inputs not usable (for instance coincident vehicles): bounded fallback


@light
@dataclass(frozen=True, slots=True)
class State:
    """Estimate of the own motion, valid now.

    position_enu_m, velocity_enu_m_s, acceleration_enu_m_s2: (..., 3); yaw_rad, age_s, position_std_m and
    velocity_std_m_s: (...). ``age_s`` is how far the estimate lags behind now (0 for one propagated to now).
    """

    position_enu_m: Array
    velocity_enu_m_s: Array
    acceleration_enu_m_s2: Array
    yaw_rad: Array
    age_s: Array
    position_std_m: Array
    velocity_std_m_s: Array


@light
@dataclass(frozen=True, slots=True)
class Goal:
    """Where the vehicle shall go and how; the input of guidance.

    position_enu_m (..., 3). duration_s (...): time for the leg, 0 = as fast as the limits allow. sequence (...):
    changes when a new leg begins, so that guidance knows to plan anew.
    """

    position_enu_m: Array
    duration_s: Array
    sequence: IntArray


@light
@dataclass(frozen=True, slots=True)
class TrajectorySetpoint:
    """What the vehicle would do if it were alone: (..., 3) each."""

    position_enu_m: Array
    velocity_enu_m_s: Array
    acceleration_enu_m_s2: Array


@light
@dataclass(frozen=True, slots=True)
class Thrust:
    """Mass-normalised thrust F/m in fleet ENU (..., 3) [m/s^2]; hover is (0, 0, g)."""

    thrust_enu_m_s2: Array


@light
@dataclass(frozen=True, slots=True)
class AttitudeSetpoint:
    """What goes to PX4, still in ENU/FLU: quaternion_wxyz (..., 4) rotates FLU to ENU; thrust_frac (...) in [0, 1]."""

    quaternion_wxyz: Array
    thrust_frac: Array


@light
@dataclass(frozen=True, slots=True)
class Neighbours:
    """A frozen snapshot of the neighbours, as received; extrapolation over their age is the law's business.

    position/velocity/acceleration_enu: plain estimate (..., K, 3), the paper's inputs. predicted_* and
    commanded_acceleration: state predicted over the sender's own lag and its command (..., K, 3). age_s (..., K): now
    minus the stamp. crowd_count (..., K). is_present (..., K) mask; masked entries may hold anything.
    is_cooperative (..., K): False asks for full responsibility on our side. is_paper_obstacle (..., K): this is the
    ring's successor, the only neighbour that the paper-exact law sees. lead_time_s (..., K): how far ahead of the stamp
    the predicted state lies (None: as far as our own). velocity_std_m_s (..., K); None: not known. intent_enu_m_s
    (..., K, 3): velocity that it would fly if it were alone; None: not known.
    """

    position_enu_m: Array
    velocity_enu_m_s: Array
    acceleration_enu_m_s2: Array
    predicted_position_enu_m: Array
    predicted_velocity_enu_m_s: Array
    commanded_acceleration_enu_m_s2: Array
    age_s: Array
    position_std_m: Array
    crowd_count: Array
    is_present: BoolArray
    is_cooperative: BoolArray
    is_paper_obstacle: BoolArray
    lead_time_s: Array | None = None
    velocity_std_m_s: Array | None = None
    intent_enu_m_s: Array | None = None


@light
@dataclass(frozen=True, slots=True)
class LawOutput:
    """The avoidance law's result: the same type in and out, plus what it did.

    commanded_acceleration_enu_m_s2 (..., 3) is published to the neighbours (P2 of the design); intervention_m_s2 (...)
    is |u - u0|; slack_m_s2 (...) is 0 unless relaxed; crowd_count (...) is published; active_neighbour (...) is the
    index of the neighbour whose row binds most, -1 for none, -2 for an obstacle or the fence. lead_time_s (...) is
    published: how far ahead of now the predicted state lies. intent_enu_m_s (..., 3) is published: see Neighbours.
    """

    thrust: Thrust
    predicted_position_enu_m: Array
    predicted_velocity_enu_m_s: Array
    commanded_acceleration_enu_m_s2: Array
    status: IntArray
    intervention_m_s2: Array
    slack_m_s2: Array
    crowd_count: Array
    active_neighbour: IntArray
    lead_time_s: Array
    intent_enu_m_s: Array


@light
@dataclass(frozen=True, slots=True)
class Tick:
    """Every intermediate value of one pass of the pipeline: logged, replayed, shown, asserted."""

    state: State
    setpoint: TrajectorySetpoint
    thrust_baseline: Thrust
    law: LawOutput
    attitude: AttitudeSetpoint
    hover_thrust_frac: Array
    is_finite: BoolArray
