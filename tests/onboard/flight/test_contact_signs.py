"""The signs of contact one by one, at their limits and a little beside them.

What a flight makes of them is shown in test_contact.py; here each number of contact.py stands once
more, as a literal.
"""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from onboard.autopilot import Landed, Snapshot
from onboard.constants import GRAVITY_M_S2
from onboard.control.vertical_limits import baseline_m_s2
from onboard.flight import contact
from onboard.flight.contact import ContactSigns
from onboard.flight.types import FlightView
from tests.onboard.agent.rig import fleet

_BEFORE_NS = 5_000_000_000
_NOW_NS = 100_000_000_000
_MS = 1_000_000
_VEHICLE = fleet().vehicles["mav0"]


def _view(
    height_m: float = 2.0,
    *,
    sinks_m_s: float = 1.0,
    thrust_share: float = 1.0,
    lift_share: float | None = None,
    is_reported: bool = False,
    is_dead_reckoned: bool = False,
) -> FlightView:
    """A vehicle in flight; PX4's reports are new."""
    landed = Landed.ON_GROUND if is_reported else Landed.IN_AIR
    snapshot = Snapshot(
        landed=landed, landed_ns=_NOW_NS, velocity_local_ned_m_s=(0.0, 0.0, sinks_m_s)
    )
    return FlightView(
        now_ns=_NOW_NS,
        position_enu_m=(0.0, 0.0, height_m),
        velocity_enu_m_s=(0.0, 0.0, -sinks_m_s),
        has_position=True,
        snapshot=snapshot,
        thrust_share=thrust_share,
        lift_share=thrust_share if lift_share is None else lift_share,
        is_dead_reckoned=is_dead_reckoned,
    )


def _observed(
    view: FlightView,
    *,
    has_mocap: bool = True,
    sinks_without_poses: bool = False,
    height_m: float = 2.0,
    hover_thrust_frac: float = 0.5,
) -> ContactSigns:
    """The signs of a tick, when all of them held before."""
    before = ContactSigns(height_m, _BEFORE_NS, _BEFORE_NS, _BEFORE_NS, _BEFORE_NS)
    vehicle = replace(_VEHICLE, mocap_required=has_mocap, hover_thrust_frac=hover_thrust_frac)
    return contact.observe(before, view, vehicle, sinks_without_poses=sinks_without_poses)


def _lasted(**since_ms: float) -> ContactSigns:
    """Signs that have lasted so long; the others begin now."""
    stamps_ns = {f"{sign}_since_ns": _NOW_NS - round(ms * _MS) for sign, ms in since_ms.items()}
    return replace(ContactSigns(2.0, _NOW_NS, _NOW_NS, _NOW_NS, _NOW_NS), **stamps_ns)


# -- observed at a tick ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("height_m", "still_since_ns", "from_m"),
    [(0.019, _BEFORE_NS, 0.0), (0.02, _NOW_NS, 0.02), (-0.021, _NOW_NS, -0.021)],
)
def test_with_a_mocap_it_is_still_while_its_height_stays_within_two_centimetres(
    height_m: float, still_since_ns: int, from_m: float
) -> None:
    signs = _observed(_view(height_m), height_m=0.0)
    assert (signs.still_since_ns, signs.height_m) == (still_since_ns, from_m)


@pytest.mark.parametrize(
    ("sinks_m_s", "still_since_ns"), [(0.149, _BEFORE_NS), (0.15, _NOW_NS), (-0.15, _NOW_NS)]
)
def test_without_a_mocap_it_is_still_by_px4s_speed(sinks_m_s: float, still_since_ns: int) -> None:
    signs = _observed(_view(2.5, sinks_m_s=sinks_m_s), has_mocap=False)
    assert (signs.still_since_ns, signs.height_m) == (still_since_ns, 2.5)


