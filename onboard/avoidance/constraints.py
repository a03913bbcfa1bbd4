"""Rows of the law: half-planes ``n.u >= b`` of the horizontal acceleration, normals of about unit length, b in m/s^2.

Distance rows are (17) for a pair or for something that stands still, rotation rows are (18), the fence is (17) for a
straight wall, and the speed row keeps avoiding vehicles from racing. e and w are own minus other position and velocity
(..., K, 2), both predicted to when the command acts. ``kernels.py`` has the same formulas for one vehicle at a time.
"""

from __future__ import annotations

import numpy as np

from onboard.avoidance.params import DIRECTION, LawNumbers
from onboard.config.obstacles import Capsule
from onboard.types import Array, BoolArray

MAX_OBSTACLES = 6  # the nearest ones count
SPEED_GAIN_1_S = 4.0
LARGEST_MARGIN_M = 5.0
COINCIDENT_M = 1e-6
SETTLED_M_S = 0.1  # who wants to go no faster than this is no part of a crowd


def design_distance(
    own_std: tuple[Array, Array], their_std: tuple[Array, Array], is_cooperative: BoolArray, n: LawNumbers
) -> Array:
    """Distance d (..., K) [m] kept from each neighbour: fixed, or more where the estimates are worse than a mocap's.

    own_std, their_std: of position [m] and velocity [m/s] per axis, (...) and (..., K); what is not finite counts as 0.
    """
    margin = np.full(is_cooperative.shape, n.margin_m)
    if n.sigma_position > 0.0:
        variance = np.zeros(is_cooperative.shape)
        for scale, own, theirs in zip((n.sigma_position, n.sigma_velocity_s), own_std, their_std, strict=True):
            variance += scale * scale * (_known(own)[..., None] ** 2 + _known(theirs) ** 2)
        margin = np.minimum(np.maximum(margin, n.margin_floor_m + np.sqrt(variance)), LARGEST_MARGIN_M)
    return np.asarray(n.safety_distance_m + margin + np.where(is_cooperative, 0.0, n.uncooperative_margin_m))


def distance_rows(
    e: Array, w: Array, d: Array, neighbour_command: Array, is_full: BoolArray, *, n: LawNumbers
) -> tuple[Array, Array]:
    """Normals (..., K, 2), bounds (..., K). (17) asks the pair for ``need``; responsibility says who gives how much.

    full: all of it, and what the other's command takes away (the paper). half: half. shortfall: half, plus
    ``shortfall_gain`` times what the other's command fails to deliver. DEVIATION D2.
    """
    closing, speed_2, distance_2 = _dot(e, w), _dot(w, w), _dot(e, e)
    k_1, k_2 = n.kappa_1_1_s, n.kappa_2_1_s
    need = -speed_2 - (k_1 + k_2) * closing - 0.5 * k_1 * k_2 * (distance_2 - d * d)
    pulled = _dot(e, neighbour_command)
    shared = 0.5 * need + n.shortfall_gain * np.maximum(0.0, 0.5 * need + pulled)
    return e / d[..., None], np.where(is_full, need + pulled, shared) / d


def turn_direction(e: Array, wish: Array, d: Array, is_crowded: BoolArray, *, n: LawNumbers) -> Array:
    """+1 counter-clockwise or -1 (..., K), by policy.

    fixed: always +1. pair: as ``wish``, here the relative velocity, already turns the pair, which both see alike; +1 if
    undecided. crowd: a crowded pair always +1, so that all of a crowd go round the same way. intent: the same with the
    relative velocity that both would like, which does not keep a circling pair circling. DEVIATION D4.
    """
    if n.direction == DIRECTION["fixed"]:
        return np.ones(d.shape)
    spin = e[..., 0] * wish[..., 1] - e[..., 1] * wish[..., 0]
    is_left = spin < -0.25 * d * np.maximum(np.sqrt(_dot(wish, wish)), 0.1)
    return np.where(is_left & ~(is_crowded & (n.direction >= DIRECTION["crowd"])), -1.0, 1.0)


def rotation_rows(
    e: Array,
    w: Array,
    wish: Array,
    own_velocity: Array,
    d: Array,
    is_crowded: BoolArray,
    is_full: BoolArray,
    *,
    n: LawNumbers,
) -> tuple[Array, Array]:
    """Soft rows that turn the pair about each other: in relative form with half a share each. DEVIATION D4.

    A vehicle that has to do everything turns alone, relative to the other; under the paper's full responsibility by
    its absolute velocity, as (8) and (18) have it.
    """
    sign = turn_direction(e, wish, d, is_crowded, n=n)
    g = own_velocity if n.is_full else w
    spin = sign * (e[..., 0] * g[..., 1] - e[..., 1] * g[..., 0])
    drift = sign * (w[..., 0] * g[..., 1] - w[..., 1] * g[..., 0])
    outside = _dot(e, e) - d * d
    is_fast = is_crowded & (n.direction >= DIRECTION["crowd"])
    v_perp = np.where(is_fast, n.v_perp_crowd_m_s, n.v_perp_m_s)
    k_3, k_4 = n.kappa_3_1_s, n.kappa_4_1_s
    braking = -2.0 * k_3 * _dot(e, w)
    alone = braking - k_4 * (spin - d * v_perp + k_3 * outside) - drift
    shared = 0.5 * (braking - k_4 * (spin - 2.0 * d * v_perp + k_3 * outside))
    turned = np.stack([-e[..., 1], e[..., 0]], axis=-1) * (sign / d)[..., None]
    return turned, np.where(is_full, alone, shared) / d


