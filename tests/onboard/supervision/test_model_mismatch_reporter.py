"""How often a vehicle's response is sampled and compared, and that each difference is told once."""

from __future__ import annotations

import math

from onboard.constants import GRAVITY_M_S2
from onboard.estimation import disturbance_observer
from onboard.supervision.model_mismatch_reporter import ModelMismatchReporter
from onboard.types import TICK_S
from onboard.vectors import ZERO_3, Vec3
from tests.onboard.agent.rig import fleet

VEHICLE = fleet().vehicles["mav0"]
LEVEL = (1.0, 0.0, 0.0, 0.0)


class Flying:
    """A vehicle whose attitude answers so much later than its file says."""

    def __init__(self, late_s: float = 0.0) -> None:
        self.reporter = ModelMismatchReporter(VEHICLE)
        self.late_s = late_s
        self.tick = 0

    def fly(self, seconds: float, hover_frac: float) -> list[tuple[float, str]]:
        """Return when which code was told."""
        told = []
        for _ in range(round(seconds / TICK_S)):
            self.tick += 1
            if self.reporter.is_due():
                now_s = self.tick * TICK_S
                told += [(now_s, code) for code, _ in self._follow(now_s, hover_frac)]
        return told

    def _follow(self, now_s: float, hover_frac: float) -> list[tuple[str, str]]:
        east, north = 1.1, 2.3  # angular frequencies of the commands
        response = Vec3(math.sin(east * now_s), math.sin(north * now_s), 0.0)
        rate = Vec3(east * math.cos(east * now_s), north * math.cos(north * now_s), 0.0)
        before_s = now_s - self.late_s - 0.012
        tilt_x = math.sin(east * before_s) / GRAVITY_M_S2
        tilt_y = math.sin(north * before_s) / GRAVITY_M_S2
        attitude = _leaning(tilt_x, tilt_y)
        model = disturbance_observer.initial(ZERO_3)._replace(
            response_enu_m_s2=response, response_rate_enu_m_s3=rate
        )
        return self.reporter.update(model, attitude, hover_frac)


def _leaning(tilt_x: float, tilt_y: float) -> tuple[float, float, float, float]:
    """Return the attitude whose up axis has this slope to the east and to the north."""
    slope = math.hypot(tilt_x, tilt_y)
    if slope == 0.0:
        return LEVEL
    half_rad = 0.5 * math.atan(slope)
    share = math.sin(half_rad) / slope
    return (math.cos(half_rad), -share * tilt_y, share * tilt_x, 0.0)


def test_ten_samples_a_second_are_taken() -> None:
    reporter = ModelMismatchReporter(VEHICLE)
    due = [tick for tick in range(1, 51) if reporter.is_due()]
    assert due == [5, 10, 15, 20, 25, 30, 35, 40, 45, 50]


def test_a_hover_throttle_that_differs_is_told_once_at_the_first_second_that_knows_it() -> None:
    """What eight seconds of memory need, with what is forgotten meanwhile, is 9.3 s of flight."""
    flying = Flying()
    too_much_frac = 1.2 * VEHICLE.hover_thrust_frac
    assert flying.fly(9.9, too_much_frac) == []
    assert flying.fly(30.0, too_much_frac) == [(10.0, "hover-differs")]


def test_each_flight_is_compared_anew() -> None:
    flying = Flying()
    too_much_frac = 1.2 * VEHICLE.hover_thrust_frac
    assert flying.fly(12.0, too_much_frac) == [(10.0, "hover-differs")]
    flying.reporter.begin_flight()
    assert flying.fly(9.9, too_much_frac) == []
    assert [code for _, code in flying.fly(2.0, too_much_frac)] == ["hover-differs"]


def test_a_vehicle_that_is_too_slow_is_told_besides_its_throttle() -> None:
    flying = Flying(late_s=0.1)
    assert flying.fly(20.0, VEHICLE.hover_thrust_frac) == [(10.0, "lag-differs")]
    too_much_frac = 1.2 * VEHICLE.hover_thrust_frac
    assert flying.fly(20.0, too_much_frac) == [(21.0, "hover-differs")]


def test_a_vehicle_as_its_file_says_is_told_nothing() -> None:
    assert Flying().fly(60.0, VEHICLE.hover_thrust_frac) == []
