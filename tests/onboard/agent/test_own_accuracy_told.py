"""Vehicles that fly on PX4's position believe it by what PX4 tells of its accuracy and of its
satellites.
"""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from onboard.agent.core import AgentCore
from onboard.flight.types import FlightStep
from onboard.px4.message_parsers import PARSERS
from tests.onboard.agent.rig import Rig, fleet


def _rig(
    accuracy_m: float,
    px4_position: str = "gps",
    px4_params: dict[str, float] | None = None,
    px4_version: str = "1.17",
) -> Rig:
    whole = fleet(("mav0",))
    bare = {
        name: msgspec.structs.replace(
            vehicle,
            mocap_required=False,
            px4_position=px4_position,
            px4_version=px4_version,
            px4_params=px4_params or vehicle.px4_params,
        )
        for name, vehicle in whole.vehicles.items()
    }
    rig = Rig(
        AgentCore(msgspec.structs.replace(whole, vehicles=bare), "mav0", boot_id=7), has_mocap=False
    )
    _tell(rig, accuracy_m)
    return rig


def _tell(rig: Rig, accuracy_m: float) -> None:
    rig.snapshot = msgspec.structs.replace(rig.snapshot, position_accuracy_m=accuracy_m)


@pytest.mark.failsafe("own position inaccurate", step="on the ground, disarmed")
@pytest.mark.parametrize("accuracy_m", [20.0, math.inf, 0.0, 0.8])
def test_an_accuracy_that_no_distance_covers_refuses_the_take_off_in_words(
    accuracy_m: float,
) -> None:
    rig = _rig(accuracy_m)
    rig.run(4.0)
    assert rig.core.flight.state == "waiting"
    reply = rig.order("takeoff", height_m=1.0)
    assert not reply.is_accepted
    assert any("wn position inaccurate" in reason for reason in rig.core.preflight.not_ready)


@pytest.mark.failsafe("own position inaccurate", step="flying")
@pytest.mark.parametrize("accuracy_m", [1.0, 20.0, math.inf])
def test_a_position_that_becomes_inaccurate_in_flight_lands(accuracy_m: float) -> None:
    rig = _rig(0.4)
    rig.fly()
    _tell(rig, accuracy_m)
    rig.run(0.2)
    _tell(rig, 0.4)
    rig.run(1.0)
    assert rig.core.flight.state == "flying"  # a moment is none
    _tell(rig, accuracy_m)
    rig.run(1.0)
    assert rig.core.flight.state == "landing"
    assert "position-inaccurate" in {event.code for event in rig.events}
    rig.until("landed")


@pytest.mark.parametrize("has_mocap", [True, False])
def test_height_that_comes_back_up_after_touch_down_ends_a_landing_only_where_a_mocap_measures_it(
    has_mocap: bool,
) -> None:
    rig = Rig() if has_mocap else _rig(0.4)
    rig.fly()
    rig.order("land")
    while rig.core.flight.step is not FlightStep.CONTACT:
        rig.step()

    def rise() -> None:  # as SIH's vehicles do that have sunk into the ground
        rig.velocity[2] = 1.6

    rig.after_move = rise
    rig.run(0.5)
    assert (rig.core.flight.step is FlightStep.PX4_LANDING) == has_mocap
    rig.after_move = lambda: None
    rig.until("landed")


@pytest.mark.parametrize(
    ("flags", "is_known"),
    [
        (0x1EF, True),
        (0xFF, False),  # a PX4 whose vision was lost less than 5 s ago
        (0xE5, False),  # a PX4 v1.18 on the ground that fuses vision which never came
    ],
)
def test_px4_knows_no_position_without_its_flags(flags: int, is_known: bool) -> None:
    assert PARSERS["ESTIMATOR_STATUS"](_status(flags=flags), 5)["is_position_known"] is is_known


def _status(*, flags: int = 0x1EF, mag_ratio: float = 0.1) -> dict[str, Any]:
    return {
        "pos_horiz_accuracy": 0.02,
        "pos_vert_accuracy": 0.1,
        "flags": flags,
        "pos_horiz_ratio": 0.1,
        "mag_ratio": mag_ratio,
    }


