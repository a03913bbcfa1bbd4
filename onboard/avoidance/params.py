"""Values of the law for one vehicle: the fleet file's law, what the vehicle is, and the numbers that follow from both.

Policies are names in the configuration and numbers here, so that array code, scalar kernels and compiled kernels read
the same thing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, get_type_hints

import msgspec

from onboard.avoidance.oist_paper import PaperLawParams
from onboard.config.law import LawConfig, LawName
from onboard.config.obstacles import Capsule
from onboard.types import GRAVITY_M_S2

OPEN_FENCE = (-math.inf, math.inf, -math.inf, math.inf)
_BRAKE_SHARE = 0.6  # of the horizontal acceleration, for stopping before what stands still
_MARGIN_FLOOR_M, _MARGIN_SIGMAS = 0.05, 4.5  # fitted over simulated flights: the floor covers lag errors and gusts

ROTATION = {"never": 0, "violated": 1, "always": 2}
DIRECTION = {"fixed": 0, "pair": 1, "crowd": 2, "intent": 3}


class LawNumbers(NamedTuple):
    """What rows and kernels compute with; units as in LawConfig.

    is_full: 1 for the paper's full share, and shortfall_gain 0 for plain halves: the responsibility policy. rotation,
    direction: places in the tables above. margin_m: the fixed part of the design margin; sigma_position, sigma_velocity
    [-], [s]: margin per metre and per m/s of a vehicle's standard deviation, 0 under the fixed policy. static_kappa_*:
    for what stands still. lead_time_s: L, or 0 without prediction.
    """

    is_full: int
    shortfall_gain: float
    rotation: int
    direction: int
    lead_time_s: float
    safety_distance_m: float
    margin_m: float
    uncooperative_margin_m: float
    margin_floor_m: float
    sigma_position: float
    sigma_velocity_s: float
    kappa_1_1_s: float
    kappa_2_1_s: float
    kappa_3_1_s: float
    kappa_4_1_s: float
    static_kappa_1_1_s: float
    v_perp_m_s: float
    v_perp_crowd_m_s: float
    crowd_count: int
    rotation_fade_m_s2: float
    max_neighbours: int
    range_m: float
    clearance_m: float
    top_speed_m_s: float
    fence_low_x_m: float
    fence_high_x_m: float
    fence_low_y_m: float
    fence_high_y_m: float


_KINDS = tuple(get_type_hints(LawNumbers).values())


@dataclass(frozen=True, slots=True)
class LawParams:
    """The law of one vehicle.

    config: values and policies; their defaults stand there and nowhere else. lag_s: the own L; vertical_lag_s: the
    motors'. body_radius_m: keeps the hull off obstacles. max_thrust_m_s2: collective thrust at full throttle per mass.
    fence_enu_m: walls (x low, x high, y low, y high). capsules_enu_m: static obstacles.
    """

    config: LawConfig = field(default_factory=LawConfig)
    lag_s: float = 0.15
    vertical_lag_s: float = 0.09
    safety_distance_m: float = 0.8
    body_radius_m: float = 0.25
    max_speed_m_s: float = 1.0
    max_tilt_rad: float = math.radians(25.0)
    max_thrust_m_s2: float = 2.0 * GRAVITY_M_S2
    fence_enu_m: tuple[float, float, float, float] = OPEN_FENCE
    capsules_enu_m: tuple[Capsule, ...] = ()
    numbers: LawNumbers = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "numbers", _numbers(self))

    @property
    def name(self) -> LawName:
        """Which law: covey, paper or off."""
        return self.config.name

    @property
    def capsule_values(self) -> list[float]:
        """All numbers of all capsules, one after the other."""
        return [float(value) for capsule in self.capsules_enu_m for value in capsule]

    @property
    def d_design_m(self) -> float:
        """Distance kept between two vehicles with good estimates."""
        return self.safety_distance_m + self.config.margin_m(self.lag_s)

    @property
    def paper(self) -> PaperLawParams:
        """The paper's values."""
        c = self.config
        return PaperLawParams(
            kappa_1_1_s=c.paper_kappa_1_1_s,
            kappa_2_1_s=c.paper_kappa_2_1_s,
            kappa_3_1_s=c.paper_kappa_3_1_s,
            kappa_4_1_s=c.paper_kappa_4_1_s,
            v_perp_m_s=c.paper_v_perp_m_s,
            d_inf_m=self.safety_distance_m,
            turn_sign=1.0 if c.paper_turn == "eq8" else -1.0,
        )

    def changed(self, **values: Any) -> LawParams:
        """These parameters with other values in the configuration."""
        return replace(self, config=msgspec.structs.replace(self.config, **values))


