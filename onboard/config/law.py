"""``[law]`` of a fleet file: the values and policies of the avoidance law, with their defaults."""

from __future__ import annotations

from typing import Literal

import msgspec

BuiltInLaw = Literal["covey", "paper", "off"]
BUILT_IN: tuple[BuiltInLaw, ...] = ("covey", "paper", "off")
QUICK_LAG_S = 0.15  # up to this lag, design_margin_m is enough margin for a vehicle
# fields that choose variants of Covey's law, for simulations only; real vehicles use the defaults
POLICIES = ("responsibility", "prediction", "margin", "rotation", "direction", "jam")


class LawConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[law]``: the avoidance law's values and policies; see onboard/avoidance/README.md."""

    # "paper" and "off" are for simulation and for comparison; "module:function", or the name of an
    # entry point of the group covey.laws, is a law of your own: docs/own-law.md
    name: str = "covey"
    # folder where the module of your own law is searched first, beside this file or below it, of
    # A-Z a-z 0-9 _ . / - without ..
    folder: str = "."
    # true: your own law may also fly vehicles that are not emulated
    allow_own_law_on_real_vehicles: bool = False

    # -- six policies, each chosen by name; real vehicles take off only with the defaults --

    # share of a correction that each vehicle of a pair makes; "shortfall": half, plus
    # shortfall_gain times the part of the other half that the other vehicle visibly omits; "full":
    # all
    responsibility: Literal["shortfall", "half", "full"] = "shortfall"
    # "lag": rows hold at the time when a command takes effect
    prediction: Literal["lag", "none"] = "lag"
    # "accuracy": the margin grows with the errors of the vehicles' positions; "fixed":
    # design_margin_m
    margin: Literal["accuracy", "fixed"] = "accuracy"
    # when vehicles that meet turn about each other
    rotation: Literal["ahead", "violated", "never", "always"] = "ahead"
    direction: Literal["intent", "crowd", "pair", "fixed"] = "intent"  # which way they turn
    # "slow": while the law often relaxes rows, the vehicle flies more slowly towards its goal
    jam: Literal["slow", "ignore"] = "slow"

    # -- neighbours --

    design_margin_m: float = 0.10  # distance kept beyond the safety distance
    lag_margin_m_s: float = 0.4  # more margin for each second of a vehicle's lag beyond QUICK_LAG_S
    uncooperative_margin_m: float = 0.05  # more margin beside a vehicle that does not avoid
    accuracy_time_s: float = 3.0  # time over which the errors of positions are averaged
    kappa_1_1_s: float = 4.0  # distance rows, first gain; a larger gain makes vehicles brake later
    kappa_2_1_s: float = 8.0  # distance rows, second gain
    kappa_3_1_s: float = 2.0  # rotation rows, first gain
    kappa_4_1_s: float = 1.0  # rotation rows, second gain
    # share of a neighbour's visibly omitted correction that a vehicle takes over
    shortfall_gain: float = 0.85
    v_perp_m_s: float = 0.55  # speed of the turn about each other
    v_perp_crowd_m_s: float = 0.65  # speed of that turn in a crowd
    crowd_count: int = 4  # number of neighbours that make a crowd
    # violation at which a rotation row reaches its full strength; below it the strength is
    # proportional, so that nothing jumps when the row becomes active
    rotation_fade_m_s2: float = 2.0
    # 2: in a level move, every second vehicle rises between the ends of the move and flies above
    # the others, by a little more than fleet.vertical_separation_m; 1: all stay level
    passing_heights: Literal[1, 2] = 1
    max_neighbours: int = 12  # number of neighbours that are avoided: the nearest
    range_m: float = 8.0  # neighbours farther away are ignored

    # -- obstacles, geofence and speed --

    obstacle_margin_m: float = 0.20  # distance kept between obstacles and the propellers
    fence_margin_m: float = 0.05  # distance kept from the fence
    # Share of max_speed_m_s at which a vehicle starts to brake. It overshoots by a tenth, because
    # its attitude lags. To keep the safety distance, it may fly faster.
    avoid_speed_frac: float = 0.97

    # -- the paper's law, (5)-(22) --

    paper_kappa_1_1_s: float = 2.0  # of (17)
    paper_kappa_2_1_s: float = 2.0  # of (17)
    paper_kappa_3_1_s: float = 1.5  # of (18)
    paper_kappa_4_1_s: float = 1.5  # of (18)
    paper_v_perp_m_s: float = 0.1  # of (8)
    # D_inf is the safety distance plus this, for control with steps and lags
    paper_margin_m: float = 0.0
    paper_turn: Literal["eq8", "eq9"] = "eq8"  # which equation turns the vehicles
    # true: in simulation, it may fly more than three vehicles
    paper_force_ring: bool = False

    @property
    def is_own(self) -> bool:
        """Whether the name belongs to a user's own law."""
        return self.name not in BUILT_IN

    @property
    def built_in(self) -> BuiltInLaw:
        """The built-in law of that name; ``covey`` for a user's own law.

        Covey's law is computed beside a user's own law, and takes over if the own law fails.
        """
        for name in BUILT_IN:
            if name == self.name:
                return name
        return "covey"

    @property
    def changed_policies(self) -> tuple[str, ...]:
        """Names of the policies that are not at their defaults. Only a simulation may use such
        policies.
        """
        default = LawConfig()
        return tuple(name for name in POLICIES if getattr(self, name) != getattr(default, name))

    def margin_m(self, lag_s: float) -> float:
        """Margin [m] on top of the safety distance that a vehicle keeps while estimates are good.

        Args:
            lag_s: lag of the vehicle, from command to acceleration.
        """
        return self.design_margin_m + self.lag_margin_m_s * max(0.0, lag_s - QUICK_LAG_S)