@pytest.mark.parametrize("has_mocap", [True, False])
@pytest.mark.parametrize(
    ("sinks_m_s", "still_since_ns"), [(0.249, _BEFORE_NS), (0.25, _NOW_NS), (-3.0, _BEFORE_NS)]
)
def test_without_poses_it_is_still_unless_it_sinks(
    has_mocap: bool, sinks_m_s: float, still_since_ns: int
) -> None:
    view = _view(2.0, sinks_m_s=sinks_m_s, is_dead_reckoned=True)
    assert _observed(view, has_mocap=has_mocap).still_since_ns == still_since_ns


@pytest.mark.parametrize(("thrust_share", "light_since_ns"), [(0.79, _BEFORE_NS), (0.8, _NOW_NS)])
def test_it_is_light_below_four_fifths_of_the_thrust(
    thrust_share: float, light_since_ns: int
) -> None:
    assert _observed(_view(thrust_share=thrust_share)).light_since_ns == light_since_ns


@pytest.mark.parametrize(
    ("hover_thrust_frac", "lift_share", "light_since_ns"),
    [
        (0.75, 0.89, _BEFORE_NS),
        (0.75, 0.90, _NOW_NS),
        (0.8, 0.915, _BEFORE_NS),
        (0.8, 0.925, _NOW_NS),
    ],
)
def test_a_vehicle_with_little_lift_reserve_is_light_while_it_sinks_as_hard_as_it_may(
    hover_thrust_frac: float, lift_share: float, light_since_ns: int
) -> None:
    # it leans against the wind, so its whole thrust is more than its lift
    view = _view(thrust_share=1.1, lift_share=lift_share)
    assert _observed(view, hover_thrust_frac=hover_thrust_frac).light_since_ns == light_since_ns
    hardest = 1.0 - baseline_m_s2(hover_thrust_frac) / GRAVITY_M_S2
    assert hardest < contact.light_share(hover_thrust_frac) - 0.01


@pytest.mark.parametrize(
    ("sinks_m_s", "slow_since_ns"), [(0.69, _BEFORE_NS), (0.7, _NOW_NS), (-0.7, _NOW_NS)]
)
def test_it_is_slow_below_what_a_vehicle_sinks_with_that_nothing_carries(
    sinks_m_s: float, slow_since_ns: int
) -> None:
    assert _observed(_view(sinks_m_s=sinks_m_s)).slow_since_ns == slow_since_ns


def test_the_report_of_the_ground_begins_anew_when_px4_stops_reporting_it() -> None:
    assert _observed(_view(is_reported=True)).reported_since_ns == _BEFORE_NS
    assert _observed(_view(is_reported=False)).reported_since_ns == _NOW_NS


# -- what they say together ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("height_m", "signs", "is_down"),
    [
        (2.0, _lasted(light=351, still=351), True),
        (2.0, _lasted(light=350, still=351), False),
        (2.0, _lasted(light=351, still=350), False),
        (2.0, _lasted(light=351, reported=351), True),
        (2.0, _lasted(light=351, reported=350), False),
        (2.0, _lasted(light=351, reported=352), False),  # a report from before
        (0.029, _lasted(still=351), True),
        (-0.019, _lasted(still=351), True),
        (-0.021, _lasted(still=351), False),
        (0.03, _lasted(still=351), False),
        (0.029, _lasted(), False),
        (2.0, _lasted(still=351, reported=351), False),
    ],
)
def test_a_vehicle_with_a_mocap_is_down_by_two_signs_that_agree_for_a_moment(
    height_m: float, signs: ContactSigns, is_down: bool
) -> None:
    view = _view(height_m, thrust_share=0.96)
    assert contact.has_ground_contact(signs, view, 0.0, is_late=False) is is_down
    # and so it is above ground of another height
    lower = _view(height_m - 0.5, thrust_share=0.96)
    assert contact.has_ground_contact(signs, lower, -0.5, is_late=False) is is_down


