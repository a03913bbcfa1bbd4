"""A vehicle whose PX4 tells late where it is: from when on its estimate is in time again."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from onboard.autopilot import Landed, Snapshot
from onboard.config.fleet import load_fleet
from onboard.constants import GRAVITY_M_S2
from onboard.localization.own_state import OwnState
from onboard.safety.limits import POSITION_STALE_S
from onboard.tuples import Wxyz, Xyz
from onboard.types import TICK_S

TICK_NS = round(TICK_S * 1e9)
_FLEET = Path(__file__).parents[3] / "configs" / "fleets" / "px4-sitl.toml"
_HOVER_FRAC = 0.5
_CIRCLE_S = 3.0
_PULL_M_S2 = 2.2
_SINKING_M_S = 0.3


class _Tick(NamedTuple):
    """The truth of one tick, and what the vehicle makes of it."""

    time_s: float
    true_enu_m: Xyz
    told_enu_m: Xyz
    own_enu_m: Xyz
    age_s: float
    is_late: bool


def _circling(time_s: float) -> tuple[Xyz, Xyz]:
    """Return position and velocity on a circle, downwards."""
    rate = 2.0 * math.pi / _CIRCLE_S
    turn_rad = rate * time_s
    radius_m = _PULL_M_S2 / rate**2
    position = (radius_m * (math.cos(turn_rad) - 1.0), radius_m * math.sin(turn_rad))
    velocity = (-radius_m * rate * math.sin(turn_rad), radius_m * rate * math.cos(turn_rad))
    return (*position, -_SINKING_M_S * time_s), (*velocity, -_SINKING_M_S)


def _attitude(time_s: float, drag_1_s: float) -> tuple[Wxyz, float]:
    """Return the attitude that flies the circle, and the share of the hover throttle."""
    turn_rad = 2.0 * math.pi * time_s / _CIRCLE_S
    _, velocity = _circling(time_s)
    pull = np.array([-math.cos(turn_rad), -math.sin(turn_rad), 0.0]) * _PULL_M_S2
    thrust = pull + drag_1_s * np.array(velocity) + [0.0, 0.0, GRAVITY_M_S2]
    x, y, z = (thrust / np.linalg.norm(thrust)).tolist()
    # the shortest turn from upright
    quaternion = np.array([1.0 + z, -y, x, 0.0])
    turn_w, turn_x, turn_y, turn_z = (quaternion / np.linalg.norm(quaternion)).tolist()
    return (turn_w, turn_x, turn_y, turn_z), float(np.linalg.norm(thrust)) / GRAVITY_M_S2


def _flown(late_s: float, duration_s: float = 15.0) -> list[_Tick]:
    """Fly a circle on positions that are horizontally late; heights are in time."""
    vehicle = load_fleet(_FLEET).vehicles["mav0"]
    own = OwnState(vehicle, is_flown=True)
    start = vehicle.start_enu_m
    on_its_spot = Snapshot(local_position_ns=1, attitude_ns=1, landed=Landed.ON_GROUND)
    own.update(
        now_ns=1,
        dt_s=TICK_S,
        snapshot=on_its_spot,
        thrust_frac=0.0,
        hover_frac=_HOVER_FRAC,
        is_on_ground=True,
    )
    ticks = []
    for number in range(1, round(duration_s / TICK_S)):
        time_s = number * TICK_S
        now_ns = number * TICK_NS
        true, velocity = _circling(time_s)
        told, told_velocity = _circling(max(0.0, time_s - late_s))
        wxyz, thrust_share = _attitude(time_s, vehicle.drag_1_s)
        snapshot = Snapshot(
            quaternion_enu_flu_wxyz=wxyz,
            attitude_ns=now_ns,
            position_local_ned_m=(told[1], told[0], -true[2]),
            velocity_local_ned_m_s=(told_velocity[1], told_velocity[0], -velocity[2]),
            local_position_ns=now_ns,
            is_armed=True,
        )
        estimate = own.update(
            now_ns=now_ns,
            dt_s=TICK_S,
            snapshot=snapshot,
            thrust_frac=_HOVER_FRAC * thrust_share,
            hover_frac=_HOVER_FRAC,
            is_on_ground=False,
        )
        here = [axis - spot for axis, spot in zip(own.position_enu_m, start, strict=True)]
        ticks.append(
            _Tick(
                time_s=time_s,
                true_enu_m=true,
                told_enu_m=(told[0], told[1], true[2]),
                own_enu_m=(here[0], here[1], here[2]),
                age_s=estimate.age_s,
                is_late=own.fit.is_late,
            )
        )
    return ticks


def _apart_m(a: Xyz, b: Xyz) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])


@pytest.mark.parametrize("late_s", [0.4, 0.5])
def test_a_vehicle_that_finds_its_positions_late_knows_again_where_it_is(late_s: float) -> None:
    ticks = _flown(late_s)
    found_s = next(tick.time_s for tick in ticks if tick.is_late)
    assert found_s < 6.0

    after = [tick for tick in ticks if tick.time_s > found_s + 3.0]
    own_miss_m = max(_apart_m(tick.own_enu_m, tick.true_enu_m) for tick in after)
    told_miss_m = min(_apart_m(tick.told_enu_m, tick.true_enu_m) for tick in after)
    assert own_miss_m < 0.7 * told_miss_m


def test_heights_are_not_taken_for_late() -> None:
    ticks = _flown(0.4)
    assert ticks[-1].is_late
    after = ticks[-100:]
    assert max(abs(tick.own_enu_m[2] - tick.true_enu_m[2]) for tick in after) < 0.03


def test_late_positions_are_not_stale_while_they_come() -> None:
    ticks = _flown(0.4)
    assert ticks[-1].is_late
    assert max(tick.age_s for tick in ticks) < 0.5 * POSITION_STALE_S


def test_positions_in_time_are_used_as_they_come() -> None:
    ticks = _flown(0.0)
    assert not any(tick.is_late for tick in ticks)
    settled = ticks[100:]
    assert max(_apart_m(tick.own_enu_m, tick.true_enu_m) for tick in settled) < 0.05
