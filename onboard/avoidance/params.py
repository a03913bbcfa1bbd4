"""Numbers of the avoidance law for one vehicle, computed from the fleet file.

:func:`law_params` computes them once for each flight. Policies are names in the configuration and
whole numbers here, because compiled code compares numbers. ``README.md`` beside this file explains
each value.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import msgspec

from onboard.config.areas import Area
from onboard.config.fleet import FleetConfig
from onboard.config.flight_space import flight_space_of
from onboard.config.law import QUICK_LAG_S, BuiltInLaw, LawConfig
from onboard.constants import GRAVITY_M_S2, MAX_PLANNED_THRUST_FRAC
from onboard.vectors import Vec2, cross_xy

OPEN_FENCE = (-math.inf, math.inf, -math.inf, math.inf)  # x low, x high, y low, y high
_BRAKE_SHARE = 0.6  # share of the largest horizontal acceleration for braking before static things

# The margin for the accuracy is the floor plus MARGIN_SIGMAS standard deviations of the distance.
# Both numbers come from simulated flights. The floor covers lag errors and gusts.
MARGIN_FLOOR_M = 0.05
MARGIN_SIGMAS = 5.0

# names of the law and the policies in LawConfig; the numbers below are their indexes
LAW_NAMES: tuple[BuiltInLaw, ...] = ("off", "paper", "covey")
OFF = 0
PAPER = 1
COVEY = 2

_RESPONSIBILITIES = ("half", "shortfall", "full")
RESPONSIBILITY_HALF = 0
RESPONSIBILITY_SHORTFALL = 1
RESPONSIBILITY_FULL = 2

_PREDICTIONS = ("none", "lag")
PREDICTION_NONE = 0
PREDICTION_LAG = 1

_ROTATIONS = ("never", "violated", "always", "ahead")
ROTATION_NEVER = 0
ROTATION_VIOLATED = 1
ROTATION_ALWAYS = 2
ROTATION_AHEAD = 3

_DIRECTIONS = ("fixed", "pair", "crowd", "intent")
DIRECTION_FIXED = 0
DIRECTION_PAIR = 1
DIRECTION_CROWD = 2
DIRECTION_INTENT = 3

_JAMS = ("ignore", "slow")
JAM_IGNORE = 0
JAM_SLOW = 1


class Capsule(NamedTuple):
    """A static thing in fleet ENU: an obstacle, or an edge of an area to stay in or out of.

    An obstacle is the set of all points that are nearer to a segment than a radius. An edge is
    either a segment with the allowed side on its left, or a circle. The segment of a circle has no
    length.
    """

    begin_enu_m: Vec2
    end_enu_m: Vec2
    radius_m: float

    # the fields below are used for edges only
    area: int = 0  # number of the edge's area, from 1; 0: this is an obstacle
    keep_m: float = 0.0  # distance from the edge that the vehicle's centre keeps
    # Whether the edge may have a rotation row, because a goal may lie behind it. This is so for
    # edges of forbidden areas and edges at corners that point inwards.
    is_turned_about: bool = False
    is_begin_inwards: bool = False  # whether the first corner points into the allowed space
    is_end_inwards: bool = False  # the same for the second corner
    # the edge counts for vehicles inside this box; the box is infinite for a circle to stay inside
    west_m: float = -math.inf
    east_m: float = math.inf
    south_m: float = -math.inf
    north_m: float = math.inf
    low_m: float = -math.inf
    high_m: float = math.inf


class PaperParams(NamedTuple):
    """Tuning of the paper's own law, (5) to (22)."""

    kappa_1_1_s: float
    kappa_2_1_s: float
    kappa_3_1_s: float
    kappa_4_1_s: float
    v_perp_m_s: float
    d_inf_m: float
    turn_sign: float  # +1 for (8), -1 for (9)


class Policies(NamedTuple):
    """Choices among variants of the law, by the numbers above."""

    responsibility: int
    prediction: int
    rotation: int
    direction: int
    jam: int


class Spacing(NamedTuple):
    """Distances to keep, and the neighbours that count."""

    safety_distance_m: float  # d_inf
    # pairs with a larger height difference do not count; infinite: every pair counts
    vertical_separation_m: float

    margin_m: float  # design margin while estimates are good, for lags up to margin_lag_s
    margin_lag_s: float
    lag_margin_m_s: float  # added for each second of a neighbour's lag beyond margin_lag_s
    uncooperative_margin_m: float  # added for a neighbour that does not cooperate

    # the margin under the accuracy policy; all three are 0 under the fixed policy
    margin_floor_m: float  # the part that does not depend on the accuracy
    sigma_position: float  # per metre of a vehicle's standard deviation of position
    sigma_velocity_s: float  # per m/s of its standard deviation of velocity

    clearance_m: float  # kept from an obstacle's outline by the vehicle's centre
    max_neighbours: int  # number of neighbours that count: the nearest
    range_m: float  # only neighbours within this distance count


