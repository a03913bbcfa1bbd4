"""A user's own law, which replaces Covey's: its inputs, and the check of its answer.

docs/own-law.md is the page for authors of such laws. :mod:`own_law_runner` calls a law at each
tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Complex, Real
from typing import Any, NamedTuple

from onboard.avoidance import oist
from onboard.avoidance.half_planes import into_disc
from onboard.avoidance.interface import NOBODY, Baseline, own_at
from onboard.avoidance.oist import LawMemory
from onboard.avoidance.pairs import Own, nearest_pairs
from onboard.avoidance.params import Capsule, LawParams, Walls
from onboard.avoidance.prediction import Motion, PastCommand, remembered
from onboard.avoidance.projection import INACTIVE, SATURATED
from onboard.constants import GRAVITY_M_S2
from onboard.types import LawOutput, Neighbour, State, Thrust
from onboard.vectors import Vec2, Vec3, length, subtract

MIN_THRUST_G = 0.5  # least vertical thrust, as a share of the weight: with less, a vehicle falls
_TILT_SLACK_RAD = math.radians(1.0)  # a tilt beyond the limit by less than this is not refused
_CHANGED_M_S2 = 1e-9  # a smaller change of the baseline's thrust is rounding


class LawNeighbour(NamedTuple):
    """One neighbour as Covey's law sees it: horizontal, at t + L.

    A command given now takes effect at t + L.
    """

    e_m: Vec2  # own position minus the neighbour's
    w_m_s: Vec2  # own velocity minus the neighbour's
    d_m: float  # distance of the centres to keep, with all margins
    is_cooperative: bool  # False: it does not avoid others
    # the same number as in the neighbour's entry of ``LawInputs.received``, see
    # :meth:`LawInputs.heard`; no position in that tuple, which lacks vehicles that were never heard
    table_index: int


class CoveyTick(NamedTuple):
    """One tick of Covey's law, which is computed beside the user's law."""

    own: Own  # the vehicle at t + L
    neighbours: list[LawNeighbour]  # the nearest within range, nearest first
    memory: LawMemory  # after the tick
    output: LawOutput


class LawInputs(NamedTuple):
    """Everything that a law gets at one tick, in SI units and fleet ENU."""

    state: State  # own estimate, now
    predicted: Motion  # own position and velocity at t + L
    # thrust per mass that the vehicle would fly if it were alone, within its limits
    baseline: Thrust
    compensation_enu_m_s2: Vec3  # added to the answer to cancel drag and wind
    intent_enu_m_s: Vec3  # velocity straight to the goal

    neighbours: tuple[LawNeighbour, ...]  # the nearest within range, nearest first
    received: tuple[Neighbour, ...]  # all neighbours as received
    obstacles: tuple[Capsule, ...]  # static obstacles, and edges of the fence's areas
    fence: Walls  # walls of the box

    # largest horizontal thrust, compensation included, at the baseline's vertical thrust
    largest_m_s2: float
    vehicle: LawParams  # numbers of the vehicle and of the file's [law]; lead_time_s is L
    dt_s: float  # time since the last tick

    def heard(self, neighbour: LawNeighbour) -> Neighbour:
        """Return the entry of ``received`` of a neighbour.

        A neighbour that is in one place by its word and in another by the motion capture has two
        entries, and is twice among ``neighbours``.

        Args:
            neighbour: one of ``neighbours``.
        """
        x_m = self.predicted.position_enu_m.x - neighbour.e_m.x
        y_m = self.predicted.position_enu_m.y - neighbour.e_m.y

        def beside_m(entry: Neighbour) -> float:
            position_m = entry.predicted_position_enu_m
            return math.hypot(position_m.x - x_m, position_m.y - y_m)

        same = [entry for entry in self.received if entry.table_index == neighbour.table_index]
        return min(same, key=beside_m)

    def limited(self, x_m_s2: float, y_m_s2: float) -> Thrust:
        """Return the flyable thrust that is nearest to a horizontal thrust.

        The vertical thrust is the baseline's.

        Args:
            x_m_s2, y_m_s2: horizontal thrust, east and north.
        """
        s = self.compensation_enu_m_s2
        flown = into_disc(Vec2(x_m_s2 + s.x, y_m_s2 + s.y), self.largest_m_s2)
        return Thrust(Vec3(flown.x - s.x, flown.y - s.y, self.baseline.thrust_enu_m_s2.z))


def covey_tick(
    memory: LawMemory,
    relaxed_share: float,
    baseline: Baseline,
    predicted: Motion,
    state: State,
    neighbours: Sequence[Neighbour],
    obstacles: Sequence[Capsule],
    params: LawParams,
    dt_s: float,
) -> CoveyTick:
    """Return one tick of Covey's law, and the neighbours that the user's law gets.

    Args:
        memory: memory of Covey's law after the last tick.
        relaxed_share: its true share of relaxed ticks, which replaces that of the memory.
        baseline: thrust, compensation and intent.
        predicted: own motion at t + L.
        state: own estimate.
        neighbours: all neighbours as received.
        obstacles: static obstacles, and edges of the fence's areas.
        params: numbers of the vehicle's law.
        dt_s: time since the last tick.
    """
    after, output = oist.step(
        with_share(memory, relaxed_share),
        baseline,
        predicted,
        state,
        neighbours,
        obstacles,
        params,
        dt_s,
    )
    own = own_at(baseline, predicted, state, params)

    near = []
    for pair in nearest_pairs(own, neighbours, params).pairs:
        neighbour = LawNeighbour(
            e_m=pair.e,
            w_m_s=pair.w,
            d_m=pair.d_m,
            is_cooperative=pair.is_cooperative,
            table_index=pair.table_index,
        )
        near.append(neighbour)
    return CoveyTick(own=own, neighbours=near, memory=after, output=output)


def law_inputs(
    own: Own,
    near: Sequence[LawNeighbour],
    baseline: Baseline,
    predicted: Motion,
    state: State,
    neighbours: Sequence[Neighbour],
    obstacles: Sequence[Capsule],
    params: LawParams,
    dt_s: float,
) -> LawInputs:
    """Return the inputs of one tick.

    Args:
        own, near: the vehicle and its nearest neighbours, of :func:`covey_tick`.
        baseline: thrust, compensation and intent.
        predicted: own motion at t + L.
        state: own estimate.
        neighbours: all neighbours as received.
        obstacles: static obstacles, and edges of the fence's areas.
        params: numbers of the vehicle's law.
        dt_s: time since the last tick.
    """
    s = own.compensation_m_s2
    return LawInputs(
        state=state,
        predicted=predicted,
        baseline=Thrust(_unchanged(own)),
        compensation_enu_m_s2=Vec3(s.x, s.y, baseline.compensation_enu_m_s2.z),
        intent_enu_m_s=baseline.intent_enu_m_s,
        neighbours=tuple(near),
        received=tuple(neighbours),
        obstacles=tuple(obstacles),
        fence=params.fence,
        largest_m_s2=own.radius_m_s2,
        vehicle=params,
        dt_s=dt_s,
    )


def _unchanged(own: Own) -> Vec3:
    """Return the thrust that the vehicle would fly if it were alone, within its limits."""
    u = own.thrust_m_s2
    s = own.compensation_m_s2
    return Vec3(u.x - s.x, u.y - s.y, own.thrust_z_m_s2)


def judged(answer: Any, inputs: LawInputs) -> tuple[Any, Vec3, str]:
    """Return memory and thrust of a law's answer, and the reason if the thrust is refused.

    Args:
        answer: whatever the law returned.
        inputs: inputs of the same tick.
    Returns:
        The law's memory; its thrust per mass [m/s^2] in ENU; and the reason, as the end of a
        sentence that begins with "the law". The reason is empty if the thrust can be flown. If the
        answer holds no thrust, the memory is None and the thrust is the baseline's.
    """
    baseline = inputs.baseline.thrust_enu_m_s2
    if not isinstance(answer, tuple) or len(answer) != 2:
        refusal = f"returned {_named(answer)} instead of the pair (memory, thrust)"
        return None, baseline, refusal

    memory, answered_thrust = answer
    numbers = answered_thrust
    if isinstance(answered_thrust, Thrust):
        numbers = answered_thrust.thrust_enu_m_s2

    try:
        thrust = _three_numbers(numbers)
    except Exception:  # noqa: BLE001 - the law may return a value of any type
        refusal = f"returned {_named(answered_thrust)} instead of a thrust of three numbers"
        if isinstance(numbers, tuple | list) and len(numbers) != 3:
            refusal += f" (it has {len(numbers)})"
        return None, baseline, refusal

    return memory, thrust, _exceeded_limit(thrust, inputs)


def _three_numbers(numbers: Any) -> Vec3:
    """Return the vector of three numbers; raises an exception for anything else."""
    if isinstance(numbers, str | bytes | dict):
        raise TypeError  # characters or keys could be mistaken for numbers
    return Vec3(*map(_number, numbers))


def _number(value: Any) -> float:
    """Return a number; raises an exception for anything else.

    ``float`` alone would read a text, and leave out the imaginary part of numpy's complex numbers.
    """
    if isinstance(value, str | bytes):
        raise TypeError
    if isinstance(value, Complex) and not isinstance(value, Real):
        raise TypeError
    return float(value)


def _named(value: Any) -> str:
    return "nothing" if value is None else f"a {type(value).__name__}"


def _exceeded_limit(thrust: Vec3, inputs: LawInputs) -> str:
    """Return in words which limit a thrust exceeds; empty if it keeps all limits."""
    if not all(math.isfinite(number) for number in thrust):
        return f"returned a thrust that is not finite: ({thrust.x:g}, {thrust.y:g}, {thrust.z:g})"

    limits = inputs.vehicle
    least_m_s2 = MIN_THRUST_G * GRAVITY_M_S2
    if not least_m_s2 <= thrust.z <= limits.max_thrust_m_s2:
        return (
            f"asked for a vertical thrust of {thrust.z:.3g} m/s^2, and a vehicle flies with "
            f"{least_m_s2:.1f} to {limits.max_thrust_m_s2:.1f} m/s^2"
        )

    # the compensation is added to the thrust before it is flown
    s = inputs.compensation_enu_m_s2
    across = math.hypot(thrust.x + s.x, thrust.y + s.y)
    tilt_rad = math.atan2(across, thrust.z)
    if tilt_rad > limits.max_tilt_rad + _TILT_SLACK_RAD:
        max_tilt_deg = math.degrees(limits.max_tilt_rad)
        return (
            f"tilted by {math.degrees(tilt_rad):.0f} degrees, and max_tilt_deg is "
            f"{max_tilt_deg:.0f}"
        )

    by_motors_m_s2 = math.sqrt(
        limits.max_thrust_m_s2 * limits.max_thrust_m_s2 - thrust.z * thrust.z
    )
    slack_m_s2 = math.tan(_TILT_SLACK_RAD) * thrust.z
    if across > by_motors_m_s2 + slack_m_s2:
        total_m_s2 = math.hypot(across, thrust.z)
        return f"asked for {total_m_s2:.3g} m/s^2, and the motors give {limits.max_thrust_m_s2:.1f}"
    return ""


def flown_instead(
    thrust: Vec3, own: Own, covey: LawOutput, after: LawMemory, before: LawMemory, dt_s: float
) -> tuple[LawMemory, LawOutput]:
    """Return Covey's memory and output with the thrust of the user's law.

    Args:
        thrust: thrust of the user's law, which is flown.
        own: the vehicle at t + L.
        covey: output of Covey's law at the same tick.
        after: memory of Covey's law after that tick.
        before: memory of Covey's law before that tick.
        dt_s: time since the last tick.
    """
    command = Vec3(thrust.x, thrust.y, thrust.z - GRAVITY_M_S2)
    change_m_s2 = length(subtract(thrust, _unchanged(own)))

    status = INACTIVE
    if change_m_s2 > _CHANGED_M_S2:
        status = SATURATED

    output = LawOutput(
        thrust=Thrust(thrust),
        predicted_position_enu_m=covey.predicted_position_enu_m,
        predicted_velocity_enu_m_s=covey.predicted_velocity_enu_m_s,
        commanded_acceleration_enu_m_s2=command,
        status=status,
        intervention_m_s2=change_m_s2,
        slack_m_s2=0.0,
        crowd_count=covey.crowd_count,
        active_neighbour=NOBODY,
        lead_time_s=covey.lead_time_s,
        intent_enu_m_s=covey.intent_enu_m_s,
    )
    commands = remembered(before.commands, command, dt_s)
    return _changed(after, commands, after.relaxed_share), output


def with_share(memory: LawMemory, relaxed_share: float) -> LawMemory:
    """Return the memory of Covey's law with another share of relaxed ticks."""
    return _changed(memory, memory.commands, relaxed_share)


def _changed(memory: LawMemory, commands: list[PastCommand], relaxed_share: float) -> LawMemory:
    """Return a memory with other commands and share. Compiled code knows no ``_replace``."""
    return LawMemory(
        commands=commands,
        predicted=memory.predicted,
        relaxed_share=relaxed_share,
        held_s=memory.held_s,
        roundabout_left_s=memory.roundabout_left_s,
        climb_share=memory.climb_share,
        sink_limit_m_s=memory.sink_limit_m_s,
    )
