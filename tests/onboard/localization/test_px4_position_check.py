"""PX4's own position beside the motion capture's: when it has a say, and where a vehicle without
poses says it is.
"""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace

from onboard import agent_commands
from onboard.autopilot import Landed, Snapshot
from onboard.localization.px4_position_check import Px4PositionCheck
from onboard.tuples import Xyz
from tests.onboard.agent.rig import hovering_rig

_TENTH_NS = 100_000_000


def _seen(tenth: int, enu_m: Xyz, **changes: object) -> Snapshot:
    east, north, up = enu_m
    seen = Snapshot(
        local_position_ns=tenth * _TENTH_NS,
        position_local_ned_m=(north, east, -up),
        velocity_local_ned_m_s=(0.5, 0.0, 0.0),
        is_armed=True,
        landed=Landed.IN_AIR,
    )
    return replace(seen, **changes)


def _flown(tenths: int = 20) -> Px4PositionCheck:
    """Flying north at 0.5 m/s, always believed, by a PX4 whose frame lies 2 m further west."""
    check = Px4PositionCheck()
    for tenth in range(1, tenths + 1):
        check.update(
            _seen(tenth, (2.0, 0.05 * tenth, 1.0)), (0.0, 0.05 * tenth, 1.0), tenth * _TENTH_NS
        )
    return check


def test_it_learns_how_px4s_frame_lies_and_goes_on_from_there() -> None:
    check = _flown()
    for tenth in range(21, 31):
        check.update(_seen(tenth, (2.0, 0.05 * tenth, 1.0)), None, tenth * _TENTH_NS)
    place = check.motion(30 * _TENTH_NS + _TENTH_NS // 2)
    assert place is not None
    assert place[0] == pytest.approx((0.0, 1.525, 1.0), abs=1e-6)
    assert place[1] == (0.0, 0.5, 0.0)
    assert check.contradicts((0.0, 0.8, 1.0), 30 * _TENTH_NS)
    assert not check.contradicts((0.1, 1.5, 1.0), 30 * _TENTH_NS)


def test_it_has_no_say_once_it_is_old_or_has_been_blind_for_long() -> None:
    check = _flown()
    assert check.motion(20 * _TENTH_NS) is not None
    assert check.motion(23 * _TENTH_NS) is None
    for tenth in range(21, 160):
        check.update(_seen(tenth, (2.0, 0.05 * tenth, 1.0)), None, tenth * _TENTH_NS)
    assert check.motion(159 * _TENTH_NS) is None
    assert not check.contradicts((9.0, 9.0, 1.0), 159 * _TENTH_NS)


def test_on_the_ground_before_a_flight_it_has_no_say() -> None:
    check = Px4PositionCheck()
    for tenth in range(1, 20):
        check.update(
            _seen(tenth, (0.0, 0.0, 0.0), is_armed=False, landed=Landed.ON_GROUND),
            (0.0, 0.0, 0.0),
            tenth * _TENTH_NS,
        )
    assert not check.contradicts((3.0, 0.0, 0.0), 19 * _TENTH_NS)


def test_a_vehicle_that_comes_down_while_poses_are_rejected_lies_there_until_a_pose_agrees() -> (
    None
):
    check = _flown()
    check.update(_seen(21, (2.0, 1.05, 0.5)), None, 21 * _TENTH_NS)
    check.update(_seen(22, (2.0, 1.1, 0.0), landed=Landed.ON_GROUND), None, 22 * _TENTH_NS)
    for tenth in (30, 300, 3000):  # PX4 wanders on
        check.update(
            _seen(tenth, (9.0, 9.0, 3.0), landed=Landed.ON_GROUND), None, tenth * _TENTH_NS
        )
        place = check.motion(tenth * _TENTH_NS)
        assert place is not None
        assert math.dist(place[0][:2], (0.0, 1.1)) < 0.01
        assert place[1] == (0.0, 0.0, 0.0)
        assert check.contradicts((1.0, 0.3, 0.0), tenth * _TENTH_NS)
    check.update(
        _seen(3001, (9.0, 9.0, 3.0), landed=Landed.ON_GROUND), (0.0, 1.1, 0.0), 3001 * _TENTH_NS
    )
    assert not check.contradicts((1.0, 0.3, 0.0), 3001 * _TENTH_NS)


@pytest.mark.parametrize(("dead_reckoned_std_m", "std_m"), [(0.09, 0.09), (None, 0.3)])
def test_a_vehicle_that_stands_is_as_accurate_as_its_landing_was(
    dead_reckoned_std_m: float | None, std_m: float
) -> None:
    check = _flown()
    check.update(
        _seen(21, (2.0, 1.1, 0.0)),
        (0.0, 1.1, 0.0),
        21 * _TENTH_NS,
        dead_reckoned_std_m=dead_reckoned_std_m,
    )
    flown = check.motion(21 * _TENTH_NS)
    assert flown is not None
    assert (flown.position_std_m, flown.velocity_std_m_s) == (0.3, 0.3)

    stands = _seen(22, (2.0, 1.1, 0.0), landed=Landed.ON_GROUND)
    check.update(stands, None, 22 * _TENTH_NS, dead_reckoned_std_m=dead_reckoned_std_m)
    check.update(_seen(23, (9.0, 9.0, 3.0), landed=Landed.ON_GROUND), None, 23 * _TENTH_NS)
    landed = check.motion(23 * _TENTH_NS)
    assert landed is not None
    assert (landed.position_std_m, landed.velocity_std_m_s) == (std_m, 0.0)


def test_a_pose_that_jumps_for_good_is_never_believed_and_others_hear_where_it_lands() -> None:
    rig = hovering_rig()
    there = rig.position.copy()
    rig.has_mocap = False  # its own samples; these come instead
    for _ in range(500):
        x, y, z = rig.position.tolist()
        rig.pose(position_enu_m=(x + 1.0, y - 0.8, z + 1e-6 * (rig.tick_count % 2)))
        rig.step()
        assert rig.state is not None
        assert rig.state.is_valid
        assert math.dist(rig.state.position_enu_m[:2], there[:2]) < 0.3
    assert rig.core.flight.state == "landed"
    assert rig.count(agent_commands.Px4Land) == 0
    assert rig.state is not None
    assert not rig.state.is_cooperative
    assert rig.state.position_std_m < 0.1  # it landed by dead reckoning, and stands now
    assert rig.telemetry is not None
    assert not rig.telemetry.is_position_valid


def test_a_pose_that_comes_back_is_believed_again() -> None:
    rig = hovering_rig()
    rig.has_mocap = False
    for _ in range(6):
        x, y, z = rig.position.tolist()
        rig.pose(position_enu_m=(x + 1.0, y, z + 1e-6 * (rig.tick_count % 2)))
        rig.step()
    rig.has_mocap = True
    rig.run(1.0)
    assert rig.core.own.jumps == 0
    assert rig.core.flight.state == "holding"
    assert rig.state is not None
    assert rig.state.is_valid
