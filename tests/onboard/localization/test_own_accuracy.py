"""How accurate the own position is called: by the filter with a motion capture, by what PX4 itself
can be without.
"""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import MocapPose
from onboard.config.fleet import Vehicle
from onboard.estimation.accuracies import ACCURACIES
from onboard.localization.own_state import OwnState
from tests.onboard.agent.rig import DT_NS, fleet


def _vehicle(*, has_mocap: bool) -> Vehicle:
    return replace(fleet().vehicles["mav0"], mocap_required=has_mocap)


def _stood(
    has_mocap: bool,
    accuracy_m: float = 0.0,
    *,
    height_accuracy_m: float = 0.0,
    uses_heights: bool = False,
) -> tuple[float, float]:
    """Standard deviations of position and velocity after two seconds on the ground."""
    own = OwnState(_vehicle(has_mocap=has_mocap), uses_heights=uses_heights)
    for count in range(1, 101):
        now_ns = count * DT_NS
        seen = Snapshot(
            local_position_ns=now_ns,
            attitude_ns=now_ns,
            landed=Landed.ON_GROUND,
            position_accuracy_m=accuracy_m,
            height_accuracy_m=height_accuracy_m,
        )
        if has_mocap:
            still = (1e-6 * (count % 2), 0.0, 0.0)
            pose = MocapPose(
                body="mav0",
                boot_id=1,
                sequence=count,
                stamp_ns=now_ns,
                is_tracked=True,
                position_enu_m=still,
                quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
            )
            own.add_pose(pose, now_ns)
        estimate = own.update(now_ns, 0.02, seen, 0.0, 0.5, True)
    state = estimate.state
    assert state is not None
    return float(state.position_std_m), float(state.velocity_std_m_s)


def test_px4s_own_position_is_never_called_better_than_satellites_are() -> None:
    known = ACCURACIES["gps"]
    assert _stood(False) == (known.position_std_m, known.velocity_std_m_s)


def test_px4s_own_position_on_vision_is_called_as_accurate_as_the_checks_judge_it() -> None:
    own = OwnState(replace(_vehicle(has_mocap=False), px4_position="vision"))
    for now_ns in range(DT_NS, 101 * DT_NS, DT_NS):
        seen = Snapshot(local_position_ns=now_ns, attitude_ns=now_ns, landed=Landed.ON_GROUND)
        estimate = own.update(now_ns, 0.02, seen, 0.0, 0.5, True)
    known = ACCURACIES["vision"]
    assert estimate.state is not None
    assert (estimate.state.position_std_m, estimate.state.velocity_std_m_s) == (
        known.position_std_m,
        known.velocity_std_m_s,
    )


def test_when_px4_says_that_it_is_worse_it_is_believed_up_to_a_limit() -> None:
    assert _stood(False, 0.6)[0] == pytest.approx(0.424, abs=1e-3)
    assert _stood(False, 1e6)[0] == 0.5


def test_the_accuracy_of_heights_counts_where_vehicles_pass_above_each_other() -> None:
    assert _stood(False, 0.3, height_accuracy_m=1.5)[0] == pytest.approx(0.212, abs=1e-3)
    above = _stood(False, 0.3, height_accuracy_m=1.5, uses_heights=True)
    assert above[0] == 0.5, "the largest that is told"


def test_a_motion_captures_samples_speak_for_themselves_whatever_px4_says() -> None:
    assert max(_stood(True, 5.0)) < 0.05
