"""Other people's avoidance methods behind one signature, each with its own small grid of values to
tune.

Every one gets what Covey's law gets: states predicted over the lag, the same baseline, design
distance and limits. Each has two values of its own and six combinations to choose from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import daqp
import numpy as np
import pyrvo

from onboard.avoidance.half_planes import HalfPlane
from onboard.vectors import Vec2
from tests.bench.peers.encounter import (
    Array,
    Encounter,
    Step,
    into_disc,
    keep_right,
    preferred_velocity,
)
from tests.onboard.avoidance.law_cases import nearest_thrust

NEIGHBOURS = 12  # the nearest so many count, for every method
_OWN_RADIUS_M = 0.4  # of a design distance; the neighbour is drawn as large as the rest of it


def orca(encounter: Encounter, values: Mapping[str, float]) -> Array:
    """Optimal reciprocal collision avoidance by the RVO2 library, a simulator for each vehicle and
    tick.

    van den Berg, Guy, Lin, Manocha: Reciprocal n-body collision avoidance, 2011. ``horizon_s``:
    collisions within this time are avoided. ``gain_1_s``: the velocity found becomes an
    acceleration.
    """
    encounter = keep_right(encounter)
    asked = preferred_velocity(encounter, values["gain_1_s"])
    found = asked.copy()
    nearby = encounter.is_on & (encounter.distance_m < encounter.d_m + 2.5 * values["horizon_s"])
    for m in np.flatnonzero(nearby.any(-1)):
        near = np.flatnonzero(nearby[m])
        simulator = _simulator(len(near), values["horizon_s"], encounter.speed_m_s)
        simulator.set_agent_velocity(0, tuple(encounter.velocity_m_s[m].tolist()))
        simulator.set_agent_pref_velocity(0, tuple(asked[m].tolist()))
        simulator.set_agent_position(0, (0.0, 0.0))
        away = (-encounter.gap_m[m, near]).tolist()
        speeds = (encounter.velocity_m_s[m] - encounter.closing_m_s[m, near]).tolist()
        radii = (encounter.d_m[m, near] - _OWN_RADIUS_M).tolist()
        for k in range(len(near)):
            simulator.set_agent_radius(k + 1, radii[k])
            simulator.set_agent_position(k + 1, tuple(away[k]))
            simulator.set_agent_velocity(k + 1, tuple(speeds[k]))
        simulator.do_step()
        found[m] = simulator.get_agent_velocity(0).to_tuple()
    return encounter.wanted_m_s2 + values["gain_1_s"] * (found - asked)


@lru_cache(maxsize=256)
def _simulator(neighbours: int, horizon_s: float, speed_m_s: float) -> Any:
    simulator = pyrvo.RVOSimulator(
        0.02, 100.0, NEIGHBOURS, horizon_s, horizon_s, _OWN_RADIUS_M, speed_m_s
    )
    for k in range(neighbours + 1):
        simulator.add_agent((float(k), 0.0))
        if k:
            simulator.set_agent_max_neighbors(k, 0)  # only the first agent's answer is wanted
    return simulator


def cells(encounter: Encounter, values: Mapping[str, float]) -> Array:
    """Buffered Voronoi cells: head for the point of the own cell nearest to where the baseline
    wants to be.

    Zhou, Wang, Bandyopadhyay, Schwager: Fast, on-line collision avoidance for dynamic vehicles
    using buffered Voronoi cells, 2017. ``horizon_s``: how far ahead that point lies. ``gain_1_s``:
    velocity to acceleration.
    """
    encounter = keep_right(encounter)
    asked = preferred_velocity(encounter, values["gain_1_s"])
    target = values["horizon_s"] * asked
    distance = encounter.distance_m
    normals = encounter.gap_m / distance[..., None]
    bounds = 0.5 * (encounter.d_m - distance)
    found = np.stack(
        [in_cell(target[m], normals[m, on], bounds[m, on]) for m, on in enumerate(encounter.is_on)]
    )
    return encounter.wanted_m_s2 + values["gain_1_s"] * (found - target) / values["horizon_s"]


def in_cell(point: Array, normals: Array, bounds: Array, reach: float = 100.0) -> Array:
    """The point (2,) nearest to ``point`` with ``normals.u >= bounds``, within ``reach``; zero
    normals are no rows.
    """
    is_row = np.abs(normals).max(-1, initial=0.0) > 1e-12
    normals = normals[is_row]
    bounds = bounds[is_row]
    rows = [
        HalfPlane(Vec2(*normal), bound)
        for normal, bound in zip(normals.tolist(), bounds.tolist(), strict=True)
    ]
    return np.array(nearest_thrust(Vec2(*point.tolist()), rows, reach).point)


def certificate_rows(encounter: Encounter, values: Mapping[str, float]) -> tuple[Array, Array]:
    """Rows ``n.a >= b`` (M, K, 2), (M, K) of the pairwise safety barrier certificates, half a share
    each.

    Wang, Ames, Egerstedt: Safety barrier certificates for collisions-free multirobot systems, 2017.
    With the barrier ``h = sqrt(4 A (|e| - d)) + e.w / |e|`` (A: ``brake_m_s2`` of both) and ``h' >=
    -gamma h^3``.
    """
    brake = values["brake_m_s2"]
    gamma = values["gamma"]
    e = encounter.gap_m
    w = encounter.closing_m_s
    distance = encounter.distance_m
    unit = e / distance[..., None]
    radial = np.einsum("mkc,mkc->mk", unit, w)
    room = np.sqrt(4.0 * brake * np.maximum(distance - encounter.d_m, 0.005))
    barrier = room + radial
    turning = (np.einsum("mkc,mkc->mk", w, w) - radial**2) / distance
    bound = -gamma * barrier**3 - turning - 2.0 * brake * radial / room
    return unit, 0.5 * bound


def certificate(encounter: Encounter, values: Mapping[str, float]) -> Array:
    """The quadratic programme of the barrier certificates, solved by daqp; rows that cannot all
    hold are softened.
    """
    encounter = keep_right(encounter)
    normals, bounds = certificate_rows(encounter, values)
    out = encounter.wanted_m_s2.copy()
    lack = bounds - np.einsum("mkc,mc->mk", normals, out)
    for m in np.flatnonzero((encounter.is_on & (lack > 0.0)).any(-1)):
        near = encounter.is_on[m] & (bounds[m] > -2.0 * encounter.reach_m_s2[m])
        out[m] = least_change(
            out[m], normals[m, near], bounds[m, near], float(encounter.reach_m_s2[m])
        )
    return out


def robust_certificate(encounter: Encounter, values: Mapping[str, float]) -> Array:
    """Barrier certificates that hold whatever a neighbour has done since its message.

    The worst case of a bounded disturbance in the barrier, as in Jankovic: Robust control barrier
    functions for constrained stabilization of nonlinear systems, 2018. With ``change_m_s2`` more or
    less than it announced a neighbour is nearer by half of that times the age squared, and comes
    faster by it times the age.
    """
    change = values["change_m_s2"]
    age_s = encounter.age_s
    towards = encounter.gap_m / encounter.distance_m[..., None]
    worse = replace(
        encounter,
        d_m=encounter.d_m + 0.5 * change * age_s**2,
        closing_m_s=encounter.closing_m_s - (change * age_s)[..., None] * towards,
    )
    return certificate(worse, {"brake_m_s2": 2.0, "gamma": values["gamma"]})


def least_change(wanted: Array, normals: Array, bounds: Array, reach: float) -> Array:
    """The point (2,) of the box ``|u| <= reach`` nearest to ``wanted`` with ``normals.u >=
    bounds``, by daqp.
    """
    count = len(bounds)
    upper = np.concatenate([np.full(2, reach), np.full(count, 1e30)])
    lower = np.concatenate([np.full(2, -reach), bounds])
    hard = np.zeros(count + 2, dtype=np.int32)
    matrix = np.ascontiguousarray(normals)
    u, _, flag, _ = daqp.solve(np.eye(2), -wanted, matrix, upper, lower, hard)
    if flag < 1:
        hard[2:] = 8  # soft: the smallest sum of squared violations
        u, _, flag, _ = daqp.solve(np.eye(2), -wanted, matrix, upper, lower, hard)
    return np.asarray(u) if flag >= 1 else into_disc(wanted[None], np.array([reach]))[0]


def potential(encounter: Encounter, values: Mapping[str, float]) -> Array:
    """Artificial potential field: neighbours push, the more the nearer, and closing speed is
    damped.

    Khatib: Real-time obstacle avoidance for manipulators and mobile robots, 1986. ``push_m3_s2``:
    strength. ``range_m``: how far beyond the design distance it is felt.
    """
    encounter = keep_right(encounter)
    distance = encounter.distance_m
    rim = values["range_m"]
    room = np.maximum(distance - encounter.d_m, 0.05)
    force = np.where(room < rim, values["push_m3_s2"] * (1.0 / room - 1.0 / rim) / room**2, 0.0)
    unit = encounter.gap_m / distance[..., None]
    approach = np.minimum(0.0, np.einsum("mkc,mkc->mk", unit, encounter.closing_m_s))
    force = force - np.where(room < rim, 2.0 * approach, 0.0)
    pushed = encounter.wanted_m_s2 + np.einsum(
        "mk,mkc->mc", np.where(encounter.is_on, force, 0.0), unit
    )
    return into_disc(pushed, encounter.reach_m_s2)


@dataclass(frozen=True, slots=True)
class Method:
    """A method with the combinations of its own values that it may be tuned over, and the ones
    chosen.
    """

    title: str
    step: Step
    grid: Mapping[str, tuple[float, ...]]
    chosen: Mapping[str, float]


METHODS = {
    "orca": Method(
        "ORCA (RVO2)",
        orca,
        {"horizon_s": (1.0, 2.0, 4.0), "gain_1_s": (2.0, 4.0)},
        {"horizon_s": 4.0, "gain_1_s": 4.0},
    ),
    "cells": Method(
        "buffered Voronoi cells",
        cells,
        {"horizon_s": (0.5, 1.0, 2.0), "gain_1_s": (2.0, 4.0)},
        {"horizon_s": 0.5, "gain_1_s": 4.0},
    ),
    "certificate": Method(
        "barrier certificates (QP)",
        certificate,
        {"brake_m_s2": (0.5, 1.0, 2.0), "gamma": (1.0, 4.0)},
        {"brake_m_s2": 2.0, "gamma": 1.0},
    ),
    "robust_certificate": Method(
        "barrier certificates, robust to age",
        robust_certificate,
        {"change_m_s2": (0.5, 1.0, 2.0), "gamma": (1.0, 4.0)},
        {"change_m_s2": 1.0, "gamma": 4.0},  # best at 200 ms; without delay it is as the plain one
    ),
    "potential": Method(
        "potential field",
        potential,
        {"push_m3_s2": (0.02, 0.1, 0.5), "range_m": (0.5, 1.0)},
        {"push_m3_s2": 0.02, "range_m": 1.0},
    ),
}