class Gains(NamedTuple):
    """Tuning of the rows."""

    kappa_1_1_s: float
    kappa_2_1_s: float
    kappa_3_1_s: float
    kappa_4_1_s: float
    static_kappa_1_1_s: float  # kappa_1 for static things
    shortfall_gain: float  # gamma
    v_perp_m_s: float
    v_perp_crowd_m_s: float  # in place of v_perp_m_s in a crowd
    crowd_count: int  # number of near neighbours that make a crowd
    rotation_fade_m_s2: float  # violation at which a rotation row reaches its full strength


class Walls(NamedTuple):
    """Walls of the box in fleet ENU, moved inwards by the margin; infinite: there is no wall."""

    low_x_m: float
    high_x_m: float
    low_y_m: float
    high_y_m: float


class LawParams(NamedTuple):
    """All parameters of one vehicle's law."""

    law: int  # OFF, PAPER or COVEY
    policies: Policies
    lag_s: float  # L: from a command to its acceleration
    vertical_lag_s: float  # the part of L that comes from the motors
    lead_time_s: float  # how far in the future the rows are evaluated: L, or 0 without prediction
    spacing: Spacing
    gains: Gains
    max_speed_m_s: float
    top_speed_m_s: float  # while avoiding
    max_tilt_rad: float
    max_thrust_m_s2: float  # collective thrust per mass at full throttle
    fence: Walls
    paper: PaperParams


class VehicleLimits(NamedTuple):
    """Properties of the vehicle and its fence that the law depends on."""

    lag_s: float = 0.15
    vertical_lag_s: float = 0.09
    safety_distance_m: float = 0.8
    vertical_separation_m: float = math.inf
    body_radius_m: float = 0.25  # from the vehicle's centre to its hull
    max_speed_m_s: float = 1.0
    max_tilt_rad: float = math.radians(25.0)
    max_thrust_m_s2: float = 2.0 * GRAVITY_M_S2
    fence_enu_m: tuple[float, float, float, float] = OPEN_FENCE  # x low, x high, y low, y high


# represents any vehicle when only the values of ``[law]`` matter
QUICK_VEHICLE = VehicleLimits()


def law_params(fleet: FleetConfig, vehicle_name: str, law: str | None = None) -> LawParams:
    """Return the law's numbers for one vehicle of a fleet.

    Args:
        fleet: checked configuration.
        vehicle_name: a key of ``fleet.vehicles``.
        law: "covey", "paper" or "off", which overrides the fleet file.
    Raises:
        ValueError: there is no law of that name.
    """
    config = fleet.law
    if law is not None:
        config = _with_law(config, law)

    vertical_separation_m = math.inf
    if fleet.fleet.vertical_separation_m is not None:
        vertical_separation_m = fleet.fleet.vertical_separation_m

    vehicle = fleet.vehicles[vehicle_name]
    limits = VehicleLimits(
        lag_s=vehicle.lag_s,
        safety_distance_m=fleet.fleet.safety_distance_m,
        vertical_separation_m=vertical_separation_m,
        body_radius_m=0.5 * fleet.fleet.body_diameter_m,
        max_speed_m_s=vehicle.max_speed_m_s,
        max_tilt_rad=math.radians(vehicle.max_tilt_deg),
        max_thrust_m_s2=MAX_PLANNED_THRUST_FRAC / vehicle.hover_thrust_frac * GRAVITY_M_S2,
        fence_enu_m=(*fleet.fleet.geofence_m.x, *fleet.fleet.geofence_m.y),
    )
    return params_of(config, limits)


def _with_law(config: LawConfig, law: str) -> LawConfig:
    """Return the values of ``[law]`` with another built-in law."""
    if law not in LAW_NAMES:
        raise ValueError(
            f"law is '{law}', but there are only {', '.join(LAW_NAMES)}. Name one of these."
        )
    checked_name = LAW_NAMES[LAW_NAMES.index(law)]  # equals `law`, with the type BuiltInLaw
    return msgspec.structs.replace(config, name=checked_name)


def obstacles(fleet: FleetConfig) -> tuple[Capsule, ...]:
    """Return the static obstacles of a fleet in the form that the law uses.

    Args:
        fleet: checked configuration.
    """
    capsules = []
    for obstacle in fleet.obstacles:
        for begin_x, begin_y, end_x, end_y, radius in obstacle.capsules_enu_m:
            begin = Vec2(float(begin_x), float(begin_y))
            end = Vec2(float(end_x), float(end_y))
            capsules.append(Capsule(begin, end, float(radius)))
    return tuple(capsules)


