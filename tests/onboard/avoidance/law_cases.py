"""Values for tests of the law: vehicles, neighbours, random encounters, and the world turned,
shifted and scaled.
"""

import math

import numpy as np

from onboard.avoidance import interface, oist
from onboard.avoidance.half_planes import HalfPlane
from onboard.avoidance.params import Capsule, VehicleLimits, params_of
from onboard.avoidance.projection import RELAXED, Projection, project, relaxed_in_order
from onboard.config.law import LawConfig
from onboard.constants import GRAVITY_M_S2
from onboard.types import Neighbour, State, Thrust
from onboard.vectors import ZERO_3, Vec2, Vec3

FENCE = (-3.0, 3.0, -3.0, 3.0)
CAPSULES = tuple(
    Capsule(Vec2(*begin), Vec2(*end), radius)
    for begin, end, radius in (
        ((1.0, 1.0), (1.0, 1.0), 0.4),
        ((-2.0, -1.0), (-1.0, 2.0), 0.0),
        ((0.0, -2.0), (2.0, -2.0), 0.0),
    )
)


def nearest_thrust(u: Vec2, rows: list[HalfPlane], radius: float) -> Projection:
    """Return what the law flies where all hard rows give way by one common slack."""
    projection = project(u, rows, radius)
    if projection.status != RELAXED:
        return projection
    return relaxed_in_order(u, rows, [], radius)


def vec(values):
    return Vec3(*map(float, values))


def law_of(limits=None, **config):
    """LawParams for values of [law]; ``limits`` of the vehicle."""
    return params_of(LawConfig(**config), VehicleLimits(**(limits or {})))


def state_of(position, velocity, std=(0.0, 0.0)):
    position_std_m, velocity_std_m_s = std
    return State(
        position_enu_m=vec(position),
        velocity_enu_m_s=vec(velocity),
        acceleration_enu_m_s2=ZERO_3,
        yaw_rad=0.0,
        age_s=0.0,
        position_std_m=float(position_std_m),
        velocity_std_m_s=float(velocity_std_m_s),
    )


def neighbour_of(position, velocity=ZERO_3, command=ZERO_3, **changes):
    """One that cooperates, with a fresh message; ``changes`` replace fields."""
    p = vec(position)
    v = vec(velocity)
    u = vec(command)
    unknown = Vec3(math.nan, math.nan, math.nan)
    made = Neighbour(
        position_enu_m=p,
        velocity_enu_m_s=v,
        acceleration_enu_m_s2=u,
        predicted_position_enu_m=p,
        predicted_velocity_enu_m_s=v,
        commanded_acceleration_enu_m_s2=u,
        intent_enu_m_s=unknown,
        age_s=0.0,
        lead_time_s=math.nan,
        position_std_m=0.0,
        velocity_std_m_s=0.0,
        crowd_count=0.0,
        is_cooperative=True,
        is_paper_obstacle=True,
        table_index=0,
        radius_m=0.0,
    )
    return made._replace(**changes)


def neighbours_of(positions, velocities=None, commands=None):
    """Neighbours in this order; the first one is the ring's successor."""
    still = [ZERO_3] * len(positions)
    return [
        neighbour_of(p, v, u, is_paper_obstacle=k == 0, table_index=k)
        for k, (p, v, u) in enumerate(
            zip(positions, velocities or still, commands or still, strict=True)
        )
    ]


def run(
    position,
    velocity,
    accel,
    neighbours,
    params,
    *,
    std=(0.0, 0.0),
    compensation=ZERO_3,
    intent=None,
    obstacles=(),
):
    """Output of one tick of a vehicle without past commands, whose baseline asks for an
    acceleration.
    """
    memory = oist.initial()
    state = state_of(position, velocity, std)
    predicted = oist.predict(memory, state, params, 0.02)
    intent = predicted.velocity_enu_m_s if intent is None else vec(intent)
    baseline = interface.Baseline(thrust_of(accel), vec(compensation), intent)
    return oist.step(memory, baseline, predicted, state, neighbours, obstacles, params, 0.02)[1]


def thrust_of(accel):
    x, y, z = map(float, accel)
    return Thrust(Vec3(x, y, z + GRAVITY_M_S2))


def random_case(seed, count=4):
    """Position, velocity, acceleration and neighbours around them, often too near."""
    rng = np.random.default_rng(seed)
    spots = rng.normal(size=(count, 3)) * 0.8
    spots[:, :2] += np.sign(spots[:, :2]) * 0.5
    velocities = rng.normal(size=(count, 3)) * 0.3
    commands = rng.normal(size=(count, 3)) * 0.5
    neighbours = neighbours_of(list(spots), list(velocities), list(commands))
    return rng.normal(size=3) * 0.1, rng.normal(size=3) * 0.3, rng.normal(size=3) * 1.5, neighbours


def random_neighbour(rng, index, spread):
    """Any message: another lag, some age, uncertain, perhaps not cooperative, perhaps without an
    intent.
    """
    position = rng.normal(size=3) * spread
    velocity = rng.normal(size=3) * 0.5
    return Neighbour(
        position_enu_m=vec(position),
        velocity_enu_m_s=vec(velocity),
        acceleration_enu_m_s2=vec(rng.normal(size=3)),
        predicted_position_enu_m=vec(position + 0.15 * velocity),
        predicted_velocity_enu_m_s=vec(velocity + 0.1 * rng.normal(size=3)),
        commanded_acceleration_enu_m_s2=vec(rng.normal(size=3)),
        intent_enu_m_s=vec(rng.normal(size=3) * 0.4)
        if rng.random() < 0.8
        else Vec3(math.nan, math.nan, math.nan),
        age_s=abs(rng.normal()) * 0.1,
        lead_time_s=abs(rng.normal()) * 0.2 if rng.random() < 0.9 else math.nan,
        position_std_m=abs(rng.normal()) * 0.02,
        velocity_std_m_s=abs(rng.normal()) * 0.05,
        crowd_count=float(rng.integers(0, 6)),
        is_cooperative=bool(rng.random() < 0.8),
        is_paper_obstacle=bool(rng.random() < 0.5),
        table_index=index,
        radius_m=0.0,
    )


def mapped(neighbour, function):
    """The neighbour with function(name, value) in place of each value."""
    return Neighbour(
        *(function(name, value) for name, value in zip(Neighbour._fields, neighbour, strict=True))
    )


def horizontal(vector):
    return np.array(vector[:2])