def test_px4_tells_how_far_the_heading_of_its_camera_differs() -> None:
    assert PARSERS["ESTIMATOR_STATUS"](_status(mag_ratio=0.4), 5)["heading_ratio"] == 0.4


def test_a_vehicle_whose_px4_knows_no_position_does_not_take_off() -> None:
    """PX4 sends a local position and a good accuracy also while no camera tells it anything."""
    rig = _rig(0.02)
    rig.snapshot = msgspec.structs.replace(rig.snapshot, is_position_known=False)
    rig.run(4.0)
    assert not rig.order("takeoff", height_m=1.0).is_accepted
    assert any("PX4 has no local position" in one for one in rig.core.preflight.not_ready)

    rig.snapshot = msgspec.structs.replace(rig.snapshot, is_position_known=True)
    rig.run(4.0)
    assert rig.order("takeoff", height_m=1.0).is_accepted


def test_nonsense_is_no_accuracy() -> None:
    for told, is_taken_for in (
        (math.nan, math.inf),
        (math.inf, math.inf),
        (-1.0, math.inf),
        (None, math.inf),
        (0.3, 0.3),
    ):
        fields = {**_status(), "pos_horiz_accuracy": told, "pos_vert_accuracy": 0.4}
        taken = PARSERS["ESTIMATOR_STATUS"](fields, 5)
        assert taken["position_accuracy_m"] == is_taken_for
        assert taken["height_accuracy_m"] == 0.4

        fields = {**_status(), "pos_vert_accuracy": told}
        assert PARSERS["ESTIMATOR_STATUS"](fields, 5)["height_accuracy_m"] == is_taken_for


def test_an_accuracy_that_px4_stops_telling_is_none() -> None:
    rig = _rig(0.4)
    rig.fly()
    rig.sends_accuracy = False
    rig.run(4.0)
    assert rig.core.flight.state == "flying"
    rig.run(3.0)
    assert rig.core.flight.state == "landing"
    assert any("does not say how accurate" in event.sentence for event in rig.events)
    rig.until("landed")


@pytest.mark.failsafe("satellites lost", step="flying")
def test_without_satellites_it_comes_down_by_dead_reckoning_not_after_a_position_running_away() -> (
    None
):
    rig = _rig(0.4)
    rig.fly()
    rig.has_fix = False
    rig.run(0.4)
    rig.has_fix = True
    rig.run(1.0)
    assert rig.core.flight.state == "flying"  # a moment is none
    rig.has_fix = False
    rig.run(0.8)
    assert rig.core.flight.step is FlightStep.SINKING
    assert "satellites-lost" in {event.code for event in rig.events}
    assert rig.core.own.is_dead_reckoned
    rig.until("landed")


@pytest.mark.failsafe("own position lost", step="flying")
def test_a_position_that_px4_only_dead_reckons_is_not_used() -> None:
    """PX4 sends positions for 5 s after its last source, up to a metre wrong."""
    rig = _rig(0.4)
    rig.fly()
    rig.snapshot = msgspec.structs.replace(rig.snapshot, is_position_known=False)
    rig.run(0.3)
    assert rig.core.own.is_dead_reckoned
    rig.run(0.6)
    assert rig.core.flight.step is FlightStep.SINKING
    rig.until("landed")


@pytest.mark.failsafe("own position lost", step="flying")
def test_a_position_that_contradicts_what_px4_feels_is_not_used() -> None:
    """PX4's estimate follows a camera that repeats itself, and seems to stand."""
    rig = _rig(0.02, "vision")
    rig.fly()
    rig.snapshot = msgspec.structs.replace(rig.snapshot, position_ratio=0.6)
    rig.run(0.5)
    assert rig.core.own.is_dead_reckoned
    rig.run(0.6)
    assert rig.core.flight.step is FlightStep.SINKING
    rig.until("landed")


