"""The avoidance law's values and policies, as a fleet file's ``[law]`` gives them: the one place of their defaults."""

from __future__ import annotations

from typing import Literal

import msgspec

LawName = Literal["covey", "paper", "off"]
QUICK_LAG_S = 0.15


class LawConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[law]``: the avoidance law's values and policies; onboard/avoidance/README.md explains each one."""

    name: LawName = "covey"
    # policies: each a small function chosen by name
    responsibility: Literal["shortfall", "half", "full"] = "shortfall"
    prediction: Literal["lag", "none"] = "lag"
    margin: Literal["accuracy", "fixed"] = "accuracy"
    rotation: Literal["violated", "never", "always"] = "violated"
    direction: Literal["intent", "crowd", "pair", "fixed"] = "intent"
    jam: Literal["slow", "ignore"] = "slow"
    # neighbours
    design_margin_m: float = 0.10
    lag_margin_m_s: float = 0.4  # more margin for each second of a vehicle's lag beyond QUICK_LAG_S
    uncooperative_margin_m: float = 0.05
    accuracy_time_s: float = 3.0
    kappa_1_1_s: float = 4.0
    kappa_2_1_s: float = 8.0
    kappa_3_1_s: float = 2.0
    kappa_4_1_s: float = 1.5
    shortfall_gain: float = 0.85
    v_perp_m_s: float = 0.42
    v_perp_crowd_m_s: float = 0.55
    crowd_count: int = 4
    # a rotation row is as strong as the violation, up to this one, so that nothing jumps when it begins
    rotation_fade_m_s2: float = 1.0
    max_neighbours: int = 12
    range_m: float = 8.0
    # obstacles, geofence and speed
    obstacle_margin_m: float = 0.20
    fence_margin_m: float = 0.05
    # separation may still push beyond: to 1.5 among 16 vehicles, to 2.3 for moments among 32 and more
    avoid_speed_frac: float = 1.3
    # the paper's law, (5)-(22)
    paper_kappa_1_1_s: float = 2.0
    paper_kappa_2_1_s: float = 2.0
    paper_kappa_3_1_s: float = 1.5
    paper_kappa_4_1_s: float = 1.5
    paper_v_perp_m_s: float = 0.1
    paper_turn: Literal["eq8", "eq9"] = "eq8"
    paper_force_ring: bool = False

    def margin_m(self, lag_s: float) -> float:
        """Margin above the safety distance that a vehicle keeps while estimates are good.

        Args:
            lag_s: of the vehicle, from command to acceleration.
        Returns:
            margin [m].
        """
        return self.design_margin_m + self.lag_margin_m_s * max(0.0, lag_s - QUICK_LAG_S)
