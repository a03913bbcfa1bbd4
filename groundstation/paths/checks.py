"""Checks of paths that vehicles fly together: findings with vehicle, time, value and bound. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array
from onboard.config.fleet import FleetConfig, above_words, parking_distance_m, parking_height_share
from onboard.control.path import Path, sampled
from onboard.feasibility.finding import Finding, at_least, at_most, worst
from onboard.types import GRAVITY_M_S2

LOWEST_M = 0.3  # of a path, above the fence's floor
STEP_S = 0.05
# by which the parking distance exceeds the one at which the law begins to act
_PARKING_MORE_M = 0.10
_ENDS_M_S = 0.05
_BLOCK = 400  # times of which all pairs are looked at together
_LISTED = 12


class SampledPaths(NamedTuple):
    """Motion of all vehicles at common times; after its end each stays where its path ends."""

    names: tuple[str, ...]
    times_s: Array  # (T,)
    values: Array  # (3, T, N, 4)


class Closest(NamedTuple):
    """Smallest horizontal distance of one pair, between the samples as well."""

    distance_m: float
    first: str
    second: str
    time_s: float
    height_m: float  # of the one above the other then


class Limits(NamedTuple):
    """What the slowest of some vehicles can fly."""

    max_speed_m_s: float
    max_acceleration_m_s2: float
    max_tilt_deg: float
    drag_1_s: float


def limits_of(fleet: FleetConfig, names: Sequence[str]) -> Limits:
    """Return the limits that all of these vehicles can keep."""
    flying = [fleet.vehicles[name] for name in names]
    return Limits(
        min(one.max_speed_m_s for one in flying),
        min(one.max_acceleration_m_s2 for one in flying),
        min(one.max_tilt_deg for one in flying),
        max(one.drag_1_s for one in flying),
    )


def sample(paths: Mapping[str, Path], step_s: float = STEP_S) -> SampledPaths:
    """Return the motion of all paths from the first one's begin to the last one's end."""
    longest_s = max(path.duration_s for path in paths.values())
    times_s = np.linspace(0.0, longest_s, max(2, math.ceil(longest_s / step_s) + 1))
    values = np.stack([sampled(path, times_s) for path in paths.values()], axis=2)
    return SampledPaths(tuple(paths), times_s, values)


def bound_m(fleet: FleetConfig) -> float:
    """Return the distance that paths keep: where the law begins to act, or the promise without it."""
    if fleet.law.built_in != "covey":
        return fleet.fleet.safety_distance_m
    return parking_distance_m(fleet) - _PARKING_MORE_M


def closest_pairs(flown: SampledPaths, below_m: float, height_share: float = 0.0) -> list[Closest]:
    """Return each pair that comes nearer than a separation, once, the nearest first; the nearest of
    all in any case.

    Args:
        flown: the paths.
        below_m: the separation [m].
        height_share: what a metre of height counts.
    """
    first, second = np.triu_indices(len(flown.names), 1)
    best = np.full(len(first), np.inf)
    when = np.zeros(len(first), np.int64)
    xy, z = flown.values[0, :, :, :2], flown.values[0, :, :, 2]
    for begin in range(0, len(xy) - 1, _BLOCK):
        gap = xy[begin : begin + _BLOCK + 1][:, first] - xy[begin : begin + _BLOCK + 1][:, second]
        step = np.diff(gap, axis=0)
        along = -(gap[:-1] * step).sum(-1) / np.maximum((step**2).sum(-1), 1e-12)
        near = gap[:-1] + np.clip(along, 0.0, 1.0)[..., None] * step
        distance = np.sqrt((near**2).sum(-1))
        if height_share > 0.0:  # at the smallest height difference of each step: never too much
            height = (
                z[begin : begin + _BLOCK + 1][:, first] - z[begin : begin + _BLOCK + 1][:, second]
            )
            least = np.where(
                height[:-1] * height[1:] > 0.0, np.minimum(abs(height[:-1]), abs(height[1:])), 0.0
            )
            distance = np.maximum(distance, height_share * least)
        index = distance.argmin(0)
        smallest = distance[index, np.arange(len(first))]
        is_new = smallest < best
        best[is_new], when[is_new] = smallest[is_new], begin + index[is_new]
    return [
        Closest(
            float(best[k]),
            flown.names[first[k]],
            flown.names[second[k]],
            float(flown.times_s[when[k]]),
            abs(float(z[when[k], first[k]] - z[when[k], second[k]])),
        )
        for k in np.argsort(best)
        if best[k] < below_m or k == best.argmin()
    ]


def needed_slowing(flown: SampledPaths, limits: Limits) -> tuple[float, str]:
    """Return how many times as long paths must take, and the worst reason in words; at most 1:
    none.
    """
    speed, push = (np.sqrt((flown.values[k, :, :, :3] ** 2).sum(-1)) for k in (1, 2))
    sideways = np.hypot(flown.values[2, ..., 0], flown.values[2, ..., 1])
    drag = limits.drag_1_s * np.hypot(flown.values[1, ..., 0], flown.values[1, ..., 1])
    steepest = 0.8 * GRAVITY_M_S2 * math.tan(math.radians(limits.max_tilt_deg))
    needs = {
        "speed": (speed, limits.max_speed_m_s, "m/s", 1.0),
        "acceleration": (push, limits.max_acceleration_m_s2, "m/s^2", 0.5),
        "tilt, as acceleration with drag,": (sideways + drag, steepest, "m/s^2", 1.0),
    }
    noun = max(needs, key=lambda key: (needs[key][0].max() / needs[key][1]) ** needs[key][3])
    value, bound, unit, power = needs[noun]
    step, index = np.unravel_index(value.argmax(), value.shape)
    name, time_s = flown.names[index], flown.times_s[step]
    words = f"{name}'s {noun} was {value.max():.2f} {unit} at {time_s:.1f} s, {bound:g} is the most"
    return float(value.max() / bound) ** power, words


def pair_words(one: Closest) -> str:
    """Return a pair in words."""
    above = f", one {one.height_m:.1f} m above the other" if one.height_m > one.distance_m else ""
    return f"{one.first} and {one.second} {one.distance_m:.2f} m at {one.time_s:.1f} s{above}"


def listed_words(words: Sequence[str]) -> str:
    """Return the first of many, and how many more there are."""
    more = f"; {len(words) - _LISTED} more" if len(words) > _LISTED else ""
    return "; ".join(words[:_LISTED]) + more


def path_findings(fleet: FleetConfig, paths: Mapping[str, Path], where: str) -> list[Finding]:
    """Judge paths that begin together.

    Args:
        fleet: the fleet file.
        paths: of its vehicles.
        where: of the mission, for the sentences.

    Returns:
        One finding each for speed, acceleration, tilt, rest at the ends, fence, height and spacing.
    """
    flown = sample(paths)
    speed, push = (np.sqrt((flown.values[k, :, :, :3] ** 2).sum(-1)) for k in (1, 2))
    findings = [
        _most(
            fleet,
            flown,
            speed,
            "speed",
            "m/s",
            lambda name: fleet.vehicles[name].max_speed_m_s,
            where,
        ),
        _most(
            fleet,
            flown,
            push,
            "acceleration",
            "m/s^2",
            lambda n: fleet.vehicles[n].max_acceleration_m_s2,
            where,
        ),
        _most(
            fleet,
            flown,
            _tilt_deg(fleet, flown),
            "tilt",
            "deg",
            lambda n: fleet.vehicles[n].max_tilt_deg,
            where,
        ),
        _most(fleet, flown, speed[[0, -1]], "speed at the ends", "m/s", lambda _: _ENDS_M_S, where),
    ]
    findings += _room(fleet, flown, where)
    if len(paths) > 1:
        findings.append(_spacing(fleet, flown, where))
    return findings


def _most(
    fleet: FleetConfig,
    flown: SampledPaths,
    value: Array,
    noun: str,
    unit: str,
    bound: Callable[[str], float],
    where: str,
) -> Finding:
    """Judge the vehicle whose value (T, N) exceeds its bound most."""
    step, index = np.unravel_index(
        (value / np.array([bound(name) for name in flown.names])).argmax(), value.shape
    )
    name = flown.names[index]
    time_s = flown.times_s[-1 if len(value) == 2 and step else step]
    return at_most(
        f"path {noun}, {where}",
        float(value[step, index]),
        bound(name),
        unit,
        f"{where[0].upper()}{where[1:]}: on {name}'s path {noun} is {{value}} at {time_s:.1f} s; {{relation}} "
        "{bound} can be flown",
        "Slow the path, or raise the vehicle's limit: 'covey import' slows a show by itself.",
        refuse_above=1.01 * bound(name),
        warn_above=1.01 * bound(name),
    )


def _tilt_deg(fleet: FleetConfig, flown: SampledPaths) -> Array:
    """Return the tilt (T, N) that the path takes, its drag included."""
    drag = np.array([fleet.vehicles[name].drag_1_s for name in flown.names])[:, None]
    push = flown.values[2, :, :, :3] + drag * flown.values[1, :, :, :3]
    return np.asarray(
        np.degrees(np.arctan2(np.hypot(push[..., 0], push[..., 1]), GRAVITY_M_S2 + push[..., 2]))
    )


def _room(fleet: FleetConfig, flown: SampledPaths, where: str) -> list[Finding]:
    fence, p = fleet.fleet.geofence_m, flown.values[0]
    sides = (
        p[..., 0] - fence.x[0],
        fence.x[1] - p[..., 0],
        p[..., 1] - fence.y[0],
        fence.y[1] - p[..., 1],
    )
    room = np.minimum.reduce([*sides, fence.z[1] - p[..., 2]])
    out = []
    for noun, value, bound in (
        ("room to the fence", room, 0.15),
        ("height", p[..., 2] - fence.z[0], LOWEST_M),
    ):
        step, index = np.unravel_index(value.argmin(), value.shape)
        out.append(
            at_least(
                f"path {noun}, {where}",
                float(value[step, index]),
                bound,
                "m",
                f"{where[0].upper()}{where[1:]}: on {flown.names[index]}'s path {noun} is {{value}} at "
                f"{flown.times_s[step]:.1f} s; {{relation}} {{bound}} is needed",
                "Move the path, or the fence of the fleet file.",
            )
        )
    return out


def _spacing(fleet: FleetConfig, flown: SampledPaths, where: str) -> Finding:
    least_m = bound_m(fleet)
    above = above_words(fleet)
    pairs = closest_pairs(flown, least_m, parking_height_share(fleet))
    listed = listed_words([pair_words(one) for one in pairs])
    return at_least(
        f"path spacing, {where}",
        pairs[0].distance_m,
        least_m,
        "m",
        f"{where[0].upper()}{where[1:]}: the paths come to {{value}} ({listed}); the law '{fleet.law.name}' needs "
        f"{{relation}} {{bound}}{above or ', horizontally at any height'}",
        "Move these paths apart, in height or beside each other."
        if above
        else "Move these paths apart: there is no vertical separation, vehicles do not fly above each other.",
    )


def refusals(findings: Sequence[Finding]) -> list[str]:
    """Return the sentences of what refuses the flight, the worst first."""
    refused = [finding for finding in findings if finding.status == "refused"]
    return (
        [worst(refused).sentence, *(f.sentence for f in refused if f is not worst(refused))]
        if refused
        else []
    )