def test_without_satellites_its_height_is_still_px4s_and_the_thrust_ends_on_the_ground() -> None:
    """An updraft that nobody knows makes the vehicle sink slower than dead reckoning believes."""

    def updraft() -> None:
        rig.velocity[2] += 0.02 * 0.8

    rig = _rig(0.4)
    rig.fly()
    rig.has_fix = False
    rig.after_move = updraft
    fastest_m_s = 0.0
    while rig.core.flight.state != "landed":
        if rig.position[2] > 0.02:
            fastest_m_s = max(fastest_m_s, -float(rig.velocity[2]))
        rig.run(0.02)
    assert fastest_m_s < 1.2


def test_who_never_had_a_fix_knows_its_position_otherwise() -> None:
    rig = _rig(0.4)
    rig.has_fix = False
    rig.fly()
    rig.run(2.0)
    assert rig.core.flight.state == "flying"


def test_a_position_that_px4_itself_gives_up_is_left_to_px4() -> None:
    rig = _rig(0.4)
    rig.fly()
    _tell(rig, 5.0)
    rig.run(0.8)
    assert rig.core.flight.step is FlightStep.PX4_LANDING
    assert any("PX4 says 5.0 m" in event.sentence for event in rig.events)
    rig.until("landed")


def test_who_stands_already_is_not_handed_to_px4_which_would_lift_it_off() -> None:
    rig = _rig(0.4)
    rig.fly()
    rig.has_fix = False
    while rig.core.flight.step is not FlightStep.CONTACT:
        rig.run(0.02)
    _tell(rig, 5.0)
    steps = set()
    while rig.core.flight.state != "landed":
        rig.run(0.02)
        steps.add(rig.core.flight.step)
    assert FlightStep.PX4_LANDING not in steps


@pytest.mark.parametrize("heading_ratio", [0.3, 1.4, math.nan])
def test_a_vehicle_whose_px4_does_not_use_its_cameras_heading_does_not_take_off(
    heading_ratio: float,
) -> None:
    rig = _rig(0.02, "vision")
    rig.snapshot = msgspec.structs.replace(rig.snapshot, heading_ratio=heading_ratio)
    rig.run(4.0)
    assert not rig.order("takeoff", height_m=1.0).is_accepted
    assert any("heading of its camera" in one for one in rig.core.preflight.not_ready)

    rig.snapshot = msgspec.structs.replace(rig.snapshot, heading_ratio=0.05)
    rig.run(4.0)
    assert rig.order("takeoff", height_m=1.0).is_accepted


def test_a_heading_by_a_compass_says_nothing_about_a_camera() -> None:
    """A camera that knows no heading flies with a compass, which differs by more."""
    rig = _rig(0.02, "vision", {"EKF2_EV_CTRL": 3})
    rig.snapshot = msgspec.structs.replace(rig.snapshot, heading_ratio=0.7)
    rig.run(4.0)
    assert rig.order("takeoff", height_m=1.0).is_accepted


@pytest.mark.parametrize(
    ("px4_version", "noise_rad", "heading_ratio"),
    [
        ("1.16", 0.1, 0.2),
        ("1.16", 0.3, 0.12),
        ("1.16", -0.1, 6.0),
        ("1.18", 0.1, 0.62),
        ("1.18", 0.5, 0.13),
        ("1.18", 0.0, 6.0),
    ],
)
def test_the_same_turn_is_noticed_whatever_noise_px4_counts_on(
    px4_version: str, noise_rad: float, heading_ratio: float
) -> None:
    """PX4 compares with 2.6 times the noise, or before v1.18 times its root; 0.01 at least."""
    for ratio, is_turned in ((heading_ratio, True), (0.8 * heading_ratio, False)):
        rig = _rig(0.02, "vision", {"EKF2_EVA_NOISE": noise_rad}, px4_version=px4_version)
        rig.snapshot = msgspec.structs.replace(rig.snapshot, heading_ratio=ratio)
        rig.run(1.0)
        assert rig.core.own.has_turned_camera(rig.snapshot) is is_turned
