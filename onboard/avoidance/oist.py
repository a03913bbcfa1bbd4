"""Output-to-input saturation (OIST) for N neighbours: turns the baseline thrust into a safe thrust.

README.md beside this file names the paper. It has the symbols, the algorithm's lines (P1 to O) and
the deviations from the paper (D1 to D18). Numbers in brackets are equations of the paper.

The paper bounds the input of one pair by h_1 and h_2 (20), (21): constraints.py. It saturates the
input at these bounds (22), which projects the thrust on two half-planes ("rows"). Here the thrust
is projected on the rows of all neighbours, obstacles and walls, and on the disc that tilt and
thrust can deliver: projection.py. The rows are evaluated where the vehicle will be when its command
takes effect: prediction.py. The vertical thrust is never changed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from onboard.avoidance import oist_paper
from onboard.avoidance.constraints import (
    FLEEING_FACTOR,
    NO_ROW,
    SPEED_JERK_1_S2,
    VIOLATED_M_S2,
    Constraint,
    can_bind,
    compensated,
    constraints_around,
    promised_row,
    speed_row,
)
from onboard.avoidance.fence_edges import edge_constraints
from onboard.avoidance.half_planes import HalfPlane, largest_violation, scaled_row
from onboard.avoidance.interface import (
    INFEASIBLE,
    NOBODY,
    Answer,
    Baseline,
    output_of,
    own_at,
)
from onboard.avoidance.pairs import (
    NeighbourPair,
    Own,
    climb_share,
    nearest_pairs,
    nearest_surfaces,
    sink_limit,
)
from onboard.avoidance.params import (
    COVEY,
    JAM_IGNORE,
    PAPER,
    PREDICTION_NONE,
    ROTATION_ALWAYS,
    Capsule,
    LawParams,
)
from onboard.avoidance.prediction import (
    MAX_MESSAGE_AGE_S,
    UNKNOWN_MOTION,
    Motion,
    PastCommand,
    no_commands,
    predict_own,
    remembered,
)
from onboard.avoidance.projection import (
    INACTIVE,
    RELAXED,
    SATURATED,
    Projection,
    project,
    pulled,
    relaxed_in_order,
)
from onboard.avoidance.smoothing import smoothed
from onboard.types import LawOutput, Neighbour, State
from onboard.vectors import Vec2, dot_xy, length_xy

# After the law has held a vehicle back for HELD_S, the vehicle calls for a roundabout for
# ROUNDABOUT_S: it publishes the crowd count of a crowd, so that all vehicles around it turn the
# same way.
HELD_S = 3.0
ROUNDABOUT_S = 5.0

# A vehicle is held back when it intends to fly faster than 0.2 m/s, and flies in that direction
# with less than this share of the intended speed.
_HELD_SQUARED_INTENT_M2_S2 = 0.04  # square of 0.2 m/s
_HELD_FRAC = 0.2

# Stiffness of the springs with which rotation rows pull the thrust. Stiffer springs make the
# command jump if rows contradict each other. With softer springs, vehicles stop face to face.
_TURN_STIFFNESS = 25.0
_STIFFNESS_ALWAYS = 1e7  # under the policy "always": the rows are satisfied, as in the paper

# If rows contradict each other, the margins are relaxed by 30 m/s^2 while the speed limit is
# relaxed by 1 m/s^2.
_LIMIT_FIRMNESS = 30.0

# The speed limit is raised by the noise of our own velocity, but at most by this share of the
# limit.
_MAX_NOISE_FRAC = 0.25

_STANDING_M_S = 1e-6  # a slower vehicle has no direction of motion

# The share of relaxed ticks is low-passed: a tick of 20 ms keeps 0.93 of the last value.
_RELAXED_KEPT = 0.93
_RELAXED_TICK_S = 0.02

# In a jam the speed limit shrinks by _JAM_FACTOR times the share of relaxed ticks.
_JAM_FACTOR = 1.5
_JAM_LEAST_SHARE = 0.1


class LawMemory(NamedTuple):
    """State of the law between two ticks."""

    commands: list[PastCommand]  # own past commands, newest first
    predicted: Motion  # own predicted motion at t + L, of the last tick; not finite: unknown
    relaxed_share: float  # low-passed share of ticks in which rows had to be relaxed
    held_s: float  # time for which neighbours have held the vehicle back; 0 during a call
    roundabout_left_s: float  # remaining time of its call for a roundabout; 0: it does not call
    climb_share: float  # how fast a climb or descent may continue, from 0 to 1
    sink_limit_m_s: float  # how fast it may sink without poses; infinite if unlimited


def initial() -> LawMemory:
    """Return the memory before the first command."""
    return LawMemory(
        commands=no_commands(),
        predicted=UNKNOWN_MOTION,
        relaxed_share=0.0,
        held_s=0.0,
        roundabout_left_s=0.0,
        climb_share=1.0,
        sink_limit_m_s=math.inf,
    )


def predict(memory: LawMemory, state: State, params: LawParams, dt_s: float) -> Motion:
    """Return our own motion at t + L, when a command given now takes effect (line P1).

    The paper's law and one policy predict nothing; then the result is the present motion.

    Args:
        memory: holds the past commands and the last prediction.
        state: own estimate.
        dt_s: time since the last tick.
    """
    now = Motion(state.position_enu_m, state.velocity_enu_m_s)
    if params.law == PAPER or params.policies.prediction == PREDICTION_NONE:
        return now

    age_s = 0.0
    if not math.isnan(state.age_s):
        age_s = min(max(state.age_s, 0.0), MAX_MESSAGE_AGE_S)

    window_s = params.lag_s + age_s
    window_z_s = params.vertical_lag_s + age_s
    predicted = predict_own(memory.commands, now, window_s, window_z_s)

    return smoothed(predicted, memory.predicted, memory.commands, state, window_s, dt_s)


def speed_share(memory: LawMemory, params: LawParams) -> float:
    """Return the share of its speed limit that a vehicle flies in a jam (line G).

    If the policy says so, a vehicle flies more slowly towards its goal while the law often relaxes
    rows.

    Args:
        memory: holds the share of relaxed ticks.
        params: holds the policy.
    """
    if params.policies.jam == JAM_IGNORE:
        return 1.0
    return max(_JAM_LEAST_SHARE, 1.0 - _JAM_FACTOR * memory.relaxed_share)


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
        memory: memory of the last tick.
        baseline: thrust of the backstepping [m/s^2], compensation and intent.
        predicted: own motion from :func:`predict`.
        state: own estimate; the paper's law uses it without prediction.
        neighbours: neighbours as received, in any order.
        obstacles: static obstacles, and edges of the fence's areas.
        params: numbers of this vehicle's law.
        dt_s: time since the last tick.
    Returns:
        Memory and output. Input that cannot be used gives a bounded thrust with the status
        INFEASIBLE. If the own motion is not finite, the thrust is vertical and the published
        prediction is NaN.
    Properties: rotation- and translation-equivariant about the vertical; independent of the
    neighbours' order.
    """
    own = own_at(baseline, predicted, state, params)

    climb = 1.0
    sink_m_s = math.inf
    if params.law == COVEY:
        calls_for_roundabout = memory.roundabout_left_s > 0.0
        answer = saturate(own, neighbours, obstacles, calls_for_roundabout, params)
        climb = climb_share(own, neighbours, params)
        sink_m_s = sink_limit(own, neighbours, params)
    elif params.law == PAPER:
        answer = oist_paper.saturate_pair(own, state, neighbours, params)
    else:
        answer = unchanged_thrust(own, INACTIVE, 0.0)

    output = output_of(answer, own, baseline, predicted, params)

    is_held = output.active_neighbour >= 0 and is_held_back(own)
    held_s, roundabout_left_s = next_hold(memory, is_held, dt_s)
    after = LawMemory(
        commands=remembered(memory.commands, output.commanded_acceleration_enu_m_s2, dt_s),
        predicted=predicted,
        relaxed_share=next_relaxed_share(memory.relaxed_share, output.status, dt_s),
        held_s=held_s,
        roundabout_left_s=roundabout_left_s,
        climb_share=climb,
        sink_limit_m_s=sink_m_s,
    )
    return after, output


