"""A neighbour whose word about itself cannot be true: by physics, by its own promise, by the motion
capture.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.bus.schema import MocapPose
from onboard.config.fleet import load_fleet
from onboard.neighbours.plausibility import (
    Claim,
    MocapPosition,
    PlausibilityMonitor,
    mocap_contradiction,
    physical_contradiction,
)
from onboard.neighbours.table import NeighbourTable

_FLEETS = Path(__file__).parents[3] / "configs/fleets"
MS = 1_000_000
_CLAIM = Claim(
    stamp_ns=1_000 * MS,
    position_enu_m=(1.0, 2.0, 1.0),
    velocity_enu_m_s=(1.0, 0.0, 0.0),
    predicted_position_enu_m=(1.3, 2.0, 1.0),
    predicted_velocity_enu_m_s=(1.0, 0.0, 0.0),
    lead_time_s=0.3,
    position_std_m=0.01,
)
_metres = st.floats(-20.0, 20.0)


def _moved(claim: Claim, dt_s: float, **changes: Any) -> Claim:
    """Return the same flight at constant velocity, some time later."""
    x, y, z = claim.position_enu_m
    px, py, pz = claim.predicted_position_enu_m
    way_m = dt_s * claim.velocity_enu_m_s[0]
    later = claim._replace(
        stamp_ns=claim.stamp_ns + round(dt_s * 1e9),
        position_enu_m=(x + way_m, y, z),
        predicted_position_enu_m=(px + way_m, py, pz),
    )
    return later._replace(**changes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, ""),
        (
            {"position_enu_m": (2.1, 2.0, 1.0), "predicted_position_enu_m": (2.4, 2.0, 1.0)},
            "moved 1.1 m in 0.1 s",
        ),
        (
            {"velocity_enu_m_s": (9.0, 0.0, 0.0), "predicted_position_enu_m": (3.0, 2.0, 1.0)},
            "changes its velocity",
        ),
        ({"velocity_enu_m_s": (0.0, 30.0, 0.0)}, "flies 30 m/s"),
        ({"predicted_position_enu_m": (3.0, 2.0, 1.0)}, "predicts another place"),
    ],
)
def test_what_contradicts_physics_or_the_own_promise_is_said(
    changes: dict[str, Any], words: str
) -> None:
    said = physical_contradiction(_CLAIM, _moved(_CLAIM, 0.1, **changes), 15.0)
    assert words in said
    assert bool(said) is bool(words)


@given(_metres, _metres, st.floats(-3.0, 3.0), st.floats(-10.0, 10.0), st.floats(0.02, 0.45))
def test_whoever_accelerates_as_hard_as_a_vehicle_can_contradicts_nothing(
    x: float, y: float, speed: float, acceleration: float, dt_s: float
) -> None:
    before = Claim(
        stamp_ns=MS,
        position_enu_m=(x, y, 1.0),
        velocity_enu_m_s=(speed, 0.0, 0.0),
        predicted_position_enu_m=(x + 0.3 * speed, y, 1.0),
        predicted_velocity_enu_m_s=(speed, 0.0, 0.0),
        lead_time_s=0.3,
        position_std_m=0.01,
    )
    after_m_s = speed + acceleration * dt_s
    after_m = x + speed * dt_s + 0.5 * acceleration * dt_s**2
    predicted = after_m + 0.3 * after_m_s + 0.5 * acceleration * 0.3**2
    after = Claim(
        stamp_ns=MS + round(dt_s * 1e9),
        position_enu_m=(after_m, y, 1.0),
        velocity_enu_m_s=(after_m_s, 0.0, 0.0),
        predicted_position_enu_m=(predicted, y, 1.0),
        predicted_velocity_enu_m_s=(after_m_s + 0.3 * acceleration, 0.0, 0.0),
        lead_time_s=0.3,
        position_std_m=0.01,
    )
    assert physical_contradiction(before, after, 15.0) == ""
    assert mocap_contradiction(before, MocapPosition(after.stamp_ns, after.position_enu_m)) == ""


def test_one_jump_is_an_estimator_that_began_anew_and_two_are_none() -> None:
    monitor = PlausibilityMonitor(15.0)
    jumped = _moved(
        _CLAIM, 0.1, position_enu_m=(2.1, 2.0, 1.0), predicted_position_enu_m=(2.4, 2.0, 1.0)
    )
    for claim in (_CLAIM, jumped, _moved(jumped, 0.1)):
        monitor.update(claim, None, claim.stamp_ns)
    assert monitor.is_watched
    assert not monitor.reason
    back = _moved(_CLAIM, 0.3)
    monitor.update(back, None, back.stamp_ns)
    assert monitor.reason.startswith("says that it moved")
    for number in range(40):
        claim = _moved(back, 0.1 * (number + 1))
        monitor.update(claim, None, claim.stamp_ns)
    assert not monitor.reason  # some seconds later
    assert not monitor.is_watched


def test_three_poses_in_a_row_elsewhere_are_believed_and_the_accuracy_it_says_is_granted() -> None:
    poses = [
        MocapPosition(_CLAIM.stamp_ns + 250 * MS * n, (2.2 + 0.25 * n, 2.0, 1.0)) for n in range(3)
    ]
    reasons = []
    for std_m in (0.01, 0.5):
        monitor = PlausibilityMonitor(15.0)
        for number, seen in enumerate(poses):
            claim = _moved(_CLAIM._replace(position_std_m=std_m), 0.25 * number)
            monitor.update(claim, seen, claim.stamp_ns)
            monitor.update(claim, seen, claim.stamp_ns)  # the same pose again proves nothing
        reasons.append(monitor.reason)
    assert reasons == ["says that it is 1.2 m from where the mocap sees it", ""]


def test_misses_of_long_ago_do_not_make_one_jump_a_lie() -> None:
    monitor = PlausibilityMonitor(15.0)
    for number in range(4):
        claim = _moved(_CLAIM, 0.1 * number)
        elsewhere = MocapPosition(claim.stamp_ns, (9.0, 2.0, 1.0))
        monitor.update(claim, elsewhere, claim.stamp_ns)
    assert monitor.reason
    # then the mocap does not see it any more
    for number in range(40):
        claim = _moved(_CLAIM, 0.5 + 0.1 * number)
        monitor.update(claim, None, claim.stamp_ns)

    x, y, z = claim.position_enu_m
    px, py, pz = claim.predicted_position_enu_m
    jumped = claim._replace(
        stamp_ns=claim.stamp_ns + 100 * MS,
        position_enu_m=(x + 2.0, y, z),
        predicted_position_enu_m=(px + 2.0, py, pz),
    )
    monitor.update(jumped, None, jumped.stamp_ns)
    assert monitor.is_watched
    assert not monitor.reason


@pytest.mark.parametrize(("name", "is_compared"), [("sih", True), ("px4-sitl", False)])
def test_only_the_word_of_a_vehicle_that_flies_by_the_mocap_is_compared_with_poses(
    name: str, is_compared: bool
) -> None:
    config = load_fleet(_FLEETS / f"{name}.toml")
    table = NeighbourTable(config, "mav0")
    pose = MocapPose(
        body=config.vehicles["mav1"].mocap_body or "mav1",
        boot_id=1,
        sequence=1,
        stamp_ns=5 * MS,
        is_tracked=True,
        position_enu_m=(1.0, 0.0, 1.0),
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
    )
    table.note_mocap_position(pose, 10 * MS)
    assert (table.claim("mav1")[1] is not None) == is_compared