def still(fleet: FleetConfig) -> tuple[Capsule, ...]:
    """Return the static things of a fleet: its obstacles, and the edges of its areas.

    Args:
        fleet: checked configuration.
    """
    edges: list[Capsule] = []
    for number, area in enumerate(flight_space_of(fleet).areas, 1):
        edges.extend(_edges(area, number, fleet.law.fence_margin_m))
    return (*obstacles(fleet), *edges)


def _edges(area: Area, number: int, margin_m: float) -> Iterator[Capsule]:
    """Yield the edges of an area in the form that the law uses."""
    keep_m = float(area.buffer_m + margin_m)
    low_m = -math.inf if area.keeps_in else area.low_m - keep_m
    high_m = math.inf if area.keeps_in else area.high_m + keep_m

    if not area.corners_enu_m:
        center = Vec2(*area.center_enu_m)
        reach_m = math.inf if area.keeps_in else area.radius_m + keep_m
        yield Capsule(
            begin_enu_m=center,
            end_enu_m=center,
            radius_m=area.radius_m,
            area=number,
            keep_m=keep_m,
            is_turned_about=not area.keeps_in,
            west_m=center.x - reach_m,
            east_m=center.x + reach_m,
            south_m=center.y - reach_m,
            north_m=center.y + reach_m,
            low_m=low_m,
            high_m=high_m,
        )
        return

    corners = [Vec2(*corner) for corner in area.corners_enu_m]
    is_inwards = [_points_inwards(corners, index) for index in range(len(corners))]
    for index, begin in enumerate(corners):
        following = (index + 1) % len(corners)
        end = corners[following]
        yield Capsule(
            begin_enu_m=begin,
            end_enu_m=end,
            radius_m=0.0,
            area=number,
            keep_m=keep_m,
            is_turned_about=not area.keeps_in or is_inwards[index] or is_inwards[following],
            is_begin_inwards=is_inwards[index],
            is_end_inwards=is_inwards[following],
            west_m=min(begin.x, end.x) - keep_m,
            east_m=max(begin.x, end.x) + keep_m,
            south_m=min(begin.y, end.y) - keep_m,
            north_m=max(begin.y, end.y) + keep_m,
            low_m=low_m,
            high_m=high_m,
        )


def _points_inwards(corners: Sequence[Vec2], index: int) -> bool:
    """Return whether a corner points into the allowed space: the outline turns right there."""
    before = corners[index - 1]
    here = corners[index]
    after = corners[(index + 1) % len(corners)]
    arriving = Vec2(here.x - before.x, here.y - before.y)
    leaving = Vec2(after.x - here.x, after.y - here.y)
    return cross_xy(arriving, leaving) < 0.0


def params_of(config: LawConfig, limits: VehicleLimits = QUICK_VEHICLE) -> LawParams:
    """Return the law's numbers for values of ``[law]`` and a vehicle.

    All numbers are converted to float or int here. A fleet file may say 1 for 1.0, but compiled
    code accepts only one type for each number.

    Args:
        config: values and policies of ``[law]``.
        limits: properties of the vehicle and its room.
    """
    # the paper's own law has no prediction
    lead_time_s = 0.0
    if config.prediction == "lag" and config.built_in != "paper":
        lead_time_s = float(limits.lag_s)

    return LawParams(
        law=LAW_NAMES.index(config.built_in),
        policies=_policies(config),
        lag_s=float(limits.lag_s),
        vertical_lag_s=float(min(limits.vertical_lag_s, limits.lag_s)),
        lead_time_s=lead_time_s,
        spacing=_spacing(config, limits),
        gains=_gains(config, limits),
        max_speed_m_s=float(limits.max_speed_m_s),
        top_speed_m_s=float(config.avoid_speed_frac * limits.max_speed_m_s),
        max_tilt_rad=float(limits.max_tilt_rad),
        max_thrust_m_s2=float(limits.max_thrust_m_s2),
        fence=_fence(config, limits),
        paper=_paper(config, limits),
    )


def _policies(config: LawConfig) -> Policies:
    """Return the policies by their numbers."""
    return Policies(
        responsibility=_RESPONSIBILITIES.index(config.responsibility),
        prediction=_PREDICTIONS.index(config.prediction),
        rotation=_ROTATIONS.index(config.rotation),
        direction=_DIRECTIONS.index(config.direction),
        jam=_JAMS.index(config.jam),
    )


