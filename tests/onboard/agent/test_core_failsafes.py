"""Each thing that can go wrong in flight, injected into the core, and what it must do then."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from onboard import agent_commands, agent_inputs
from onboard.agent.core import AgentCore
from onboard.autopilot import Landed
from onboard.estimation import wind
from onboard.flight.types import FlightStep
from onboard.supervision.condition_table import BUS_LOST_S
from onboard.types import AttitudeSetpoint
from tests.onboard.agent.rig import HOVER, Rig, fleet, hovering_rig, ready_rig


def _setpoints(rig: Rig, since_ns: int) -> list[tuple[int, AttitudeSetpoint]]:
    return [
        (t, c.setpoint)
        for t, c in rig.sent
        if isinstance(c, agent_commands.SendAttitude) and t > since_ns
    ]


@pytest.mark.failsafe("own position stale", step="flying")
def test_a_short_gap_of_the_mocap_is_flown_through() -> None:
    rig = hovering_rig()
    rig.has_mocap = False
    rig.run(0.15)
    rig.has_mocap = True
    rig.run(1.0)
    assert rig.core.flight.state == "flying"
    assert not any(event.severity == "critical" for event in rig.events)


@pytest.mark.failsafe("PX4 left OFFBOARD", step="flying")
@pytest.mark.parametrize("mode", ["HOLD", "POSCTL", "LAND", "RTL"])
def test_when_px4_leaves_offboard_the_agent_is_silent_and_says_who_flies(mode: str) -> None:
    rig = hovering_rig()
    rig.mode = mode
    rig.run(1.2)
    told_ns = rig.now_ns
    rig.run(2.0)
    assert rig.count(agent_commands.SendAttitude, told_ns) == 0
    assert mode in rig.core.flight.reason or rig.core.flight.state == "landed"
    assert rig.core.flight.state in ("failed", "landed")
    assert not rig.order("move", position_enu_m=(1.0, 0.0, 1.0)).is_accepted


@pytest.mark.failsafe("PX4 silent", step="flying")
def test_a_silent_px4_means_silence_and_failed_within_half_a_second() -> None:
    rig = hovering_rig()
    rig.has_autopilot = False
    lost_ns = rig.now_ns
    rig.run(2.0)
    assert rig.core.flight.state == "failed"
    assert _setpoints(rig, lost_ns)[-1][0] - lost_ns <= 480_000_000


@pytest.mark.failsafe("bus lost", step="flying")
@pytest.mark.failsafe("bus lost for long", step="flying")
def test_a_lost_bus_holds_and_then_lands_in_place() -> None:
    rig = hovering_rig()
    rig.order("move", position_enu_m=(-3.0, 0.0, 1.0))
    rig.run(1.5)
    rig.core.handle(agent_inputs.NodeChanged("ground-1", False), rig.now_ns)
    rig.has_bus = False
    rig.run(BUS_LOST_S + 0.5)
    assert rig.core.flight.state == "holding"
    where = rig.position.copy()
    rig.run(6.0)
    assert rig.core.flight.state in ("landing", "landed")
    # it still came to rest when this was looked at
    assert np.linalg.norm(rig.position[:2] - where[:2]) < 0.5


@pytest.mark.failsafe("ground station lost", step="flying")
def test_a_lost_ground_station_changes_nothing_in_flight() -> None:
    rig = hovering_rig()
    reply = rig.order("move", position_enu_m=(1.0, 0.0, 1.0))
    rig.core.handle(agent_inputs.NodeChanged("ground-1", False), rig.now_ns)
    rig.run(8.0)
    assert rig.outcomes()[reply.order_id] == "done"
    assert rig.core.flight.state == "flying"


@pytest.mark.failsafe("ground station lost for long", step="flying")
def test_when_nobody_is_there_to_order_for_long_it_lands_and_a_watcher_does_not_count() -> None:
    rig = Rig(AgentCore(fleet(ground_lost_land_s=6.0), "mav0", boot_id=7))
    rig.fly()
    rig.core.handle(agent_inputs.NodeChanged("ground-2", True), rig.now_ns)
    rig.core.handle(agent_inputs.NodeChanged("watcher-1", True), rig.now_ns)
    rig.core.handle(agent_inputs.NodeChanged("ground-1", False), rig.now_ns)
    rig.run(7.0)
    assert rig.core.flight.state == "flying"  # another ground is there
    rig.core.handle(agent_inputs.NodeChanged("ground-2", False), rig.now_ns)
    rig.run(2.5)
    rig.core.handle(
        agent_inputs.NodeChanged("ground-1", True), rig.now_ns
    )  # it was stopped for that long
    rig.run(1.0)
    rig.core.handle(agent_inputs.NodeChanged("ground-1", False), rig.now_ns)
    rig.run(5.5)
    assert rig.core.flight.state == "flying"
    rig.run(1.0)
    assert rig.core.flight.step is FlightStep.DESCENT
    assert rig.core.flight.reason == "Ground station lost for long: landing."
    rig.until("landed")
    assert rig.count(agent_commands.Px4Land) == 0


def _starting(step: FlightStep) -> Rig:
    rig = ready_rig()
    rig.order("arm" if step is FlightStep.ARMED else "takeoff")
    while rig.core.flight.step is not step:
        rig.step()
    return rig


@pytest.mark.failsafe("ground station lost", step="lifting off")
@pytest.mark.failsafe("ground station lost", step="armed on the ground")
@pytest.mark.parametrize(
    "step",
    [FlightStep.TAKEOFF_OFFBOARD, FlightStep.TAKEOFF_ARMING, FlightStep.ARMED, FlightStep.LIFTOFF],
)
def test_no_start_is_completed_without_anybody(step: FlightStep) -> None:
    rig = _starting(step)
    rig.core.handle(agent_inputs.NodeChanged("ground-1", False), rig.now_ns)
    highest_m = 0.0
    for _ in range(500):
        rig.step()
        highest_m = max(highest_m, rig.position[2])
    assert not rig.is_armed
    assert highest_m < (0.5 if step is FlightStep.LIFTOFF else 0.01)
    assert any(event.code == "ground-lost" for event in rig.events)


@pytest.mark.failsafe("own position jumped", step="armed on the ground")
@pytest.mark.parametrize(
    "step", [FlightStep.TAKEOFF_OFFBOARD, FlightStep.TAKEOFF_ARMING, FlightStep.ARMED]
)
def test_no_start_is_completed_with_a_position_that_has_jumped(step: FlightStep) -> None:
    rig = _starting(step)
    rig.position += (1.0, -0.8, 0.0)
    rig.run(10.0)
    assert not rig.is_armed
    assert rig.position[2] < 0.01
    assert any(event.code == "position-jumped" for event in rig.events)


@pytest.mark.failsafe("neighbour with another fleet file or law", step="flying")
def test_a_neighbour_under_another_law_is_not_counted_on_and_passed_slowly() -> None:
    rig = hovering_rig()
    rig.order("move", position_enu_m=(-3.0, 0.0, 1.0))
    neighbours = rig.core.neighbours
    fleet = rig.core.fleet
    assert fleet.with_law("covey").config_hash == fleet.config_hash
    for law in ("covey", "off", "covey"):
        for number in range(20):
            assert rig.state is not None
            assert rig.telemetry is not None
            same = {"vehicle": "mav1", "boot_id": 9, "position_enu_m": (3.0, 3.0, 1.0)}
            tells = {
                "config_hash": fleet.with_law(law).config_hash,
                "law": law,
                "goal_position_enu_m": (3.0, 3.0, 1.0),
            }
            state = replace(
                rig.state, is_cooperative=True, predicted_position_enu_m=(3.0, 3.0, 1.0), **same
            )
            for message in (state, replace(rig.telemetry, **same, **tells)):
                rig.core.handle(agent_inputs.NeighbourReceived(message, rig.now_ns), rig.now_ns)
            if number > 8:
                (neighbour,) = neighbours.snapshot(rig.now_ns)
                assert neighbour.is_cooperative is (law == "covey"), (law, number)
            rig.step()
        assert rig.core.flight.is_slow or law == "covey"
    assert [event.sentence for event in rig.events if event.code == "config-differs"] == [
        "Neighbour with another fleet file or law (mav1): flying slowly."
    ]


@pytest.mark.failsafe("battery not told", step="flying")
def test_a_battery_that_is_not_told_any_more_lands_after_ten_seconds() -> None:
    rig = hovering_rig()
    rig.sends_battery = False
    rig.run(9.0)
    assert rig.core.flight.state == "flying"
    rig.run(1.5)
    assert rig.core.flight.reason == "Battery not told: landing."
    rig.until("landed")


@pytest.mark.failsafe("PX4 does not tell whether it is on the ground", step="flying")
def test_a_flight_without_landed_states_is_said_and_its_landing_ends_when_px4_is_disarmed() -> None:
    rig = hovering_rig()
    rig.has_landed_reports = False
    reply = rig.order("move", position_enu_m=(0.5, 0.0, 1.0))
    rig.run(5.0)
    assert rig.outcomes()[reply.order_id] == "done"
    assert "landed-unknown" in {event.code for event in rig.events}
    landing = rig.order("land")
    rig.until("landed")
    assert rig.outcomes()[landing.order_id] == "done"
    assert rig.count(agent_commands.Px4Land) == 0


@pytest.mark.failsafe("PX4 reports the ground in flight", step="flying")
def test_a_px4_that_reports_the_ground_in_flight_is_landed_before_it_disarms() -> None:
    rig = hovering_rig()
    rig.landed_report = Landed.ON_GROUND
    rig.run(0.4)
    rig.landed_report = None
    rig.run(1.0)
    assert rig.core.flight.state == "flying"
    rig.landed_report = Landed.ON_GROUND
    rig.run(0.6)
    assert rig.core.flight.reason == "PX4 reports the ground in flight: landing."


@pytest.mark.failsafe("battery at the landing level", step="flying")
def test_a_low_battery_lands() -> None:
    rig = hovering_rig()
    rig.battery_frac = 0.19
    rig.run(0.5)
    assert rig.core.flight.state == "landing"
    rig.until("landed")
    assert any("Battery" in event.sentence for event in rig.events)


@pytest.mark.parametrize("thrust_of_hover", [1.05, 0.9])
def test_a_landing_that_rises_again_or_that_px4_does_not_see_is_left_to_px4(
    thrust_of_hover: float,
) -> None:
    rig = hovering_rig()
    rig.order("land")
    while rig.core.flight.step is not FlightStep.CONTACT:
        rig.step()
    rig.obeys = False
    assert rig.setpoint is not None
    rig.setpoint = AttitudeSetpoint(rig.setpoint.quaternion_wxyz, thrust_of_hover * HOVER)
    rig.sees_ground = False
    rig.run(9.0)
    assert rig.mode == "LAND"
    assert any(
        "risen" in event.sentence or "does not see" in event.sentence for event in rig.events
    )
    rig.sees_ground = True
    rig.until("landed")


@pytest.mark.parametrize("ticks_after_heartbeat", range(1, 50, 8))
@pytest.mark.parametrize("is_taken", [True, False])
def test_a_vehicle_that_another_mode_leans_is_not_landed_before_px4_tells_the_mode(
    ticks_after_heartbeat: int, is_taken: bool
) -> None:
    rig = hovering_rig()
    beat_ns = rig.snapshot.heartbeat_ns
    while rig.snapshot.heartbeat_ns == beat_ns:
        rig.step()
    rig.run(0.02 * ticks_after_heartbeat)

    rig.obeys = False
    assert rig.setpoint is not None
    half_rad = 0.5 * math.radians(15.0)
    leaned = (math.cos(half_rad), 0.0, math.sin(half_rad), 0.0)
    rig.setpoint = AttitudeSetpoint(leaned, HOVER)
    if is_taken:
        rig.mode = "HOLD"  # by somebody without sticks
    rig.run(0.5)
    assert rig.mode == ("HOLD" if is_taken else "LAND")
    rig.run(1.2)
    assert rig.mode == ("HOLD" if is_taken else "LAND")


@pytest.mark.failsafe("geofence crossed", step="flying")
@pytest.mark.failsafe("geofence crossed for long", step="flying")
def test_outside_the_fence_it_holds_inside_and_then_lands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # what carries it looks like a gust, for which it would land
    monkeypatch.setattr(wind, "step", lambda memory, *_: memory)
    rig = hovering_rig()
    rig.carry(4.1, 0.0, 1.0)
    assert rig.core.flight.state == "holding"
    assert rig.core.flight.goal_position_enu_m[0] < 4.0

    def is_blown_outside() -> None:
        rig.position[0] = 4.1
        rig.velocity[0] = 0.0

    rig.after_move = is_blown_outside
    rig.run(2.5)
    assert rig.core.flight.state == "landing"
    assert rig.core.flight.reason == "Geofence crossed for long: landing."


def test_nobody_is_sent_anywhere_while_the_table_asks_to_hold_and_anywhere_again_afterwards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # what carries it looks like a gust, for which it would land
    monkeypatch.setattr(wind, "step", lambda memory, *_: memory)
    rig = hovering_rig()
    rig.carry(4.1, 0.0, 1.0)
    answer = rig.order("move", position_enu_m=(1.0, 0.0, 1.0))
    assert not answer.is_accepted
    assert "Geofence crossed" in answer.reason
    assert "Order it again" in answer.reason
    assert rig.core.flight.state == "holding"
    rig.carry(3.0, 0.0, 1.0)
    rig.run(0.5)
    assert rig.order("move", position_enu_m=(1.0, 0.0, 1.0)).is_accepted


@pytest.mark.failsafe("loop stalled", step="flying")
@pytest.mark.failsafe("loop stalled for long", step="flying")
def test_a_stalled_loop_holds_and_a_long_one_leaves_the_landing_to_px4() -> None:
    rig = hovering_rig()
    rig.now_ns += 250_000_000
    rig.step()
    assert rig.core.flight.state == "holding"
    rig.run(1.0)
    rig.now_ns += 1_500_000_000
    rig.step()
    stalled_ns = rig.now_ns
    rig.run(0.5)
    assert rig.core.flight.state == "landing"
    assert rig.count(agent_commands.SendAttitude, stalled_ns) == 0


@pytest.mark.parametrize(
    "changes",
    [
        {"position_enu_m": (math.nan, 0.0, 1.0)},
        {"position_enu_m": (1e300, 0.0, 1.0)},
        {"position_enu_m": (0.0, math.inf, 1.0)},
        {"quaternion_enu_flu_wxyz": (0.0, 0.0, 0.0, 0.0)},
        {"quaternion_enu_flu_wxyz": (math.nan, 0.0, 0.0, 0.0)},
        {"sequence": 1},
        {"stamp_ns": 10**18},
        {"is_tracked": False, "position_enu_m": (9.0, 9.0, 9.0)},
        {"body": "mav1", "position_enu_m": (9.0, 9.0, 0.0)},
        {"body": "somebody", "position_enu_m": (9.0, 9.0, 9.0)},
        {"sequence": 2**60, "position_enu_m": (2.0, 2.0, 2.0)},
        {"sequence": 2**60},
        {"boot_id": 2, "sequence": 2**60},
    ],
)
def test_a_bad_mocap_sample_between_good_ones_moves_nothing(changes: dict[str, object]) -> None:
    rig = hovering_rig()
    before = rig.position.copy()
    for _ in range(5):
        rig.pose(**changes)
        rig.step()
    rig.run(1.0)
    assert rig.core.flight.state == "flying"
    assert rig.position == pytest.approx(before, abs=0.05)


def test_an_exception_in_ticks_is_told_and_the_next_tick_levels_nothing_on_the_ground() -> None:
    rig = ready_rig()
    rig.core.handle(agent_inputs.TickFailed("Internal error: test."), rig.now_ns)
    rig.run(0.1)
    assert any(event.code == "tick-failed" for event in rig.events)
    assert rig.count(agent_commands.SendAttitude) == 0


def test_every_setpoint_of_a_flight_with_everything_going_wrong_is_finite_and_bounded() -> None:
    rig = hovering_rig()
    rig.order("move", position_enu_m=(3.5, 3.5, 2.5))
    rng = np.random.default_rng(3)
    for _ in range(500):
        rig.has_mocap = bool(rng.random() > 0.3)
        rig.heading_error_rad += float(rng.normal(0.0, 0.02))
        rig.step()
    tilt_cos = math.cos(math.radians(rig.core.vehicle.max_tilt_deg + 1.0))
    for _, setpoint in _setpoints(rig, 0):
        q = np.asarray(setpoint.quaternion_wxyz)
        assert np.isfinite(q).all()
        assert 0.0 <= float(setpoint.thrust_frac) <= 1.0
        assert 1.0 - 2.0 * (q[1] ** 2 + q[2] ** 2) >= tilt_cos


@pytest.mark.failsafe("on the ground though it should fly", step="flying")
def test_a_vehicle_that_fell_stops_thrusting_instead_of_flying_on_from_the_ground() -> None:
    rig = hovering_rig()
    rig.has_lift = False
    rig.run(3.0)
    assert rig.position[2] == 0.0
    quiet_ns = rig.now_ns
    rig.run(1.0)
    assert rig.count(agent_commands.SendAttitude, quiet_ns) == 0
    assert rig.core.flight.state in ("failed", "landed")
    assert any(event.severity == "critical" for event in rig.events)


def test_below_the_fleets_origin_a_flight_above_a_lower_ground_is_no_fall() -> None:
    config = fleet()
    fence = replace(config.fleet.geofence_m, z=(-1.5, 3.0))
    start = replace(config.vehicles["mav0"], start_enu_m=(0.0, 0.0, -1.0))
    lower = replace(
        config,
        vehicles={**config.vehicles, "mav0": start},
        fleet=replace(config.fleet, geofence_m=fence),
    )
    core = AgentCore(lower, "mav0", boot_id=7)
    rig = Rig(core=core, floor_m=-1.0, position=np.array([0.0, 0.0, -1.0]))
    rig.until("ready")
    assert rig.order("takeoff", order_id="up", height_m=0.0).is_accepted
    rig.run(8.0)
    assert rig.outcomes()["up"] == "done"
    assert rig.core.flight.step is FlightStep.ARRIVED
    assert rig.position[2] == pytest.approx(0.0, abs=0.05)


def test_a_vehicle_that_px4_lands_is_in_the_air_until_a_new_report_of_the_ground() -> None:
    """PX4's reports of the ground stopped before the lift-off; later PX4 lands by itself."""
    rig = ready_rig()
    rig.order("arm")
    rig.until("armed")
    rig.has_landed_reports = False
    rig.order("takeoff", height_m=1.0)
    rig.run(8.0)
    rig.mode = "LAND"
    rig.run(2.0)
    assert not rig.core.flight.step.is_under_law
    assert rig.position[2] > 0.3
    assert rig.state is not None
    assert rig.state.is_airborne
    assert rig.telemetry is not None
    assert rig.telemetry.is_airborne


def test_setpoints_that_are_too_old_to_be_sent_count_as_not_sent() -> None:
    """Each tick takes too long for 0.4 s: PX4 has begun to land, and is left to it."""
    rig = hovering_rig()
    for _ in range(20):
        rig.run(0.02)
        rig.core.handle(agent_inputs.SetpointDropped(), rig.now_ns)
    assert rig.core.flight.step is FlightStep.PX4_LANDING
    assert any(event.code == "setpoints-interrupted" for event in rig.events)


def test_a_single_setpoint_that_is_too_old_changes_nothing() -> None:
    rig = hovering_rig()
    rig.core.handle(agent_inputs.SetpointDropped(), rig.now_ns)
    rig.run(1.0)
    assert rig.core.flight.state == "flying"
