"""Output-to-input saturation (OIST) for N neighbours: the baseline thrust in, a safe thrust out,
equal types.

The paper's section 3 in its order. The outputs to constrain are the distance of a pair (5) and its
orthoradial velocity (6). Their derivatives (10) turn the limits (7), (8) into bounds h_1, h_2 of
the input (20), (21): constraints.py. The paper saturates the input of one pair at its two bounds
(22), which is the projection of the thrust on two half-planes; here it is projected on those of all
neighbours, obstacles and walls, and on the disc that tilt and thrust can deliver: projection.py.
The rows are evaluated where the vehicle will be when its command takes effect: prediction.py.

The vertical thrust is never touched, so that height is not traded for separation. README.md beside
this file has the symbols, the algorithm's lines (P1 to O) and the deviations from the paper (D1 to
D16).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from onboard.avoidance import oist_paper
from onboard.avoidance.constraints import (
    can_bind,
    compensated,
    conflict,
    distance_row,
    faded,
    fence_rows,
    obstacle_rotation_row,
    obstacle_row,
    promised_row,
    rotation_row,
    speed_row,
    violation,
)
from onboard.avoidance.half_planes import HalfPlane
from onboard.avoidance.interface import (
    INFEASIBLE,
    NOBODY,
    NOT_A_VEHICLE,
    Answer,
    Baseline,
    output_of,
    own_at,
)
from onboard.avoidance.pairs import (
    NeighbourPair,
    Own,
    Surface,
    climb_share,
    nearest_pairs,
    nearest_surfaces,
)
from onboard.avoidance.params import (
    COVEY,
    JAM_IGNORE,
    PAPER,
    PREDICTION_NONE,
    ROTATION_AHEAD,
    ROTATION_ALWAYS,
    ROTATION_NEVER,
    Capsule,
    LawParams,
)
from onboard.avoidance.prediction import (
    MAX_MESSAGE_AGE_S,
    Motion,
    PastCommand,
    no_commands,
    predict_own,
    remembered,
)
from onboard.avoidance.projection import INACTIVE, RELAXED, Projection, project, relaxed_in_order
from onboard.types import LawOutput, Neighbour, State
from onboard.vectors import ZERO_2, dot_2, length_2

HELD_S, ROUNDABOUT_S = 3.0, 5.0  # held so long, a vehicle calls for a roundabout, for so long
# held: intends to go, and gets on with less than this share of it
_HELD_INTENT_2_M2_S2, _HELD_FRAC = 0.04, 0.2
_VIOLATED_M_S2 = 1e-10
_STANDING_M_S = 1e-6
_NO_ROW = HalfPlane(ZERO_2, -math.inf)


class LawMemory(NamedTuple):
    """State of the law between two ticks."""

    commands: list[PastCommand]  # own past commands, newest first
    relaxed_share: float  # low-passed share of ticks whose hard rows had to be relaxed
    # time for which the law has held the vehicle back; negative while it calls for a roundabout
    held_s: float
    climb_share: float  # how fast a climb or descent may go on, from 0 to 1


class Constraint(NamedTuple):
    """The rows of one neighbour, obstacle or wall."""

    row: HalfPlane  # hard: keeps the distance
    turn: HalfPlane  # soft: turns about it
    is_turning: bool  # whether there is a soft row
    violation_m_s2: float  # of the hard row by the baseline
    table_index: int  # of the neighbour, or NOT_A_VEHICLE


def initial() -> LawMemory:
    """Return the memory before the first command."""
    return LawMemory(no_commands(), 0.0, 0.0, 1.0)


def predict(memory: LawMemory, state: State, params: LawParams) -> Motion:
    """Return the own motion when a command of now takes effect, at t + L (line P1).

    With the paper's law, or where the policy says so, there is no prediction.

    Args:
        memory: holds the past commands.
        state: own estimate.
    """
    now = Motion(state.position_enu_m, state.velocity_enu_m_s)
    if params.law == PAPER or params.policies.prediction == PREDICTION_NONE:
        return now
    age_s = 0.0 if math.isnan(state.age_s) else min(max(state.age_s, 0.0), MAX_MESSAGE_AGE_S)
    return predict_own(memory.commands, now, params.lag_s + age_s, params.vertical_lag_s + age_s)


def speed_share(memory: LawMemory, params: LawParams) -> float:
    """Return the share of the speed limit that is left in a jam (line G): relaxed rows slow the
    pursuit, by policy.

    Args:
        memory: holds the share of relaxed ticks.
        params: holds the policy.
    """
    if params.policies.jam == JAM_IGNORE:
        return 1.0
    return max(0.1, 1.0 - 1.5 * memory.relaxed_share)


def step(
    memory: LawMemory,
    baseline: Baseline,
    predicted: Motion,
    state: State,
    neighbours: Sequence[Neighbour],
    obstacles: Sequence[Capsule],
    params: LawParams,
    dt_s: float,
) -> tuple[LawMemory, LawOutput]:
    """Return the memory and the safe thrust of this tick.

    Implements: (5)-(22) for N neighbours, or the paper's pair law, or the identity, by
    ``params.law``.

    Args:
        memory: of the last tick.
        baseline: thrust of the backstepping [m/s^2], compensation and intent.
        predicted: own motion from :func:`predict`.
        state: own estimate; the paper's law uses it as it is.
        neighbours: as received, in any order.
        obstacles: static ones.
        params: numbers of this vehicle's law.
        dt_s: time since the last tick.
    Returns:
        Memory and output. Input that cannot be used gives a bounded thrust with the status
        INFEASIBLE. Where the own motion is not finite the thrust is level and the published
        prediction NaN.
    Properties: rotation- and translation-equivariant about the vertical; independent of the
    neighbours' order.
    """
    own = own_at(baseline, predicted, state, params)
    if params.law == COVEY:
        answer = saturate(own, neighbours, obstacles, memory.held_s < 0.0, params)
    elif params.law == PAPER:
        answer = oist_paper.saturate_pair(own, state, neighbours, params)
    else:
        answer = Answer(own.thrust_m_s2, INACTIVE, 0.0, 0.0, NOBODY)
    output = output_of(answer, own, baseline, predicted, params)
    relaxed = 1.0 if output.status == RELAXED else 0.0
    relaxed_share = memory.relaxed_share + relaxed_blend(dt_s) * (relaxed - memory.relaxed_share)
    held_s = held(memory.held_s, own, output.active_neighbour >= 0, dt_s)
    commands = remembered(memory.commands, output.commanded_acceleration_enu_m_s2, dt_s)
    climb = climb_share(own, neighbours, params) if params.law == COVEY else 1.0
    return LawMemory(commands, relaxed_share, held_s, climb), output


def saturate(
    own: Own,
    neighbours: Sequence[Neighbour],
    obstacles: Sequence[Capsule],
    is_roundabout: bool,
    params: LawParams,
) -> Answer:
    """Return the thrust nearest to the baseline's that satisfies the rows of all neighbours,
    obstacles and walls.

    Implements: (22) for N neighbours; lines P3, D, R and Q. DEVIATION D8, D13.

    Args:
        own: this vehicle at t + L.
        is_roundabout: whether this vehicle has been held for long and calls for a roundabout.
    """
    pairs, crowd_count, are_sound = nearest_pairs(own, neighbours, params)
    if is_roundabout:
        crowd_count = max(crowd_count, float(params.gains.crowd_count))
    constraints = [neighbour_constraint(own, pair, crowd_count, params) for pair in pairs]
    surfaces = nearest_surfaces(own, obstacles, params.spacing.clearance_m)
    constraints.extend([obstacle_constraint(own, surface, params) for surface in surfaces])
    walls = fence_rows(own.position_m, own.velocity_m_s, params.fence, params.gains)
    constraints.extend([wall_constraint(own, wall) for wall in walls])
    worst, active = _VIOLATED_M_S2, NOBODY
    for constraint in constraints:
        if constraint.violation_m_s2 > worst:
            worst, active = constraint.violation_m_s2, constraint.table_index
    turns = [c.turn for c in constraints if c.is_turning]  # the last one is dropped first
    if active == NOBODY and len(turns) == 0:
        status = INACTIVE if are_sound else INFEASIBLE
        return Answer(own.thrust_m_s2, status, 0.0, crowd_count, NOBODY)
    found = nearest_thrust(own, pairs, [c.row for c in constraints], turns, params)
    return Answer(
        found.point, found.status if are_sound else INFEASIBLE, found.slack, crowd_count, active
    )


def nearest_thrust(
    own: Own,
    pairs: list[NeighbourPair],
    rows: list[HalfPlane],
    soft: list[HalfPlane],
    params: LawParams,
) -> Projection:
    """Return the nearest thrust for all rows; where none fits, margins and speed give way before
    promises and walls.

    Implements: line Q.

    Args:
        own: this vehicle at t + L.
        pairs: with the neighbours that count.
        rows: of these pairs in their order, then of obstacles and walls.
        soft: rows in order of importance; the last is dropped first.
    """
    kept = [row for row in rows[: len(pairs)] if can_bind(row, own.radius_m_s2)]
    if length_2(own.velocity_m_s) > _STANDING_M_S and not is_fleeing(own, pairs, rows):
        kept.append(
            compensated(speed_row(own.velocity_m_s, params.top_speed_m_s), own.compensation_m_s2)
        )
    static = [row for row in rows[len(pairs) :] if can_bind(row, own.radius_m_s2)]
    found = project(own.thrust_m_s2, kept + static, soft, own.radius_m_s2)
    if found.status != RELAXED:
        return found
    promises = [compensated(promised_row(pair, params), own.compensation_m_s2) for pair in pairs]
    firm = [row for row in promises if can_bind(row, own.radius_m_s2)] + static
    return relaxed_in_order(own.thrust_m_s2, kept, firm, own.radius_m_s2)


def is_fleeing(own: Own, pairs: list[NeighbourPair], rows: list[HalfPlane]) -> bool:
    """Whether a neighbour that does not cooperate is near enough to matter: then no speed is too
    high.

    Args:
        own: this vehicle at t + L.
        pairs: with the neighbours that count.
        rows: that keep their distance, in the same order.
    """
    strangers = [
        k
        for k in range(len(pairs))
        if not pairs[k].is_cooperative and can_bind(rows[k], own.radius_m_s2)
    ]
    return len(strangers) > 0


def neighbour_constraint(
    own: Own, pair: NeighbourPair, crowd_count: float, params: LawParams
) -> Constraint:
    """Return the rows of one neighbour: its distance (line D), and turning as far as it is asked
    for (line R).

    Args:
        own: this vehicle at t + L.
        crowd_count: of this vehicle.
    """
    row = compensated(distance_row(pair, params), own.compensation_m_s2)
    missing = violation(row, own.thrust_m_s2)
    strength = turning_strength(missing, pair, params)
    if strength <= 0.0:
        return Constraint(row, _NO_ROW, False, missing, pair.table_index)
    is_crowded = max(crowd_count, pair.crowd_count) >= params.gains.crowd_count
    turn = compensated(
        rotation_row(pair, own.velocity_m_s, is_crowded, params), own.compensation_m_s2
    )
    return Constraint(row, faded(turn, own.thrust_m_s2, strength), True, missing, pair.table_index)


def turning_strength(violation_m_s2: float, pair: NeighbourPair, params: LawParams) -> float:
    """Return how much of a neighbour's rotation row counts, from 0 to 1, by policy. DEVIATION D4,
    D15.

    ahead: with the violation, and before it as far as the ways that both intend come too near;
    violated: with the violation alone.

    Args:
        violation_m_s2: of the distance row by the baseline.
        pair: this vehicle and the neighbour at t + L.
    """
    rotation = params.policies.rotation
    if rotation == ROTATION_ALWAYS:
        return 1.0
    strength = (
        violation_m_s2 / params.gains.rotation_fade_m_s2
        if is_turning(violation_m_s2, rotation)
        else 0.0
    )
    if rotation == ROTATION_AHEAD:
        strength = max(strength, conflict(pair.e, pair.intent_m_s, pair.d_m))
    return min(strength, 1.0)


def obstacle_constraint(own: Own, surface: Surface, params: LawParams) -> Constraint:
    """Return the rows of one static obstacle: its distance, and turning while that is violated.

    Args:
        own: this vehicle at t + L.
        surface: the obstacle's nearest point.
    """
    row = compensated(obstacle_row(surface, params.gains), own.compensation_m_s2)
    missing = violation(row, own.thrust_m_s2)
    if not is_turning(missing, params.policies.rotation):
        return Constraint(row, _NO_ROW, False, missing, NOT_A_VEHICLE)
    turn = obstacle_rotation_row(surface, own.velocity_m_s, own.intent_m_s, params)
    return Constraint(row, compensated(turn, own.compensation_m_s2), True, missing, NOT_A_VEHICLE)


def wall_constraint(own: Own, wall: HalfPlane) -> Constraint:
    """Return the row of one wall of the fence; it is not turned about.

    Args:
        own: this vehicle at t + L.
        wall: one of :func:`fence_rows`.
    """
    row = compensated(wall, own.compensation_m_s2)
    return Constraint(row, _NO_ROW, False, violation(row, own.thrust_m_s2), NOT_A_VEHICLE)


def is_turning(violation_m_s2: float, rotation: int) -> bool:
    """Whether the policy asks for a rotation row because of the violation of the distance row
    alone.

    Args:
        violation_m_s2: of the distance row by the baseline.
        rotation: the policy.
    """
    return rotation == ROTATION_ALWAYS or (
        rotation != ROTATION_NEVER and violation_m_s2 > _VIOLATED_M_S2
    )


def held(held_s: float, own: Own, is_active: bool, dt_s: float) -> float:
    """Return the next ``LawMemory.held_s``: it counts while the law keeps a vehicle that intends to
    go from getting on.

    Two parked neighbours with a gap too narrow between them hold a vehicle for ever: each row asks
    for a turn that the other forbids. Held for HELD_S it calls for a roundabout, which leads around
    both, for ROUNDABOUT_S. DEVIATION D4.

    Args:
        held_s: of the last tick.
        own: velocity and intent count.
        is_active: whether the row of a neighbour changes the baseline.
    """
    intent_2, along = dot_2(own.intent_m_s, own.intent_m_s), dot_2(own.velocity_m_s, own.intent_m_s)
    if held_s < 0.0:
        count_s = min(held_s + dt_s, 0.0)
    elif is_active and intent_2 > _HELD_INTENT_2_M2_S2 and along < _HELD_FRAC * intent_2:
        count_s = held_s + dt_s
    else:
        count_s = 0.0
    return -ROUNDABOUT_S if count_s >= HELD_S else count_s


def relaxed_blend(dt_s: float) -> float:
    """Return how far ``LawMemory.relaxed_share`` moves in one tick; 0.07 in 20 ms (line G).

    Args:
        dt_s: length of the tick.
    """
    return 1.0 - math.pow(0.93, dt_s / 0.02)
