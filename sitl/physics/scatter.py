"""Differences between vehicles of one type, and between flights of one vehicle.

A fleet file describes a type. Vehicles of a type differ a little in thrust, drag and quickness, and
their attitude and thrust wander a little in flight. Without these differences the flights of all
seeds would be almost the same, and vehicles would meet their goals closer than real PX4s do.

The ranges were measured on PX4's SIH quadrotor over many flights, although all its instances should
be identical: thrust to hover .487 to .493, drag .96 to 1.16 /s, dead time of the acceleration 47 to
59 ms, natural frequency 11.0 to 12.0 rad/s, damping .57 to .62.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sitl.physics.random_streams import Stream
from sitl.physics.vehicle import VehicleProfile

# Largest relative differences from the type: half of the measured ranges.
_HOVER_THRUST_FRAC = 0.006
_DRAG_FRAC = 0.10
_ATTITUDE_DELAY_FRAC = 0.12
_ATTITUDE_WN_FRAC = 0.045
_ATTITUDE_ZETA_FRAC = 0.04

# Wander in flight of types whose profile sets less. With these values the paper's three vehicles
# meet their goals as closely as real PX4s: the median over 20 seeds of the largest distance is
# .032 m (.022 to .055 m), compared with .027 to .048 m for real ones.
_SIDEWAYS_STD_M_S2 = 0.04
_THRUST_STD_FRAC = 0.004


def one_of_type(
    profile: VehicleProfile, *, seed: int, index: int, scale: float = 1.0
) -> VehicleProfile:
    """Return the profile of one vehicle of a type.

    Args:
        profile: profile of the type.
        seed: seed of all random numbers.
        index: index of the vehicle in its fleet, which selects its differences.
        scale: scale of all differences; 0 returns the type itself.
    """
    rng = np.random.default_rng([seed, Stream.SCATTER, index])
    hover, drag, delay, wn, zeta = (scale * rng.uniform(-1.0, 1.0, 5)).tolist()
    return replace(
        profile,
        hover_thrust_frac=profile.hover_thrust_frac * (1.0 + _HOVER_THRUST_FRAC * hover),
        drag_1_s=profile.drag_1_s * (1.0 + _DRAG_FRAC * drag),
        attitude_delay_s=profile.attitude_delay_s * (1.0 + _ATTITUDE_DELAY_FRAC * delay),
        attitude_wn_rad_s=profile.attitude_wn_rad_s * (1.0 + _ATTITUDE_WN_FRAC * wn),
        attitude_zeta=profile.attitude_zeta * (1.0 + _ATTITUDE_ZETA_FRAC * zeta),
        gust_std_m_s2=max(profile.gust_std_m_s2, scale * _SIDEWAYS_STD_M_S2),
        thrust_noise_frac=max(profile.thrust_noise_frac, scale * _THRUST_STD_FRAC),
    )
