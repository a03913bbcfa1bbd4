"""Checks of paths that are flown together. Pure.

Mission checks and the import of shows use them. All paths are sampled at common times; the samples
are compared with the vehicles' limits, the fence, the ground and the law's distance. Each check
returns a finding with vehicle, time, value and bound.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array
from onboard.config.areas import Area
from onboard.config.fleet import FleetConfig, above_words, parking_distance_m, parking_height_share
from onboard.config.flight_space import flight_space_of
from onboard.config.ground import ground_at_m, least_height_m, touchable_ground_at_m
from onboard.config.obstacles import Circle
from onboard.constants import GRAVITY_M_S2
from onboard.control.path import (
    MAX_JUMP_M,
    MAX_JUMP_M_S,
    MAX_TURN_RAD_S,
    YAW,
    Path,
    jumps,
    sampled,
)
from onboard.control.vertical_limits import planned_m_s2
from onboard.estimation.accuracies import ACCURACIES, Accuracy
from onboard.feasibility.finding import Finding, at_least, at_most, worst
from onboard.feasibility.fleet_checks import ErrorClass, error_class
from onboard.feasibility.pair_checks import height_accuracy_m, parking_m
from onboard.plain_text import capitalised
from onboard.safety.area_room import clearances_m, rooms_m
from onboard.tuples import Xyz

LOWEST_M = 0.3  # lowest height of a path above the ground
STEP_S = 0.05  # time from one sample to the next
# difference between the parking distance and the distance at which the law begins to act
_PARKING_MORE_M = 0.10
_END_SPEED_M_S = 0.05  # largest speed at the start and at the end of a path
_BLOCK_SAMPLES = 400  # number of samples compared at once, which limits the memory
_MAX_LISTED = 12  # items of a list that a sentence names
# Share of the acceleration at the largest tilt that the slowing of paths leaves them. It counts no
# vertical acceleration, and a vehicle that accelerates downwards has less lift to tilt: with up to
# 2.25 m/s^2 downwards, 0.77 of it. The finding about tilt does count it, and needs no share. So a
# path that was slowed keeps the limit that is checked later.
_TILT_SHARE = 0.8
_LIMIT_FACTOR = 1.01  # factor on a limit above which a path is refused
_FENCE_ROOM_M = 0.15  # smallest distance of a path from the fence
_YAW_BEHIND_DEG = 10.0  # a heading that stays further behind its path's is a warning
# How long it stays so. A shorter time is that of numbers that wrap, or of a jerk.
_YAW_BEHIND_S = 0.5
# Step with which paths are compared with resting vehicles, in flight.
_LOOK_EVERY_S = 0.1


class SampledPaths(NamedTuple):
    """Motion of all vehicles at common times; each vehicle stays at the end of its path."""

    names: tuple[str, ...]
    times_s: Array  # (T,)
    values: Array  # (3, T, N, 4): value, first and second derivative of x, y, z [m] and yaw [rad]


class _Motion(NamedTuple):
    """What paths demand of the vehicles on them, at each time and for each vehicle (T, N)."""

    speed_m_s: Array
    acceleration_m_s2: Array
    vertical_m_s2: Array  # of the acceleration, in size


class ClosestApproach(NamedTuple):
    """Smallest horizontal distance of one pair, including between the samples."""

    distance_m: float
    first: str
    second: str
    time_s: float
    height_m: float  # difference of their heights at that time


class FlightLimits(NamedTuple):
    """Limits that all of some vehicles can keep."""

    max_speed_m_s: float
    max_acceleration_m_s2: float
    max_vertical_m_s2: float  # of the vertical acceleration
    max_tilt_deg: float
    drag_1_s: float


def limits_of(fleet: FleetConfig, names: Sequence[str]) -> FlightLimits:
    """Return the limits that all of these vehicles can keep."""
    flying = [fleet.vehicles[name] for name in names]
    return FlightLimits(
        max_speed_m_s=min(vehicle.max_speed_m_s for vehicle in flying),
        max_acceleration_m_s2=min(vehicle.max_acceleration_m_s2 for vehicle in flying),
        max_vertical_m_s2=min(planned_m_s2(vehicle.hover_thrust_frac) for vehicle in flying),
        max_tilt_deg=min(vehicle.max_tilt_deg for vehicle in flying),
        drag_1_s=max(vehicle.drag_1_s for vehicle in flying),
    )


def sample(paths: Mapping[str, Path], step_s: float = STEP_S) -> SampledPaths:
    """Return the motion of all paths from their common start to the end of the longest one."""
    longest_s = max(path.duration_s for path in paths.values())
    times_s = np.linspace(0.0, longest_s, max(2, math.ceil(longest_s / step_s) + 1))
    values = np.stack([sampled(path, times_s) for path in paths.values()], axis=2)
    return SampledPaths(tuple(paths), times_s, values)


def _motion_of(flown: SampledPaths) -> _Motion:
    """Return what paths demand of the vehicles on them."""
    _, velocity, acceleration = flown.values
    return _Motion(
        speed_m_s=np.sqrt((velocity[..., :3] ** 2).sum(-1)),
        acceleration_m_s2=np.sqrt((acceleration[..., :3] ** 2).sum(-1)),
        vertical_m_s2=np.abs(acceleration[..., 2]),
    )


def highest_points(fleet: FleetConfig, paths: Mapping[str, Path]) -> dict[str, Xyz]:
    """Return the point of each path that is highest above the ground below it [m], ENU.

    Args:
        fleet: the fleet file.
        paths: paths of its vehicles.
    """
    flown = sample(paths)
    positions = flown.values[0, :, :, :3]
    height_m = positions[..., 2] - ground_at_m(fleet, positions[..., 0], positions[..., 1])

    points: dict[str, Xyz] = {}
    for index, name in enumerate(flown.names):
        x, y, z = positions[height_m[:, index].argmax(), index].tolist()
        points[name] = (x, y, z)
    return points


def path_spacing_m(fleet: FleetConfig, accuracy: Accuracy) -> float:
    """Return the distance that paths must keep from each other.

    For Covey's law it is the distance at which the law begins to act, and more with positions that
    are less accurate than those of motion capture. For other laws it is the safety distance of the
    fleet file.

    Args:
        fleet: the fleet file.
        accuracy: accuracy of the vehicles' estimates.
    """
    if fleet.law.built_in != "covey":
        return fleet.fleet.safety_distance_m
    by_mocap_m = parking_distance_m(fleet) - _PARKING_MORE_M
    wider_m = parking_m(fleet, accuracy) - parking_m(fleet, ACCURACIES["mocap"])
    return by_mocap_m + wider_m


def height_share_of(fleet: FleetConfig, accuracy: Accuracy) -> float:
    """Return how many metres of :func:`path_spacing_m` one metre of height counts for.

    Args:
        fleet: the fleet file.
        accuracy: accuracy of the vehicles' estimates.
    """
    wider_m = height_accuracy_m(accuracy) - height_accuracy_m(ACCURACIES["mocap"])
    return parking_height_share(fleet, wider_m)


def closest_pairs(
    flown: SampledPaths, below_m: float = 0.0, height_share: float = 0.0
) -> list[ClosestApproach]:
    """Return the nearest pair of all, and each other pair that comes nearer than a separation.

    Each pair is returned once, the nearest first. Vehicles are assumed to move straight between two
    samples.

    Args:
        flown: the paths.
        below_m: the separation [m]; 0 returns the nearest pair only.
        height_share: factor of height differences in separations.
    """
    # one row for each pair: indices of its two vehicles
    first, second = np.triu_indices(len(flown.names), 1)
    smallest_m = np.full(len(first), np.inf)
    sample_of_smallest = np.zeros(len(first), np.int64)

    xy = flown.values[0, :, :, :2]
    z = flown.values[0, :, :, 2]
    for begin in range(0, len(xy) - 1, _BLOCK_SAMPLES):
        block = slice(begin, begin + _BLOCK_SAMPLES + 1)

        # The point of each step, from sample to sample, at which the two vehicles are nearest. The
        # lower limit of the divisor avoids a division by zero if both move alike.
        gap = xy[block][:, first] - xy[block][:, second]
        step = np.diff(gap, axis=0)
        along = -(gap[:-1] * step).sum(-1) / np.maximum((step**2).sum(-1), 1e-12)
        near = gap[:-1] + np.clip(along, 0.0, 1.0)[..., None] * step
        distance_m = np.sqrt((near**2).sum(-1))

        if height_share > 0.0:
            # The smallest difference of heights within each step counts, to be safe.
            height = z[block][:, first] - z[block][:, second]
            is_one_above = height[:-1] * height[1:] > 0.0
            least = np.minimum(abs(height[:-1]), abs(height[1:]))
            distance_m = np.maximum(distance_m, height_share * np.where(is_one_above, least, 0.0))

        nearest_step = distance_m.argmin(0)  # of each pair, counted from the start of the block
        smallest_of_block_m = distance_m[nearest_step, np.arange(len(first))]
        is_nearer = smallest_of_block_m < smallest_m
        smallest_m[is_nearer] = smallest_of_block_m[is_nearer]
        sample_of_smallest[is_nearer] = begin + nearest_step[is_nearer]

    nearest_pair = smallest_m.argmin()
    pairs = []
    for pair in np.argsort(smallest_m):
        if smallest_m[pair] >= below_m and pair != nearest_pair:
            continue
        instant = sample_of_smallest[pair]
        pairs.append(
            ClosestApproach(
                distance_m=float(smallest_m[pair]),
                first=flown.names[first[pair]],
                second=flown.names[second[pair]],
                time_s=float(flown.times_s[instant]),
                height_m=abs(float(z[instant, first[pair]] - z[instant, second[pair]])),
            )
        )
    return pairs


class _Demand(NamedTuple):
    """One quantity of paths, compared with the bound up to which it can be flown."""

    noun: str
    values: Array  # (T, N)
    bound: float
    unit: str
    slowings: Array  # (T, N): factor by which the paths must take longer to keep the bound


def needed_slowing(
    flown: SampledPaths, limits: FlightLimits, *, begin_s: float = 0.0
) -> tuple[float, str]:
    """Return the factor by which paths must take longer, and the worst reason in words.

    If the factor is at most 1, the paths can be flown without a change.

    Args:
        flown: the paths.
        limits: limits of the vehicles.
        begin_s: start of the paths, on the clock of the times in the words [s].
    """
    motion = _motion_of(flown)

    # The tilt has to provide the path's own acceleration, and the drag at its speed.
    _, velocity, acceleration = flown.values
    sideways_m_s2 = np.hypot(acceleration[..., 0], acceleration[..., 1])
    drag_m_s2 = limits.drag_1_s * np.hypot(velocity[..., 0], velocity[..., 1])
    steepest_m_s2 = _TILT_SHARE * GRAVITY_M_S2 * math.tan(math.radians(limits.max_tilt_deg))

    demands = (
        _Demand(
            noun="speed",
            values=motion.speed_m_s,
            bound=limits.max_speed_m_s,
            unit="m/s",
            slowings=motion.speed_m_s / limits.max_speed_m_s,
        ),
        _Demand(
            noun="acceleration",
            values=motion.acceleration_m_s2,
            bound=limits.max_acceleration_m_s2,
            unit="m/s^2",
            slowings=np.sqrt(motion.acceleration_m_s2 / limits.max_acceleration_m_s2),
        ),
        _Demand(
            noun="vertical acceleration",
            values=motion.vertical_m_s2,
            bound=limits.max_vertical_m_s2,
            unit="m/s^2",
            slowings=np.sqrt(motion.vertical_m_s2 / limits.max_vertical_m_s2),
        ),
        _Demand(
            noun="tilt, as acceleration with drag,",
            values=sideways_m_s2 + drag_m_s2,
            bound=steepest_m_s2,
            unit="m/s^2",
            slowings=_slowings_of_tilt(sideways_m_s2, drag_m_s2, steepest_m_s2),
        ),
    )
    hardest = max(demands, key=lambda demand: float(demand.slowings.max()))
    step, index = np.unravel_index(hardest.slowings.argmax(), hardest.slowings.shape)
    time_s = begin_s + flown.times_s[step]
    words = (
        f"{flown.names[index]}'s {hardest.noun} was {hardest.values[step, index]:.2f} "
        f"{hardest.unit} at {time_s:.1f} s, {hardest.bound:g} is the most"
    )
    return float(hardest.slowings[step, index]), words


def _slowings_of_tilt(sideways_m_s2: Array, drag_m_s2: Array, steepest_m_s2: float) -> Array:
    """Return the factor by which a path must take longer to keep its tilt.

    If a path takes k times as long, its speed and its drag are divided by k, and its acceleration
    is divided by k^2. So k is the solution of a / k^2 + d / k = b.

    Args:
        sideways_m_s2: a, horizontal acceleration of the path.
        drag_m_s2: d, acceleration by drag at the path's speed.
        steepest_m_s2: b, horizontal acceleration at the largest tilt.
    """
    root = np.sqrt(drag_m_s2**2 + 4.0 * steepest_m_s2 * sideways_m_s2)
    return np.asarray((drag_m_s2 + root) / (2.0 * steepest_m_s2))


def pair_words(pair: ClosestApproach) -> str:
    """Return a pair in words."""
    words = f"{pair.first} and {pair.second} {pair.distance_m:.2f} m at {pair.time_s:.1f} s"
    if pair.height_m > pair.distance_m:
        words += f", one {pair.height_m:.1f} m above the other"
    return words


def listed_words(words: Sequence[str]) -> str:
    """Return the first items of a list in words, and the number of the others."""
    listed = "; ".join(words[:_MAX_LISTED])
    if len(words) > _MAX_LISTED:
        listed += f"; {len(words) - _MAX_LISTED} more"
    return listed


def paths_at_resting(
    fleet: FleetConfig, paths: Mapping[str, Path], resting_enu_m: Mapping[str, Xyz]
) -> list[str]:
    """Return a sentence about each path that leads to a vehicle that is on the ground or silent.

    The law keeps the safety distance from it, so whoever follows such a path may be stopped there.

    Args:
        fleet: the fleet file.
        paths: path of each vehicle.
        resting_enu_m: where other vehicles are on the ground, or were when they fell silent [m].
    """
    if not resting_enu_m:
        return []
    flown = sample(paths, _LOOK_EVERY_S)
    positions_enu_m = flown.values[0][..., :3]  # (T, N, 3)
    weights = np.array([1.0, 1.0, fleet.fleet.height_share])

    sentences = []
    for other, resting in resting_enu_m.items():
        away_m = weights * (positions_enu_m - np.array(resting))
        nearest_m = np.sqrt((away_m**2).sum(-1)).min(0)
        for name, distance_m in zip(flown.names, nearest_m.tolist(), strict=True):
            if distance_m < fleet.fleet.safety_distance_m:
                sentences.append(
                    f"The path of {name} leads {distance_m:.2f} m from {other}, which is on the "
                    f"ground or silent: the law may stop {name} there."
                )
    return sentences


def path_findings(
    fleet: FleetConfig, paths: Mapping[str, Path], where: str, *, errors: ErrorClass | None = None
) -> list[Finding]:
    """Check paths that begin together.

    Args:
        fleet: the fleet file.
        paths: paths of its vehicles.
        where: position in the mission, for the sentences.
        errors: accuracy of positions; None: the accuracy in the fleet file.

    Returns:
        One finding each for speed, acceleration, vertical acceleration, tilt, speed at the ends,
        yaw, jumps of position and velocity, fence, height, obstacles and spacing.
    """
    flown = sample(paths)
    vehicles = [fleet.vehicles[name] for name in flown.names]
    motion = _motion_of(flown)
    times_s = np.broadcast_to(flown.times_s[:, None], motion.speed_m_s.shape)
    end_times_s, end_speed_m_s = _at_the_ends(paths)

    findings = [
        _limit_finding(
            flown.names,
            times_s,
            motion.speed_m_s,
            noun="speed",
            unit="m/s",
            bounds=[vehicle.max_speed_m_s for vehicle in vehicles],
            where=where,
        ),
        _limit_finding(
            flown.names,
            times_s,
            motion.acceleration_m_s2,
            noun="acceleration",
            unit="m/s^2",
            bounds=[vehicle.max_acceleration_m_s2 for vehicle in vehicles],
            where=where,
        ),
        _limit_finding(
            flown.names,
            times_s,
            motion.vertical_m_s2,
            noun="vertical acceleration",
            unit="m/s^2",
            bounds=[planned_m_s2(vehicle.hover_thrust_frac) for vehicle in vehicles],
            where=where,
        ),
        _limit_finding(
            flown.names,
            times_s,
            _tilt_deg(fleet, flown),
            noun="tilt",
            unit="deg",
            bounds=[vehicle.max_tilt_deg for vehicle in vehicles],
            where=where,
        ),
        _limit_finding(
            flown.names,
            end_times_s,
            end_speed_m_s,
            noun="speed at the ends",
            unit="m/s",
            bounds=[_END_SPEED_M_S for _ in vehicles],
            where=where,
        ),
    ]
    findings.append(_yaw_finding(flown, where))
    findings += jump_findings(paths, where)
    findings += _fence_and_height_findings(fleet, flown, where)
    if fleet.obstacles:
        findings.append(_obstacle_finding(fleet, flown, where))
    if len(paths) > 1:
        accuracy = ACCURACIES[errors or error_class(fleet)]
        findings.append(_spacing_finding(fleet, flown, where, accuracy))
    return findings


def jump_findings(paths: Mapping[str, Path], where: str) -> list[Finding]:
    """Return the findings about the largest jumps of position and velocity between two pieces.

    Args:
        paths: paths of vehicles.
        where: position in the mission, for the sentences.
    """
    findings = []
    for index, (noun, bound, unit) in enumerate(
        (("position", MAX_JUMP_M, "m"), ("velocity", MAX_JUMP_M_S, "m/s"))
    ):
        name, time_s, jump = max(
            (_largest_jump(name, path, index) for name, path in paths.items()),
            key=lambda largest: largest[2],
        )
        findings.append(
            at_most(
                name=f"path jump of {noun}",
                where=where,
                value=jump,
                bound=bound,
                unit=unit,
                sentence=f"{capitalised(where)}: on {name}'s path the {noun} jumps by <value> at "
                f"{time_s:.1f} s, from one piece to the next; <relation> <bound> can be flown",
                remedy="Let each piece begin with the position and velocity with which the one "
                "before ends.",
                refuse_above=_LIMIT_FACTOR * bound,
                warn_above=_LIMIT_FACTOR * bound,
            )
        )
    return findings


def _largest_jump(name: str, path: Path, index: int) -> tuple[str, float, float]:
    """Return the vehicle's name, and time and size of its path's largest jump.

    Args:
        name: name of the vehicle.
        path: its path.
        index: 0 for jumps of position, 1 for jumps of velocity.
    """
    if len(path.pieces) == 1:
        return name, 0.0, 0.0

    sizes = jumps(path)[index]
    largest = int(sizes.argmax())
    return name, path.ends_s[largest], float(sizes[largest])


def _at_the_ends(paths: Mapping[str, Path]) -> tuple[Array, Array]:
    """Return times [s] and speeds [m/s] (2, N) of all paths at their own start and end."""
    times_s = np.array([[0.0, path.duration_s] for path in paths.values()])
    rates = np.array(
        [sampled(path, ends_s)[1] for path, ends_s in zip(paths.values(), times_s, strict=True)]
    )
    speed_m_s = np.sqrt((rates[:, :, :3] ** 2).sum(-1))
    return times_s.T, speed_m_s.T


def _limit_finding(
    names: Sequence[str],
    times_s: Array,
    values: Array,
    *,
    noun: str,
    unit: str,
    bounds: Sequence[float],
    where: str,
) -> Finding:
    """Return the finding about the vehicle whose value is largest compared with its bound.

    The values and their times are (T, N), or (2, N) for the start and the end. The bounds are (N).
    """
    step, index = np.unravel_index((values / np.array(bounds)).argmax(), values.shape)
    bound = bounds[index]

    return at_most(
        name=f"path {noun}",
        where=where,
        value=float(values[step, index]),
        bound=bound,
        unit=unit,
        sentence=f"{capitalised(where)}: on {names[index]}'s path {noun} is <value> at "
        f"{times_s[step, index]:.1f} s; <relation> <bound> can be flown",
        remedy="Slow the path, or raise the vehicle's limit: 'covey import' slows a show by "
        "itself.",
        refuse_above=_LIMIT_FACTOR * bound,
        warn_above=_LIMIT_FACTOR * bound,
    )


def yaw_finding(paths: Mapping[str, Path], where: str) -> Finding:
    """Return the finding about the heading that stays furthest behind that of its path.

    Args:
        paths: paths of vehicles.
        where: position in the mission, for the sentences.
    """
    return _yaw_finding(sample(paths), where)


def _yaw_finding(flown: SampledPaths, where: str) -> Finding:
    behind_deg = np.degrees(_yaw_behind_rad(flown))
    step, index = np.unravel_index(behind_deg.argmax(), behind_deg.shape)
    return at_most(
        name="path yaw",
        where=where,
        value=float(behind_deg[step, index]),
        bound=_YAW_BEHIND_DEG,
        unit="deg",
        sentence=f"{capitalised(where)}: from {flown.times_s[step]:.1f} s on the heading stays for "
        f"{_YAW_BEHIND_S:g} s <value> behind that of {flown.names[index]}'s path, because vehicles "
        f"turn by {math.degrees(MAX_TURN_RAD_S):.0f} degrees a second and the shorter way; "
        "<relation> <bound> counts as flown",
        remedy="Give the turn more time.",
        refuse_above=math.inf,
    )


def _yaw_behind_rad(flown: SampledPaths) -> Array:
    """Return how far each heading is at least behind its path's from each time on (T, N) [rad].

    The least of ``_YAW_BEHIND_S`` counts, also after the end of the paths.
    """
    step_s = float(flown.times_s[1] - flown.times_s[0])
    window = math.ceil(_YAW_BEHIND_S / step_s) + 1
    yaw_rad = np.pad(flown.values[0, :, :, YAW], ((0, window - 1), (0, 0)), mode="edge")

    # as the agent turns: the shorter way, and no further in each step
    most_rad = MAX_TURN_RAD_S * step_s
    behind_rad = np.zeros(yaw_rad.shape)
    if np.abs(_wrapped_rad(np.diff(yaw_rad, axis=0))).max() <= most_rad:
        return behind_rad[: 1 - window]  # no turn is quicker, as of most paths
    held_rad = yaw_rad[0]
    for step, wanted_rad in enumerate(yaw_rad):
        held_rad = held_rad + np.clip(_wrapped_rad(wanted_rad - held_rad), -most_rad, most_rad)
        behind_rad[step] = np.abs(_wrapped_rad(wanted_rad - held_rad))
    windows = np.lib.stride_tricks.sliding_window_view(behind_rad, window, axis=0)
    return np.asarray(windows.min(-1))


def _wrapped_rad(angle_rad: Array) -> Array:
    """Return angles between -pi and pi."""
    return np.asarray((angle_rad + math.pi) % (2.0 * math.pi) - math.pi)


def _tilt_deg(fleet: FleetConfig, flown: SampledPaths) -> Array:
    """Return the tilt (T, N) that the paths need, with the drag."""
    drag_1_s = np.array([fleet.vehicles[name].drag_1_s for name in flown.names])[:, None]
    push_m_s2 = flown.values[2, :, :, :3] + drag_1_s * flown.values[1, :, :, :3]

    sideways_m_s2 = np.hypot(push_m_s2[..., 0], push_m_s2[..., 1])
    upwards_m_s2 = GRAVITY_M_S2 + push_m_s2[..., 2]
    return np.asarray(np.degrees(np.arctan2(sideways_m_s2, upwards_m_s2)))


def _fence_and_height_findings(
    fleet: FleetConfig, flown: SampledPaths, where: str
) -> list[Finding]:
    """Return the findings about the distance to the fence and the height above the ground."""
    fence = fleet.fleet.geofence_m
    positions, _, _ = flown.values
    x = positions[..., 0]
    y = positions[..., 1]
    z = positions[..., 2]
    low_x, high_x = fence.x
    low_y, high_y = fence.y
    _, top = fence.z
    to_box_m = np.minimum.reduce([x - low_x, high_x - x, y - low_y, high_y - y, top - z])
    to_fence_m = np.minimum(to_box_m, clearances_m(flight_space_of(fleet).areas, positions))
    height_m = z - touchable_ground_at_m(fleet, x, y)
    least_m = max([LOWEST_M, *(least_height_m(fleet.vehicles[name]) for name in flown.names)])
    fence_room_m = _FENCE_ROOM_M
    if fleet.law.built_in != "off":
        fence_room_m = max(fence_room_m, fleet.law.fence_margin_m)

    findings = []
    for noun, values, bound in (
        ("room to the fence", to_fence_m, fence_room_m),
        ("height", height_m, least_m),
    ):
        step, index = np.unravel_index(values.argmin(), values.shape)
        findings.append(
            at_least(
                name=f"path {noun}",
                where=where,
                value=float(values[step, index]),
                bound=bound,
                unit="m",
                sentence=f"{capitalised(where)}: on {flown.names[index]}'s path {noun} is "
                f"<value> at {flown.times_s[step]:.1f} s; <relation> <bound> is needed",
                remedy="Move the path, or the fence of the fleet file.",
            )
        )
    return findings


def obstacle_clearances_m(fleet: FleetConfig, positions_enu_m: Array) -> Array:
    """Return the distance [m] of each position to the nearest obstacle's outline; negative inside.

    Args:
        fleet: the fleet file, with at least one obstacle.
        positions_enu_m: positions (..., 3).
    """
    to_obstacle_m = np.full(positions_enu_m.shape[:-1], np.inf)
    for obstacle in fleet.obstacles:
        circle = obstacle.circle or Circle(center_enu_m=(0.0, 0.0), radius_m=0.0)
        outline = Area(
            name=obstacle.name,
            keeps_in=False,
            corners_enu_m=obstacle.polygon_enu_m or (),
            center_enu_m=circle.center_enu_m,
            radius_m=circle.radius_m,
            low_m=-math.inf,
            high_m=math.inf,
            buffer_m=0.0,
        )
        to_obstacle_m = np.minimum(to_obstacle_m, rooms_m(outline, positions_enu_m))
    return to_obstacle_m


def _obstacle_finding(fleet: FleetConfig, flown: SampledPaths, where: str) -> Finding:
    """Return the finding about the smallest distance of a path to an obstacle.

    It refuses no path, because the law leads vehicles around thin obstacles.
    """
    to_obstacle_m = obstacle_clearances_m(fleet, flown.values[0, :, :, :3])
    step, index = np.unravel_index(to_obstacle_m.argmin(), to_obstacle_m.shape)
    return at_least(
        name="path obstacles",
        where=where,
        value=float(to_obstacle_m[step, index]),
        bound=0.5 * fleet.fleet.body_diameter_m + fleet.law.obstacle_margin_m,
        unit="m",
        sentence=f"{capitalised(where)}: {flown.names[index]}'s path is <value> from an obstacle "
        f"at {flown.times_s[step]:.1f} s; half a body and law.obstacle_margin_m require "
        "<relation> <bound>",
        remedy="Lead the path around the obstacle: the law keeps the vehicle away from it.",
        refuse_below=-math.inf,
    )


def _spacing_finding(
    fleet: FleetConfig, flown: SampledPaths, where: str, accuracy: Accuracy
) -> Finding:
    """Return the finding about the smallest distance of all pairs."""
    least_m = path_spacing_m(fleet, accuracy)
    height_share = height_share_of(fleet, accuracy)
    above = above_words(least_m, height_share)
    pairs = closest_pairs(flown, least_m, height_share)
    listed = listed_words([pair_words(pair) for pair in pairs])

    if above:
        how = above
        remedy = "Move these paths apart, in height or beside each other."
    else:
        how = ", horizontally at any height"
        remedy = (
            "Move these paths apart: there is no vertical separation, vehicles do not fly above "
            "each other."
        )
    return at_least(
        name="path spacing",
        where=where,
        value=pairs[0].distance_m,
        bound=least_m,
        unit="m",
        sentence=f"{capitalised(where)}: the paths come to <value> ({listed}); the law "
        f"'{fleet.law.name}' needs, with estimates as accurate as '{accuracy.name}', <relation> "
        f"<bound>{how}",
        remedy=remedy,
    )


def refusals(findings: Sequence[Finding]) -> list[str]:
    """Return the sentences of the findings that refuse the flight, the worst first."""
    refused = [finding for finding in findings if finding.status == "refused"]
    if not refused:
        return []

    first = worst(refused)
    others = [finding for finding in refused if finding is not first]
    return [finding.sentence for finding in (first, *others)]