def saturate(
    own: Own,
    neighbours: Sequence[Neighbour],
    obstacles: Sequence[Capsule],
    calls_for_roundabout: bool,
    params: LawParams,
) -> Answer:
    """Return the thrust nearest to the baseline's that satisfies all rows.

    Implements: (22) for N neighbours, obstacles and walls; lines P3, D, R and Q. DEVIATION D8, D13.

    Args:
        own: this vehicle at t + L.
        neighbours: neighbours as received.
        obstacles: static obstacles, and edges of the fence's areas.
        calls_for_roundabout: whether this vehicle has been held back for a long time.
    """
    pairs, crowd_count, is_sound = nearest_pairs(own, neighbours, params)
    if calls_for_roundabout:
        crowd_count = max(crowd_count, float(params.gains.crowd_count))

    surfaces = nearest_surfaces(own, obstacles, params.spacing.clearance_m)
    constraints = constraints_around(own, pairs, surfaces, crowd_count, params)
    if len(obstacles) > 0:
        constraints.extend(edge_constraints(own, obstacles, params))

    active = most_violating(constraints)
    rows = [constraint.row for constraint in constraints]
    turns = [constraint.turn for constraint in constraints if constraint.is_turning]

    limit = speed_limit(own, pairs, rows, params)
    is_too_fast = largest_violation(own.thrust_m_s2, [limit]) > VIOLATED_M_S2
    if active == NOBODY and len(turns) == 0 and not is_too_fast:
        status = INACTIVE if is_sound else INFEASIBLE
        return unchanged_thrust(own, status, crowd_count)

    turned_m_s2 = pulled(own.thrust_m_s2, turns, turn_stiffness(params))
    safe = nearest_thrust(own, turned_m_s2, pairs, rows, limit, params)

    status = safe.status
    if status == INACTIVE and turned_m_s2 != own.thrust_m_s2:
        status = SATURATED
    return Answer(
        thrust_m_s2=safe.point,
        status=status if is_sound else INFEASIBLE,
        slack_m_s2=safe.slack,
        crowd_count=crowd_count,
        active=active,
    )


