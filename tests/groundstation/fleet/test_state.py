"""The fold from messages to the fleet's state."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from groundstation.fleet.state import (
    DIRECT_DISARMED,
    MAX_EVENTS,
    NodeSeen,
    NotUsed,
    fold,
    fold_batch,
    fold_nodes,
    fold_telemetry,
    initial,
)
from onboard.bus.codec import Malformed
from onboard.bus.schema import Event, PreflightReport, Truth
from onboard.config.fleet import FleetConfig
from onboard.message_counts import in_words

SECOND = 1_000_000_000


def truth(
    vehicle: str, stamp_ns: int, x: float, *, on_ground: bool = False, speed: float = 0.0
) -> Truth:
    return Truth(
        vehicle=vehicle,
        stamp_ns=stamp_ns,
        position_enu_m=(x, 0.0, 1.0),
        velocity_enu_m_s=(speed, 0.0, 0.0),
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
        is_on_ground=on_ground,
        is_collided=False,
    )


def test_silence_ages_telemetry_until_it_is_no_longer_fresh(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    view = fold(initial(fleet), make_telemetry("mav0"), 0).vehicles["mav0"]
    assert view.is_fresh(SECOND)
    assert not view.is_fresh(SECOND + 1)
    assert view.age_s(3 * SECOND) == pytest.approx(3.0)
    assert view.position_enu_m(2 * SECOND) is None
    assert initial(fleet).vehicles["mav0"].age_s(0) == math.inf


def test_old_and_repeated_samples_change_nothing_but_a_new_boot_starts_over(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    state = fold(initial(fleet), make_telemetry("mav0", sequence=7, mode="NEW"), 0)
    for sequence in (7, 6):
        late = fold(state, make_telemetry("mav0", sequence=sequence, mode="OLD"), 1)
        assert (late.vehicles, late.late) == (state.vehicles, state.late + 1)
    again = fold(state, make_telemetry("mav0", boot_id=2, sequence=1, mode="REBORN"), 1)
    reborn = again.vehicles["mav0"].telemetry
    assert reborn is not None
    assert reborn.mode == "REBORN"


def test_one_false_number_excludes_no_telemetry_after_it(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    state = fold(initial(fleet), make_telemetry("mav0", sequence=2**60, mode="FALSE"), 0)
    state = fold(state, make_telemetry("mav0", sequence=8, mode="TRUE"), 1)
    believed = state.vehicles["mav0"].telemetry
    assert believed is not None
    assert believed.mode == "TRUE"


def test_the_closest_pair_is_found_from_fresh_and_valid_positions_only(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    state = initial(fleet)
    for name, x, valid in (("mav0", 0.0, True), ("mav1", 2.0, True), ("mav2", 0.1, False)):
        state = fold(
            state, make_telemetry(name, position_enu_m=(x, 0.0, 1.0), is_position_valid=valid), 0
        )
    closest = state.closest(0)
    assert closest is not None
    assert (closest.first, closest.second, closest.distance_m) == (
        "mav0",
        "mav1",
        pytest.approx(2.0),
    )
    assert state.closest(5 * SECOND) is None


def test_a_pair_on_the_ground_is_the_closest_one_only_while_nobody_flies(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    state = initial(fleet)
    for name, x_m in (("mav0", 0.0), ("mav1", 0.5), ("mav2", 2.0)):
        state = fold(state, make_telemetry(name, position_enu_m=(x_m, 0.0, 0.0)), 0)
    standing = state.closest(0)
    assert standing is not None
    assert (standing.first, standing.second, standing.is_flying) == ("mav0", "mav1", False)

    above = make_telemetry("mav2", position_enu_m=(2.0, 0.0, 1.0), is_airborne=True, sequence=9)
    flying = fold(state, above, 0).closest(0)
    assert flying is not None
    assert (flying.first, flying.second, flying.is_flying) == ("mav1", "mav2", True)


def test_positions_are_carried_on_with_their_velocity(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    state = fold(initial(fleet), make_telemetry("mav0", velocity_enu_m_s=(1.0, 0.0, 0.0)), 0)
    assert state.vehicles["mav0"].position_enu_m(SECOND // 2) == pytest.approx((0.5, 0.0, 0.0))


def test_the_smallest_separation_counts_only_while_somebody_flies(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    state = initial(fleet)
    state = fold(state, make_telemetry("mav0", position_enu_m=(0.0, 0.0, 0.0)), 0)
    state = fold(state, make_telemetry("mav1", position_enu_m=(0.3, 0.0, 0.0)), 0)
    assert state.smallest is None
    state = fold(
        state,
        make_telemetry("mav1", sequence=2, position_enu_m=(0.9, 0.0, 1.0), is_airborne=True),
        1,
    )
    state = fold(
        state,
        make_telemetry("mav1", sequence=3, position_enu_m=(2.0, 0.0, 1.0), is_airborne=True),
        2,
    )
    assert state.smallest is not None
    assert state.smallest.distance_m == pytest.approx(0.9)


def test_telemetry_that_waited_together_is_compared_as_if_it_had_come_one_by_one(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    heard = [
        (make_telemetry(name, sequence=step, position_enu_m=(x, 0.0, 1.0), is_airborne=True), step)
        for step, places in enumerate(
            ((0.0, 3.0, 6.0), (0.0, 0.4, 6.0), (0.0, 3.0, math.nan)), start=1
        )
        for name, x in zip(("mav0", "mav1", "mav2"), places, strict=True)
    ]
    state = fold_telemetry(initial(fleet), heard)
    assert state.smallest is not None
    assert (state.smallest.first, state.smallest.second) == ("mav0", "mav1")
    # they were that near between other messages
    assert state.smallest.distance_m == pytest.approx(0.4)
    one_by_one = initial(fleet)
    for message, received_ns in heard:
        one_by_one = fold(one_by_one, message, received_ns)
    assert (state.vehicles, state.malformed) == (one_by_one.vehicles, one_by_one.malformed)
    assert state.malformed == 1


def test_truth_of_two_vehicles_is_compared_at_one_moment(fleet: FleetConfig) -> None:
    state = fold(initial(fleet), truth("mav0", 0, 0.0, speed=1.0), 0)
    state = fold(state, truth("mav1", SECOND // 2, 2.0), SECOND // 2)
    assert state.smallest_truth is not None
    assert state.smallest_truth.distance_m == pytest.approx(1.5)
    assert state.smallest_truth.is_truth
    grounded = fold(
        fold(initial(fleet), truth("mav0", 0, 0.0, on_ground=True), 0),
        truth("mav1", 0, 0.1, on_ground=True),
        0,
    )
    assert grounded.smallest_truth is None


def test_numbers_that_are_not_finite_are_counted_and_never_become_a_position(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    state = fold(initial(fleet), make_telemetry("mav0", position_enu_m=(math.nan, 0.0, 0.0)), 0)
    assert state.malformed == 1
    assert state.vehicles["mav0"].position_enu_m(0) is None
    assert fold(state, truth("mav0", 0, math.inf), 0).vehicles["mav0"].truth is None
    assert fold_batch(state, [(Malformed("garbage", 0), 1)], 1).malformed == 2
    counted = fold_batch(state, [(NotUsed(refused=2), 1), (NotUsed(dropped=3), 2)], 2)
    assert in_words(counted.malformed, counted.refused, counted.dropped, counted.late) == (
        "1 malformed, 2 refused, 3 dropped"
    )


def test_events_stay_bounded(fleet: FleetConfig) -> None:
    state = initial(fleet)
    for count in range(MAX_EVENTS + 50):
        state = fold(
            state,
            Event(vehicle="mav0", stamp_ns=0, severity="info", code="x", sentence=str(count)),
            count,
        )
    assert len(state.events) == MAX_EVENTS
    assert state.events[-1].event.sentence == str(MAX_EVENTS + 49)


def test_a_liveliness_token_says_who_is_there(fleet: FleetConfig) -> None:
    state = fold_nodes(initial(fleet), [NodeSeen("mav1", True), NodeSeen("sitl", True)])
    assert state.vehicles["mav1"].is_alive
    assert state.nodes == {"mav1", "sitl"}
    assert not fold_nodes(state, [NodeSeen("mav1", False)]).vehicles["mav1"].is_alive


def test_the_newest_preflight_report_is_kept_and_says_go_only_while_nothing_refuses(
    fleet: FleetConfig,
) -> None:
    def report(sequence: int, is_ok: bool) -> PreflightReport:
        checks = (("battery", is_ok, "Battery at 40 %.", "" if is_ok else "Charge it."),)
        return PreflightReport(
            vehicle="mav0", boot_id=1, sequence=sequence, stamp_ns=0, checks=checks
        )

    state = fold(fold(initial(fleet), report(2, False), 0), report(1, True), SECOND)
    view = state.vehicles["mav0"]
    assert view.preflight is not None
    assert not view.preflight.is_go
    assert view.has_preflight(SECOND)
    assert not view.has_preflight(10 * SECOND)
    view = fold(state, report(3, True), SECOND).vehicles["mav0"]
    assert view.preflight is not None
    assert view.preflight.is_go


def test_px4_s_own_word_on_the_direct_way_counts_until_the_agent_speaks_again(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    state = fold(
        initial(fleet), make_telemetry("mav1", sequence=1, is_airborne=True, is_armed=True), 0
    )
    assert state.airborne_names == ("mav1",)
    told = Event(stamp_ns=0, severity="warning", code=DIRECT_DISARMED, sentence="", vehicle="mav1")
    state = fold(state, told, 5 * SECOND)
    assert state.airborne_names == ()

    # the agent repeats the last report of a PX4 that it has not heard for three seconds
    flying = make_telemetry("mav1", sequence=2, is_airborne=True, is_armed=True)
    state = fold(state, msgspec.structs.replace(flying, autopilot_age_s=3.0), 6 * SECOND)
    assert state.airborne_names == ()
    assert state.is_landed("mav1")

    state = fold(
        state, msgspec.structs.replace(flying, sequence=3, autopilot_age_s=0.1), 7 * SECOND
    )
    assert state.airborne_names == ("mav1",)
    assert not state.is_landed("mav1")