def obstacle_rows(
    position: Array, velocity: Array, wish: Array, capsules: tuple[Capsule, ...], *, n: LawNumbers
) -> tuple[Array, Array, Array, Array]:
    """Distance and rotation rows (..., O, 2), (..., O) of what stands still, the nearest O <= 6 of the capsules.

    (17), (18) with the nearest point of the capsule's segment as the obstacle. Beside the segment that point moves
    along with the vehicle, so that only the velocity towards the wall counts.
    """
    c = np.array(capsules, dtype=np.float64).reshape(-1, 5)
    from_begin = position[..., None, :] - c[:, 0:2]
    along = c[:, 2:4] - c[:, 0:2]
    length_2 = _dot(along, along)
    place = _dot(from_begin, along) / np.where(length_2 > 0.0, length_2, 1.0)
    share = np.minimum(np.maximum(place, 0.0), 1.0)
    e = from_begin - share[..., None] * along
    size = np.sqrt(_dot(e, e))
    nearest = np.argsort(size - c[:, 4], axis=-1, kind="stable")[..., :MAX_OBSTACLES]
    is_beside = np.take_along_axis((place > 0.0) & (place < 1.0), nearest, -1)
    e = np.take_along_axis(e, nearest[..., None], -2)
    w = np.broadcast_to(velocity[..., None, :], e.shape)
    e = np.where((_dot(e, e) < COINCIDENT_M**2)[..., None], way_out(w), e)
    d = c[:, 4][nearest] + n.clearance_m
    closing, speed_2, distance_2 = _dot(e, w), _dot(w, w), _dot(e, e)
    k_1, k_2 = n.static_kappa_1_1_s, n.kappa_2_1_s
    towards = np.where(is_beside, closing * closing / distance_2, speed_2)
    need = -towards - (k_1 + k_2) * closing - 0.5 * k_1 * k_2 * (distance_2 - d * d)
    sign = turn_direction(e, np.broadcast_to(wish[..., None, :], e.shape), d, np.zeros(d.shape, bool), n=n)
    spin = sign * (e[..., 0] * w[..., 1] - e[..., 1] * w[..., 0])
    drift = np.where(is_beside, closing * spin / distance_2, 0.0)
    k_3, k_4 = n.kappa_3_1_s, n.kappa_4_1_s
    turn = -2.0 * k_3 * closing - k_4 * (spin - d * n.v_perp_m_s + k_3 * (distance_2 - d * d)) - drift
    turned = np.stack([-e[..., 1], e[..., 0]], axis=-1) * (sign / d)[..., None]
    return e / d[..., None], need / d, turned, turn / d


def fence_rows(position: Array, velocity: Array, *, n: LawNumbers) -> tuple[Array, Array]:
    """Rows (..., 4, 2), (..., 4) of the walls: (17) for the distance from a line; an open side has a bound of -inf."""
    k_1, k_2 = n.static_kappa_1_1_s, n.kappa_2_1_s
    low = np.array([n.fence_low_x_m, n.fence_low_y_m])
    high = np.array([n.fence_high_x_m, n.fence_high_y_m])
    inward = np.concatenate([velocity, -velocity], axis=-1)
    gap = np.concatenate([position - low, high - position], axis=-1)
    normals = np.broadcast_to(np.concatenate([np.eye(2), -np.eye(2)]), (*gap.shape, 2))
    return normals, -(k_1 + k_2) * inward - k_1 * k_2 * gap


def speed_row(velocity: Array, *, n: LawNumbers) -> tuple[Array, Array, BoolArray]:
    """Row (..., 1, 2), (..., 1) that lets the speed approach its limit only slowly, and whether there is a speed."""
    speed = np.sqrt(_dot(velocity, velocity))
    is_moving = speed > 1e-6
    normal = -velocity / np.where(is_moving, speed, 1.0)[..., None]
    return normal[..., None, :], (-SPEED_GAIN_1_S * (n.top_speed_m_s - speed))[..., None], is_moving[..., None]


def way_out(w: Array) -> Array:
    """Direction (..., K, 2) of a tiny separation where there is none: onwards along the relative velocity."""
    speed = np.sqrt(_dot(w, w))[..., None]
    is_moving = speed > 1e-6
    return COINCIDENT_M * np.where(is_moving, w / np.where(is_moving, speed, 1.0), np.array([1.0, 0.0]))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1])


def _known(std: Array) -> Array:
    return np.where(np.isfinite(std), np.minimum(np.abs(np.where(np.isfinite(std), std, 0.0)), 1e3), 0.0)