def unchanged_thrust(own: Own, status: int, crowd_count: float) -> Answer:
    """Return the answer that flies the baseline's thrust.

    Args:
        own: this vehicle at t + L.
        status: a LawStatus.
        crowd_count: number of near neighbours.
    """
    return Answer(
        thrust_m_s2=own.thrust_m_s2,
        status=status,
        slack_m_s2=0.0,
        crowd_count=crowd_count,
        active=NOBODY,
    )


def most_violating(constraints: list[Constraint]) -> int:
    """Return the table index of the constraint that the baseline violates most, or NOBODY.

    Args:
        constraints: constraints of everything around the vehicle.
    """
    worst_m_s2 = VIOLATED_M_S2
    active = NOBODY
    for constraint in constraints:
        if constraint.violation_m_s2 > worst_m_s2:
            worst_m_s2 = constraint.violation_m_s2
            active = constraint.table_index
    return active


def turn_stiffness(params: LawParams) -> float:
    """Return the stiffness of the springs by which rotation rows pull the thrust.

    Args:
        params: holds the policy.
    """
    if params.policies.rotation == ROTATION_ALWAYS:
        return _STIFFNESS_ALWAYS
    return _TURN_STIFFNESS


def nearest_thrust(
    own: Own,
    wanted_m_s2: Vec2,
    pairs: list[NeighbourPair],
    rows: list[HalfPlane],
    limit: HalfPlane,
    params: LawParams,
) -> Projection:
    """Return the thrust nearest to the wanted thrust that satisfies all rows (line Q).

    If no thrust satisfies all rows, the margins are relaxed first, then the limit of the speed, and
    last the promised distances, obstacles and walls.

    Args:
        own: this vehicle at t + L.
        wanted_m_s2: baseline's horizontal thrust, moved by the rotation rows.
        pairs: pairs with the neighbours that count.
        rows: rows of these pairs in their order, then those of obstacles and walls.
        limit: row of the speed limit.
    """
    radius = own.radius_m_s2
    with_margins = [row for row in rows[: len(pairs)] if can_bind(row, radius)]
    static = [row for row in rows[len(pairs) :] if can_bind(row, radius)]
    speed_rows: list[HalfPlane] = []
    if can_bind(limit, radius):
        speed_rows.append(limit)

    safe = project(wanted_m_s2, with_margins + static + speed_rows, radius)
    if safe.status != RELAXED:
        return safe

    promises = [compensated(promised_row(pair, params), own.compensation_m_s2) for pair in pairs]
    firm = [row for row in promises if can_bind(row, radius)] + static
    relaxed_first = with_margins + [scaled_row(row, _LIMIT_FIRMNESS) for row in speed_rows]
    return relaxed_in_order(wanted_m_s2, relaxed_first, firm, radius)