def _numbers(params: LawParams) -> LawNumbers:
    c = params.config
    sigma_position, sigma_velocity_s = _sigmas(c)
    top_speed_m_s = c.avoid_speed_frac * params.max_speed_m_s
    brake_m_s2 = _BRAKE_SHARE * GRAVITY_M_S2 * math.tan(params.max_tilt_rad)
    low_x, high_x, low_y, high_y = params.fence_enu_m
    numbers = LawNumbers(
        is_full=int(c.responsibility == "full"),
        shortfall_gain=c.shortfall_gain if c.responsibility == "shortfall" else 0.0,
        rotation=ROTATION[c.rotation],
        direction=DIRECTION[c.direction],
        lead_time_s=params.lag_s if c.prediction == "lag" else 0.0,
        safety_distance_m=params.safety_distance_m,
        margin_m=c.margin_m(params.lag_s),
        uncooperative_margin_m=c.uncooperative_margin_m,
        margin_floor_m=_MARGIN_FLOOR_M if c.margin == "accuracy" else 0.0,
        sigma_position=sigma_position,
        sigma_velocity_s=sigma_velocity_s,
        kappa_1_1_s=c.kappa_1_1_s,
        kappa_2_1_s=c.kappa_2_1_s,
        kappa_3_1_s=c.kappa_3_1_s,
        kappa_4_1_s=c.kappa_4_1_s,
        # the row lets a vehicle close at kappa_1 times its distance, which must not ask for more braking than there is
        static_kappa_1_1_s=min(c.kappa_1_1_s, brake_m_s2 / top_speed_m_s),
        v_perp_m_s=c.v_perp_m_s,
        v_perp_crowd_m_s=c.v_perp_crowd_m_s,
        crowd_count=c.crowd_count,
        rotation_fade_m_s2=c.rotation_fade_m_s2,
        max_neighbours=c.max_neighbours,
        range_m=c.range_m,
        clearance_m=params.body_radius_m + c.obstacle_margin_m,
        top_speed_m_s=top_speed_m_s,
        fence_low_x_m=low_x + c.fence_margin_m,
        fence_high_x_m=high_x - c.fence_margin_m,
        fence_low_y_m=low_y + c.fence_margin_m,
        fence_high_y_m=high_y - c.fence_margin_m,
    )
    # a fleet file may say 1 for 1.0, and compiled code is made for kinds of numbers
    return LawNumbers._make(kind(value) for kind, value in zip(_KINDS, numbers, strict=True))


def _sigmas(c: LawConfig) -> tuple[float, float]:
    """Margin per metre and per m/s of one vehicle's standard deviation under the accuracy policy, else 0.

    An error with correlation time tau passes the distance row's filter with the power Phi(tau); the two vehicles' add.
    """
    if c.margin == "fixed":
        return 0.0, 0.0
    a_1, a_0, rate = c.kappa_1_1_s + c.kappa_2_1_s, c.kappa_1_1_s * c.kappa_2_1_s, 1.0 / c.accuracy_time_s
    phi = (a_1 + rate) / (a_0 * a_1 * (rate * rate + a_1 * rate + a_0))
    return _MARGIN_SIGMAS * a_0 * math.sqrt(phi), _MARGIN_SIGMAS * a_1 * math.sqrt(phi)
