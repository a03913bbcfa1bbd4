"""Differences between vehicles of one type: no two fly alike, and no flight repeats another.

A fleet file describes a type. The vehicles that are built after it differ a little in thrust, drag
and quickness, and their attitude and thrust wander a little in flight. Without this, every seed
flies almost the same flight, and goals are met closer than real PX4s meet them.

The sizes are those that were measured on PX4's SIH quadrotor over many flights, where all instances
should be alike: thrust to hover .487 to .493, drag .96 to 1.16 /s, dead time of the acceleration 47
to 59 ms, natural frequency 11.0 to 12.0 rad/s, damping .57 to .62.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sitl.physics.vehicle import VehicleProfile

# largest relative difference from the type, half of the range that was measured
_HOVER_THRUST = 0.006
_DRAG = 0.10
_ATTITUDE_DELAY = 0.12
_ATTITUDE_WN = 0.045
_ATTITUDE_ZETA = 0.04

# Wander in flight, for types that name none: chosen so that the paper's three meet their goals as
# real PX4s do, with .032 m in the median of the worst (.022 to .055, 20 seeds; real .027 to .048).
_SIDEWAYS_STD_M_S2 = 0.04
_THRUST_STD_FRAC = 0.004


def one_of_type(
    profile: VehicleProfile, *, seed: int, index: int, scale: float = 1.0
) -> VehicleProfile:
    """Return the profile of one vehicle of a type.

    Args:
        profile: profile of the type.
        seed: seed of everything random.
        index: index of the vehicle in its fleet; another one differs in another way.
        scale: scale of all differences; 0 returns the type itself.
    """
    rng = np.random.default_rng([seed, 6, index])
    hover, drag, delay, wn, zeta = (scale * rng.uniform(-1.0, 1.0, 5)).tolist()
    return replace(
        profile,
        hover_thrust_frac=profile.hover_thrust_frac * (1.0 + _HOVER_THRUST * hover),
        drag_1_s=profile.drag_1_s * (1.0 + _DRAG * drag),
        attitude_delay_s=profile.attitude_delay_s * (1.0 + _ATTITUDE_DELAY * delay),
        attitude_wn_rad_s=profile.attitude_wn_rad_s * (1.0 + _ATTITUDE_WN * wn),
        attitude_zeta=profile.attitude_zeta * (1.0 + _ATTITUDE_ZETA * zeta),
        gust_std_m_s2=max(profile.gust_std_m_s2, scale * _SIDEWAYS_STD_M_S2),
        thrust_noise_frac=max(profile.thrust_noise_frac, scale * _THRUST_STD_FRAC),
    )
