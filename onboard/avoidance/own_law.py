"""A law of somebody's own in the place of Covey's: its inputs, and what of its answer can be flown.

The page for its authors is docs/own-law.md. Such a law is interpreted; nothing here is compiled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from onboard.avoidance.half_planes import into_disc
from onboard.avoidance.interface import NOBODY, Baseline, horizontal_limit, own_at
from onboard.avoidance.oist import LawMemory
from onboard.avoidance.pairs import nearest_pairs
from onboard.avoidance.params import Capsule, LawParams, Walls
from onboard.avoidance.prediction import Motion, remembered
from onboard.types import GRAVITY_M_S2, LawOutput, LawStatus, Neighbour, State, Thrust
from onboard.vectors import Vec2, Vec3

LEAST_THRUST_G = 0.5  # vertical, of the weight: below it a vehicle falls
_TILT_SLACK_RAD = math.radians(1.0)
_CHANGED_M_S2 = 1e-9


class LawNeighbour(NamedTuple):
    """One neighbour as Covey's law takes it: horizontal, at t + L.

    That is the time at which a command of now takes effect.
    """

    e_m: Vec2  # own position minus the neighbour's
    w_m_s: Vec2  # own velocity minus the neighbour's
    d_m: float  # distance of the centres to keep, with all margins
    is_cooperative: bool  # False: it avoids nobody
    table_index: int  # the same as of its entry in ``received``


class LawInputs(NamedTuple):
    """All that a law may know at one tick; SI units, fleet ENU."""

    state: State  # own estimate, now
    predicted: Motion  # own position and velocity at t + L
    # thrust per mass that the vehicle would fly if it were alone, within its limits
    baseline: Thrust
    compensation_enu_m_s2: Vec3  # is added to the answer against drag and wind
    intent_enu_m_s: Vec3  # velocity straight to the goal

    neighbours: tuple[LawNeighbour, ...]  # the nearest within range, nearest first
    received: tuple[Neighbour, ...]  # all neighbours as they were heard
    obstacles: tuple[Capsule, ...]  # what stands still
    fence: Walls  # walls

    # horizontal thrust, with its compensation, at the baseline's vertical thrust
    largest_m_s2: float
    vehicle: LawParams  # numbers of the vehicle and of the file's [law]; lead_time_s is L
    dt_s: float  # since the last tick

    def limited(self, x_m_s2: float, y_m_s2: float) -> Thrust:
        """Return the thrust nearest to a horizontal one that can be flown.

        The vertical thrust is the baseline's.

        Args:
            x_m_s2, y_m_s2: east and north.
        """
        s = self.compensation_enu_m_s2
        flown = into_disc(Vec2(x_m_s2 + s.x, y_m_s2 + s.y), self.largest_m_s2)
        return Thrust(Vec3(flown.x - s.x, flown.y - s.y, self.baseline.thrust_enu_m_s2.z))


def law_inputs(
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
        baseline: thrust, compensation and intent.
        predicted: own motion at t + L.
        state: own estimate.
        neighbours: as received.
        obstacles: static ones.
        params: of the vehicle.
        dt_s: since the last tick.
    """
    own = own_at(baseline, predicted, state, params)
    u = own.thrust_m_s2
    s = own.compensation_m_s2

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

    return LawInputs(
        state=state,
        predicted=predicted,
        baseline=Thrust(Vec3(u.x - s.x, u.y - s.y, own.thrust_z_m_s2)),
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


def judged(answer: Any, inputs: LawInputs) -> tuple[Any, Vec3, str]:
    """Return memory and thrust of a law's answer, and why it cannot be flown; empty where it can.

    Args:
        answer: whatever the law returned.
        inputs: of the same tick.
    Returns:
        memory, thrust per mass [m/s^2] in ENU, and the end of the sentence "the law ...".
    """
    baseline = inputs.baseline.thrust_enu_m_s2
    if not isinstance(answer, tuple) or len(answer) != 2:
        refusal = f"returned {_named(answer)} instead of the pair (memory, thrust)"
        return None, baseline, refusal

    memory, given = answer
    numbers = given.thrust_enu_m_s2 if isinstance(given, Thrust) else given
    try:
        thrust = _three_numbers(numbers)
    except Exception:  # noqa: BLE001 - of whatever type the law returned
        refusal = f"returned {_named(given)} instead of a thrust of three numbers"
        return None, baseline, refusal

    return memory, thrust, _excess(thrust, inputs)


def _three_numbers(numbers: Any) -> Vec3:
    """Return a vector of whatever a law returned; raises where that is no three numbers."""
    if isinstance(numbers, str | bytes | dict):
        raise TypeError  # their characters or keys might pass for numbers
    return Vec3(*(float(number) for number in numbers))


def _named(value: Any) -> str:
    return "nothing" if value is None else f"a {type(value).__name__}"


def _excess(thrust: Vec3, inputs: LawInputs) -> str:
    """Return which limit a thrust does not keep; empty if it keeps all."""
    if not all(math.isfinite(number) for number in thrust):
        return f"returned a thrust that is not finite: ({thrust.x:g}, {thrust.y:g}, {thrust.z:g})"

    limits = inputs.vehicle
    least_m_s2 = LEAST_THRUST_G * GRAVITY_M_S2
    if not least_m_s2 <= thrust.z <= limits.max_thrust_m_s2:
        return (
            f"asked for a vertical thrust of {thrust.z:.3g} m/s^2, and a vehicle flies with "
            f"{least_m_s2:.1f} to {limits.max_thrust_m_s2:.1f} m/s^2"
        )

    # the compensation is flown as well
    s = inputs.compensation_enu_m_s2
    across = math.hypot(thrust.x + s.x, thrust.y + s.y)
    tilt_rad = math.atan2(across, thrust.z)
    if tilt_rad > limits.max_tilt_rad + _TILT_SLACK_RAD:
        max_tilt_deg = math.degrees(limits.max_tilt_rad)
        return (
            f"tilted by {math.degrees(tilt_rad):.0f} degrees, and max_tilt_deg is "
            f"{max_tilt_deg:.0f}"
        )

    slack_m_s2 = math.tan(_TILT_SLACK_RAD) * thrust.z
    if across > horizontal_limit(thrust.z, limits) + slack_m_s2:
        total_m_s2 = math.hypot(across, thrust.z)
        return f"asked for {total_m_s2:.3g} m/s^2, and the motors give {limits.max_thrust_m_s2:.1f}"
    return ""


def flown_instead(
    thrust: Vec3, covey: LawOutput, memory: LawMemory, before: LawMemory, inputs: LawInputs
) -> tuple[LawMemory, LawOutput]:
    """Return Covey's memory and output with a law's thrust in the place of Covey's.

    Args:
        thrust: that is flown.
        covey: output of Covey's law at the same tick.
        memory: of Covey's law after that tick.
        before: memory of Covey's law after the last tick.
        inputs: of the tick.
    """
    command = Vec3(thrust.x, thrust.y, thrust.z - GRAVITY_M_S2)
    x, y, z = inputs.baseline.thrust_enu_m_s2
    change_m_s2 = math.hypot(thrust.x - x, thrust.y - y, thrust.z - z)

    status = LawStatus.INACTIVE
    if change_m_s2 > _CHANGED_M_S2:
        status = LawStatus.SATURATED

    output = covey._replace(
        thrust=Thrust(thrust),
        commanded_acceleration_enu_m_s2=command,
        status=int(status),
        intervention_m_s2=change_m_s2,
        slack_m_s2=0.0,
        active_neighbour=NOBODY,
    )
    after = memory._replace(commands=remembered(before.commands, command, inputs.dt_s))
    return after, output