def _fence(config: LawConfig, limits: VehicleLimits) -> Walls:
    """Return the walls, moved inwards by the margin."""
    low_x_m, high_x_m, low_y_m, high_y_m = limits.fence_enu_m
    margin_m = config.fence_margin_m
    return Walls(
        low_x_m=float(low_x_m + margin_m),
        high_x_m=float(high_x_m - margin_m),
        low_y_m=float(low_y_m + margin_m),
        high_y_m=float(high_y_m - margin_m),
    )


def _paper(config: LawConfig, limits: VehicleLimits) -> PaperParams:
    """Return the tuning of the paper's own law."""
    return PaperParams(
        kappa_1_1_s=float(config.paper_kappa_1_1_s),
        kappa_2_1_s=float(config.paper_kappa_2_1_s),
        kappa_3_1_s=float(config.paper_kappa_3_1_s),
        kappa_4_1_s=float(config.paper_kappa_4_1_s),
        v_perp_m_s=float(config.paper_v_perp_m_s),
        d_inf_m=float(limits.safety_distance_m + config.paper_margin_m),
        turn_sign=1.0 if config.paper_turn == "eq8" else -1.0,
    )


def _spacing(config: LawConfig, limits: VehicleLimits) -> Spacing:
    """Return the distances to keep; the policy ``margin`` decides whether the accuracy margin
    applies.
    """
    margin_floor_m = 0.0
    sigma_position = 0.0
    sigma_velocity_s = 0.0
    if config.margin == "accuracy":
        margin_floor_m = MARGIN_FLOOR_M
        sigma_position, sigma_velocity_s = _sigmas(config)

    return Spacing(
        safety_distance_m=float(limits.safety_distance_m),
        vertical_separation_m=float(limits.vertical_separation_m),
        margin_m=float(config.margin_m(limits.lag_s)),
        margin_lag_s=float(max(limits.lag_s, QUICK_LAG_S)),
        lag_margin_m_s=float(config.lag_margin_m_s),
        uncooperative_margin_m=float(config.uncooperative_margin_m),
        margin_floor_m=margin_floor_m,
        sigma_position=sigma_position,
        sigma_velocity_s=sigma_velocity_s,
        clearance_m=float(limits.body_radius_m + config.obstacle_margin_m),
        max_neighbours=int(config.max_neighbours),
        range_m=float(config.range_m),
    )


def _gains(config: LawConfig, limits: VehicleLimits) -> Gains:
    """Return the tuning of the rows."""
    # The row of an obstacle lets a vehicle approach with kappa_1 times its distance. Stopping from
    # that speed must not need more deceleration than the vehicle can deliver.
    brake_m_s2 = _BRAKE_SHARE * GRAVITY_M_S2 * math.tan(limits.max_tilt_rad)
    top_speed_m_s = config.avoid_speed_frac * limits.max_speed_m_s
    static_kappa_1_1_s = min(config.kappa_1_1_s, brake_m_s2 / top_speed_m_s)

    return Gains(
        kappa_1_1_s=float(config.kappa_1_1_s),
        kappa_2_1_s=float(config.kappa_2_1_s),
        kappa_3_1_s=float(config.kappa_3_1_s),
        kappa_4_1_s=float(config.kappa_4_1_s),
        static_kappa_1_1_s=float(static_kappa_1_1_s),
        shortfall_gain=float(config.shortfall_gain),
        v_perp_m_s=float(config.v_perp_m_s),
        v_perp_crowd_m_s=float(config.v_perp_crowd_m_s),
        crowd_count=int(config.crowd_count),
        rotation_fade_m_s2=float(config.rotation_fade_m_s2),
    )


def _sigmas(config: LawConfig) -> tuple[float, float]:
    """Return the margin per metre and per m/s of one vehicle's standard deviations.

    Let a_1 be the sum and a_0 the product of the kappas. The distance row multiplies an error of
    position by a_0, and an error of velocity by a_1. The distance follows through the filter
    1 / (s^2 + a_1 s + a_0). This filter passes an error of correlation time tau with the power
    Phi(tau). The powers of the two vehicles add.
    """
    a_1 = config.kappa_1_1_s + config.kappa_2_1_s
    a_0 = config.kappa_1_1_s * config.kappa_2_1_s

    rate_1_s = 1.0 / config.accuracy_time_s  # 1 / tau
    phi = (a_1 + rate_1_s) / (a_0 * a_1 * (rate_1_s * rate_1_s + a_1 * rate_1_s + a_0))

    sigma_position = MARGIN_SIGMAS * a_0 * math.sqrt(phi)
    sigma_velocity_s = MARGIN_SIGMAS * a_1 * math.sqrt(phi)
    return sigma_position, sigma_velocity_s
