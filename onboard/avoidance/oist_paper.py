"""The paper's law for one moving obstacle, equations (5) to (22), with the turn direction of (8) or (9).

Everything is per unit of mass: ``F / m`` instead of F, so that M_o is twice a scaled rotation and m cancels. Planar:
only x and y are used. Positions, velocities and accelerations are in fleet ENU; the orthoradial velocity of (6) is
positive when the vehicle turns counter-clockwise about the obstacle as seen from above.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.types import Array, BoolArray


@dataclass(frozen=True, slots=True)
class PaperLawParams:
    """Tuning of the paper: kappa_1..4 [1/s], v_perp [m/s], d_inf [m]; turn_sign +1 for (8), -1 for (9)."""

    kappa_1_1_s: float = 2.0
    kappa_2_1_s: float = 2.0
    kappa_3_1_s: float = 1.5
    kappa_4_1_s: float = 1.5
    v_perp_m_s: float = 0.1
    d_inf_m: float = 0.8
    turn_sign: float = 1.0


@dataclass(frozen=True, slots=True)
class PaperLawResult:
    """thrust_xy (..., 2) [m/s^2]; is_changed (...) when a saturation acts; is_usable (...) unless M_o is singular."""

    thrust_xy_m_s2: Array
    is_changed: BoolArray
    is_usable: BoolArray


def saturate_thrust(
    position_m: Array,
    velocity_m_s: Array,
    thrust_m_s2: Array,
    obstacle_position_m: Array,
    obstacle_velocity_m_s: Array,
    obstacle_acceleration_m_s2: Array,
    *,
    params: PaperLawParams,
) -> PaperLawResult:
    """Saturated horizontal thrust (22).

    Implements: (5)-(22). (9) is (8) for the mirrored orthoradial velocity ``-phi_perp``.

    Args:
        position_m, velocity_m_s, thrust_m_s2: own horizontal state and F_d / m (..., 2).
        obstacle_position_m, obstacle_velocity_m_s, obstacle_acceleration_m_s2: (..., 2).
    Returns:
        Thrust (..., 2). Where the vehicles coincide M_o has no inverse (11): the thrust is unchanged and
        ``is_usable`` False.
    Properties: rotation- and translation-equivariant; homogeneous; idempotent.
    """
    p = params
    e = position_m - obstacle_position_m
    w = velocity_m_s - obstacle_velocity_m_s
    d_o2 = np.einsum("...c,...c->...", e, e)  # (5)
    d_o2_rate = 2.0 * np.einsum("...c,...c->...", e, w)
    phi_perp = p.turn_sign * _cross(e, velocity_m_s)  # (6)
    d_1 = 2.0 * np.einsum("...c,...c->...", w, w) - 2.0 * np.einsum(
        "...c,...c->...", e, obstacle_acceleration_m_s2
    )  # (13)
    d_2 = p.turn_sign * _cross(w, velocity_m_s)  # (14)
    outside = d_o2 - p.d_inf_m**2
    h_1 = -d_1 - (p.kappa_1_1_s + p.kappa_2_1_s) * d_o2_rate - p.kappa_1_1_s * p.kappa_2_1_s * outside  # (20)
    h_2 = (  # (21)
        -d_2
        - p.kappa_3_1_s * d_o2_rate
        - p.kappa_4_1_s * (phi_perp - p.d_inf_m * p.v_perp_m_s)
        - p.kappa_3_1_s * p.kappa_4_1_s * outside
    )
    u_1 = 2.0 * np.einsum("...c,...c->...", e, thrust_m_s2)  # (15)
    u_2 = p.turn_sign * _cross(e, thrust_m_s2)
    more_1 = np.maximum(0.0, h_1 - u_1)
    more_2 = np.maximum(0.0, h_2 - u_2)
    is_usable = (d_o2 > 1e-12) & np.isfinite(h_1) & np.isfinite(h_2)
    inverse = np.where(is_usable, 1.0, 0.0) / np.where(is_usable, d_o2, 1.0)
    more_1 = np.where(is_usable, more_1, 0.0)
    more_2 = np.where(is_usable, more_2, 0.0)
    # M_o^-1 = M_o^T / (4 d_o2): only what the saturations add is transformed back, so that inactive rows change no bit
    turned = np.stack([-e[..., 1], e[..., 0]], axis=-1)
    added = (0.5 * more_1[..., None] * e + p.turn_sign * more_2[..., None] * turned) * inverse[..., None]
    return PaperLawResult(thrust_m_s2 + added, (more_1 > 0.0) | (more_2 > 0.0), is_usable)


def _cross(a: Array, b: Array) -> Array:
    """z component of the cross product of two horizontal vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