def test_a_vehicle_whose_thrust_carries_it_hovers_however_low() -> None:
    assert not contact.has_ground_contact(
        _lasted(still=351), _view(0.02, thrust_share=0.97), 0.0, is_late=False
    )


@pytest.mark.parametrize(
    ("height_m", "still_ms", "is_late", "is_down"),
    [
        (0.29, 1501, True, True),
        (0.30, 1501, True, False),
        (-0.019, 1501, True, True),
        (-0.021, 1501, True, False),
        (0.29, 1500, True, False),
        (0.29, 1501, False, False),
    ],
)
def test_a_vehicle_that_should_be_down_and_stands_low_for_long_is_down(
    height_m: float, still_ms: float, is_late: bool, is_down: bool
) -> None:
    signs = _lasted(still=still_ms)
    assert contact.has_ground_contact(signs, _view(height_m), 0.0, is_late) is is_down


@pytest.mark.parametrize(
    ("signs", "is_down"),
    [
        (_lasted(light=351, still=351), True),
        (_lasted(light=350, still=351), False),
        (_lasted(light=351, still=350), False),
        (_lasted(light=351, reported=351), True),
        (_lasted(light=351, reported=350), False),
        (_lasted(light=351, reported=352), False),
        (_lasted(light=1501, slow=1501), True),
        (_lasted(light=1500, slow=1501), False),
        (_lasted(light=1501, slow=1500), False),
    ],
)
def test_a_vehicle_whose_height_says_nothing_is_down_by_thrust_and_motion(
    signs: ContactSigns, is_down: bool
) -> None:
    assert contact.has_ground_contact_by_thrust(signs, _view(2.0)) is is_down


@pytest.mark.parametrize(
    ("height_m", "still_ms", "seems_down", "is_down"),
    [
        (0.59, 261, True, True),
        (0.59, 260, True, False),
        (0.59, 61, True, False),
        (0.59, 59, False, False),
        (0.60, 261, False, False),
        (-1.0, 0, False, False),
        (-1.01, 0, False, True),
    ],
)
def test_a_vehicle_without_poses_is_down_when_it_does_not_sink_where_the_ground_may_be(
    height_m: float, still_ms: float, seems_down: bool, is_down: bool
) -> None:
    signs = _lasted(still=still_ms)
    view = _view(height_m, is_dead_reckoned=True)
    assert contact.may_have_ground_contact_without_poses(signs, view, 0.0) is seems_down
    assert contact.has_ground_contact_without_poses(signs, view, 0.0, 0.0) is is_down


def test_without_poses_the_height_is_that_above_the_ground_of_the_take_off() -> None:
    signs = _lasted(still=261)
    above = _view(4.5, is_dead_reckoned=True)
    below = _view(0.5, is_dead_reckoned=True)
    assert contact.has_ground_contact_without_poses(signs, above, 4.0, 4.0)
    assert contact.may_have_ground_contact_without_poses(signs, above, 4.0)
    assert not contact.has_ground_contact_without_poses(signs, below, -4.0, -4.0)
    assert not contact.may_have_ground_contact_without_poses(signs, below, -4.0)


def test_without_poses_it_may_sink_to_the_lowest_ground() -> None:
    deep = _view(-3.0, is_dead_reckoned=True)
    assert contact.has_ground_contact_without_poses(_lasted(), deep, 0.0, -1.9)
    assert not contact.has_ground_contact_without_poses(_lasted(), deep, 0.0, -2.1)


@pytest.mark.parametrize(("height_m", "is_down"), [(0.059, True), (0.061, False)])
def test_with_poses_for_a_moment_a_vehicle_is_down_only_where_its_gear_may_touch(
    height_m: float, is_down: bool
) -> None:
    signs = _lasted(still=500)
    seen = _view(height_m, is_dead_reckoned=False)
    assert contact.may_have_ground_contact_without_poses(signs, seen, 0.0) is is_down
    assert contact.has_ground_contact_without_poses(signs, seen, 0.0, 0.0) is is_down
