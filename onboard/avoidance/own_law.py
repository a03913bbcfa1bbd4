"""A law of somebody's own in the place of Covey's: what it is given, and what of its answer can be
flown.

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
from onboard.avoidance.params import Capsule, Fence, LawParams
from onboard.avoidance.prediction import Motion, remembered
from onboard.types import GRAVITY_M_S2, LawOutput, LawStatus, Neighbour, State, Thrust
from onboard.vectors import Vec2, Vec3

LEAST_THRUST_G = 0.5  # vertical, of the weight: below it a vehicle falls
_TILT_SLACK_RAD = math.radians(1.0)
_CHANGED_M_S2 = 1e-9


class LawNeighbour(NamedTuple):
    """One neighbour as Covey's law takes it: horizontal, at t + L, when a command of now takes
    effect.
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
    fence: Fence  # walls
    # horizontal thrust, with its compensation, at the baseline's vertical thrust
    largest_m_s2: float
    vehicle: LawParams  # numbers of the vehicle and of the file's [law]; lead_time_s is L
    dt_s: float  # since the last tick

    def limited(self, x_m_s2: float, y_m_s2: float) -> Thrust:
        """Return the thrust nearest to a horizontal one that can be flown, with the baseline's
        vertical thrust.

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
    u, s = own.thrust_m_s2, own.compensation_m_s2
    pairs = nearest_pairs(own, neighbours, params).pairs
    return LawInputs(
        state,
        predicted,
        Thrust(Vec3(u.x - s.x, u.y - s.y, own.thrust_z_m_s2)),
        Vec3(s.x, s.y, baseline.compensation_enu_m_s2.z),
        baseline.intent_enu_m_s,
        tuple(
            LawNeighbour(pair.e, pair.w, pair.d_m, pair.is_cooperative, pair.table_index)
            for pair in pairs
        ),
        tuple(neighbours),
        tuple(obstacles),
        params.fence,
        own.radius_m_s2,
        params,
        dt_s,
    )


def judged(answer: Any, inputs: LawInputs) -> tuple[Any, Vec3, str]:
    """Return memory and thrust of a law's answer, and why it cannot be flown; empty where it can.

    Args:
        answer: whatever the law returned.
        inputs: of the same tick.
    Returns:
        memory, thrust per mass [m/s^2] in ENU, and the end of the sentence "the law ...".
    """
    nothing = None, inputs.baseline.thrust_enu_m_s2
    if not isinstance(answer, tuple) or len(answer) != 2:
        return *nothing, f"returned {_named(answer)} instead of the pair (memory, thrust)"
    memory, given = answer
    numbers = given.thrust_enu_m_s2 if isinstance(given, Thrust) else given
    try:
        if isinstance(numbers, str | bytes | dict):
            raise TypeError
        thrust = Vec3(*(float(number) for number in numbers))
    except Exception:  # noqa: BLE001 - of whatever type the law returned
        return *nothing, f"returned {_named(given)} instead of a thrust of three numbers"
    return memory, thrust, _excess(thrust, inputs)


def _named(value: Any) -> str:
    return "nothing" if value is None else f"a {type(value).__name__}"


def _excess(thrust: Vec3, inputs: LawInputs) -> str:
    """Return which limit a thrust does not keep; empty if it keeps all."""
    if not all(math.isfinite(number) for number in thrust):
        return f"returned a thrust that is not finite: ({thrust.x:g}, {thrust.y:g}, {thrust.z:g})"
    limits, s = inputs.vehicle, inputs.compensation_enu_m_s2
    if not LEAST_THRUST_G * GRAVITY_M_S2 <= thrust.z <= limits.max_thrust_m_s2:
        return (
            f"asked for a vertical thrust of {thrust.z:.3g} m/s^2, and a vehicle flies with "
            f"{LEAST_THRUST_G * GRAVITY_M_S2:.1f} to {limits.max_thrust_m_s2:.1f} m/s^2"
        )
    across = math.hypot(thrust.x + s.x, thrust.y + s.y)
    tilt = math.atan2(across, thrust.z)
    if tilt > limits.max_tilt_rad + _TILT_SLACK_RAD:
        most = math.degrees(limits.max_tilt_rad)
        return f"tilted by {math.degrees(tilt):.0f} degrees, and max_tilt_deg is {most:.0f}"
    if across > horizontal_limit(thrust.z, limits) + math.tan(_TILT_SLACK_RAD) * thrust.z:
        return f"asked for {math.hypot(across, thrust.z):.3g} m/s^2, and the motors give {limits.max_thrust_m_s2:.1f}"
    return ""


def flown_instead(
    thrust: Vec3, covey: LawOutput, memory: LawMemory, before: LawMemory, inputs: LawInputs
) -> tuple[LawMemory, LawOutput]:
    """Return Covey's memory and output with a law's thrust in the place of Covey's.

    Args:
        thrust: that is flown.
        covey: output of Covey's law at the same tick.
        memory: of Covey's law after that; before: of the last tick.
        inputs: of the tick.
    """
    command = Vec3(thrust.x, thrust.y, thrust.z - GRAVITY_M_S2)
    x, y, z = inputs.baseline.thrust_enu_m_s2
    change = math.hypot(thrust.x - x, thrust.y - y, thrust.z - z)
    output = covey._replace(
        thrust=Thrust(thrust),
        commanded_acceleration_enu_m_s2=command,
        status=int(LawStatus.SATURATED if change > _CHANGED_M_S2 else LawStatus.INACTIVE),
        intervention_m_s2=change,
        slack_m_s2=0.0,
        active_neighbour=NOBODY,
    )
    return memory._replace(commands=remembered(before.commands, command, inputs.dt_s)), output