def speed_limit(
    own: Own, pairs: list[NeighbourPair], rows: list[HalfPlane], params: LawParams
) -> HalfPlane:
    """Return the row of the speed limit, which is higher for a vehicle that flees.

    The limit is raised by one standard deviation of our own velocity, so that noise does not brake
    the vehicle. A vehicle that flees may accelerate as strongly as it can.

    Args:
        own: this vehicle at t + L.
        pairs: pairs with the neighbours that count.
        rows: distance rows of these pairs, in the same order.
    """
    if length_xy(own.velocity_m_s) <= _STANDING_M_S:
        return NO_ROW

    limit_m_s = params.top_speed_m_s
    limit_m_s += min(own.velocity_std_m_s, _MAX_NOISE_FRAC * params.top_speed_m_s)
    jerk_m_s3 = SPEED_JERK_1_S2 * params.top_speed_m_s
    if is_fleeing(own, pairs, rows):
        limit_m_s *= FLEEING_FACTOR
        jerk_m_s3 = math.inf
    row = speed_row(own.velocity_m_s, limit_m_s, jerk_m_s3)
    return compensated(row, own.compensation_m_s2)


def is_fleeing(own: Own, pairs: list[NeighbourPair], rows: list[HalfPlane]) -> bool:
    """Return whether the row of a neighbour that does not cooperate can change the thrust.

    If so, the vehicle may flee faster than its top speed.

    Args:
        own: this vehicle at t + L.
        pairs: pairs with the neighbours that count.
        rows: distance rows of these pairs, in the same order.
    """
    for k in range(len(pairs)):  # a loop, because numba compiles no generators
        if not pairs[k].is_cooperative and can_bind(rows[k], own.radius_m_s2):
            return True
    return False


def is_held_back(own: Own) -> bool:
    """Return whether a vehicle intends to move, and hardly does so.

    Args:
        own: this vehicle at t + L; its velocity and intent are used.
    """
    squared_intent_m2_s2 = dot_xy(own.intent_m_s, own.intent_m_s)
    along = dot_xy(own.velocity_m_s, own.intent_m_s)
    intends_to_move = squared_intent_m2_s2 > _HELD_SQUARED_INTENT_M2_S2
    makes_progress = along >= _HELD_FRAC * squared_intent_m2_s2
    return intends_to_move and not makes_progress


def next_hold(memory: LawMemory, is_held: bool, dt_s: float) -> tuple[float, float]:
    """Return the next ``held_s`` and ``roundabout_left_s`` of the memory. DEVIATION D4.

    Two parked neighbours with a narrow gap between them would hold a vehicle back forever, because
    each requires a turn that the other forbids. The roundabout leads the vehicle around both
    neighbours.

    Args:
        memory: memory of the last tick.
        is_held: whether the row of a neighbour holds the vehicle back.
        dt_s: length of the tick.
    """
    if memory.roundabout_left_s > 0.0:
        return 0.0, max(memory.roundabout_left_s - dt_s, 0.0)
    if not is_held:
        return 0.0, 0.0

    held_s = memory.held_s + dt_s
    if held_s >= HELD_S:
        return 0.0, ROUNDABOUT_S
    return held_s, 0.0


def next_relaxed_share(share: float, status: int, dt_s: float) -> float:
    """Return the next ``LawMemory.relaxed_share`` (line G).

    Args:
        share: value at the last tick.
        status: a LawStatus, of this tick.
        dt_s: length of the tick.
    """
    blend = 1.0 - math.pow(_RELAXED_KEPT, dt_s / _RELAXED_TICK_S)
    relaxed = 1.0 if status == RELAXED else 0.0
    return share + blend * (relaxed - share)
