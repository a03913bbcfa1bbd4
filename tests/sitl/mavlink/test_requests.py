"""What clients ask for beyond flying: messages, events, ground truth, and all that is refused
cleanly.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sitl.emulator.emulator import Emulator
from sitl.mavlink.codec import ID_BY_NAME, Encoder
from sitl.mavlink.streams import GCS_RATES_HZ
from sitl.px4.arming_checks import BOOT_S
from sitl.px4.journal import event_id
from sitl.px4.modes import Mode
from tests.sitl.sitl_flying import Client, emulator, run_for, until

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
ZURICH_DEG = {"latitude": 473977420, "longitude": 85455940}  # times 1e7, as in messages


def test_events_go_to_every_link_and_are_sent_again_on_request() -> None:
    emu = emulator()
    client = Client(emu)
    client.command(400, 1)
    (event,) = [m for m in client.collect(0.1) if m.name == "EVENT"]
    assert event.fields["id"] == event_id("commander_arm_denied_resolve_failures")
    assert event.fields["log_levels"] == 0x62
    (again,) = client.send(
        "REQUEST_EVENT", first_sequence=1, last_sequence=1, target_system=1, target_component=1
    )
    assert again.fields == event.fields
    (error,) = client.send(
        "REQUEST_EVENT", first_sequence=7, last_sequence=9, target_system=1, target_component=1
    )
    assert error.name == "RESPONSE_EVENT_ERROR"
    (count,) = client.send("COMMAND_LONG", command=512, target_system=1, param1=411.0)[1:]
    assert count.fields["sequence"] == 1


def test_the_origin_is_sent_once_when_it_is_known_and_again_on_request() -> None:
    emu = emulator()
    client = Client(emu)
    told = [m for m in client.collect(8.0) if m.name == "GPS_GLOBAL_ORIGIN"]
    assert len(told) == 1
    answers = client.send("COMMAND_LONG", command=512, target_system=1, param1=49.0)
    assert [m.name for m in answers] == ["COMMAND_ACK", "GPS_GLOBAL_ORIGIN"]


def test_streams_start_before_the_first_heartbeat_and_home_follows_the_satellites() -> None:
    emu = emulator()
    client = Client(emu)
    first: dict[str, float] = {}

    def note() -> None:
        for message in client.collect(0.1):
            first.setdefault(message.name, emu.time_s)

    while emu.time_s < 6.5:
        note()
    assert 0.3 <= first["LOCAL_POSITION_NED"] < 0.6
    assert 1.3 <= first["ATTITUDE"] < 1.6
    assert 1.3 <= first["HEARTBEAT"] < 1.6
    assert first["HOME_POSITION"] >= BOOT_S


def test_a_program_that_waits_for_home_may_arm() -> None:
    emu = emulator()
    client = Client(emu)
    for _ in range(80):
        if any(message.name == "HOME_POSITION" for message in client.collect(0.1)):
            break
    emu.autopilots[0].request(emu.time_s, Mode.LOITER)
    assert client.command(400, 1) == [ACCEPTED]


def test_home_is_where_it_was_armed_and_heights_count_from_there() -> None:
    emu = emulator()
    client = Client(emu)
    client.collect(6.0)
    autopilot = emu.autopilots[0]
    autopilot.request(emu.time_s, Mode.LOITER)
    assert client.command(400, 1) == [ACCEPTED]
    armed_at = autopilot.mode_control.home_ned_m.tolist()
    assert max(abs(c) for c in armed_at) > 0.001
    seen = client.collect(3.0)
    home = [m.fields for m in seen if m.name == "HOME_POSITION"][-1]
    assert [home["x"], home["y"], home["z"]] == pytest.approx(armed_at, abs=1e-5)
    assert home["altitude"] == pytest.approx((489.4 - armed_at[2]) * 1e3, abs=1.0)
    place = [m.fields for m in seen if m.name == "GLOBAL_POSITION_INT"][-1]
    assert place["relative_alt"] == pytest.approx(place["alt"] - home["altitude"], abs=2.0)


def test_home_is_set_by_command_to_the_vehicle_or_to_a_position_that_arming_keeps() -> None:
    emu, client = in_hold()
    pilot = emu.autopilots[0]
    pilot.mode_control.hold_at(np.array([4.0, 0.0, -4.0]))
    run_for(emu, 8.0)
    assert client.command(179, 1, *[math.inf] * 6) == [ACCEPTED]
    here = emu.estimator.local(0).position_ned_m
    assert pilot.mode_control.home_ned_m.tolist() == pytest.approx(list(here), abs=0.01)

    latitude, longitude, altitude_m = client.link.view.to_global((-5.0, 3.0, -1.0))
    answers = client.send(
        "COMMAND_INT",
        command=179,
        target_system=1,
        target_component=1,
        x=round(latitude * 1e7),
        y=round(longitude * 1e7),
        z=altitude_m,
    )
    assert [m.fields["result"] for m in answers] == [ACCEPTED]
    assert client.command(21) == [ACCEPTED]
    until(emu, lambda: not pilot.is_armed, 30.0)
    assert client.command(400, 1) == [ACCEPTED]
    assert pilot.mode_control.home_ned_m.tolist() == pytest.approx([-5.0, 3.0, -1.0], abs=0.1)

    for place in ((math.nan, math.nan, math.nan), (47.0, 8.0, math.nan), (91.0, 8.0, 0.0)):
        assert client.command(179, 0, 0, 0, math.nan, *place) == [2]  # DENIED


def test_both_battery_messages_report_minus_one_ampere() -> None:
    seen = {m.name: m.fields for m in Client(emulator()).collect(3.0)}
    status = seen["SYS_STATUS"]
    assert seen["BATTERY_STATUS"]["current_battery"] == status["current_battery"] == -100
    assert all(
        status[f"onboard_control_sensors_{kind}"] >> 31 for kind in ("present", "enabled", "health")
    )
    assert status["battery_remaining"] == 100
    assert status["voltage_battery"] == 16200


def test_the_date_goes_on_with_the_clock() -> None:
    emu = emulator()
    emu.unix_start_s = 1.8e9
    times = [m.fields for m in Client(emu).collect(4.0) if m.name == "SYSTEM_TIME"]
    assert len(times) >= 3
    for told in times:
        assert told["time_unix_usec"] == pytest.approx(1.8e15 + told["time_boot_ms"] * 1e3, abs=2e3)


def test_rates_reach_px4s_ceilings_and_no_further() -> None:
    client = Client(emulator())
    client.collect(1.0)
    for number in (30, 31, 32, 36):
        assert client.command(511, number, 1000) == [ACCEPTED]
    names = [m.name for m in client.collect(4.0)]
    assert names.count("LOCAL_POSITION_NED") / 4 == pytest.approx(124, abs=3)
    assert names.count("SERVO_OUTPUT_RAW") / 4 == pytest.approx(250, abs=4)
    assert names.count("ATTITUDE") / 4 == pytest.approx(218, abs=4)
    assert names.count("ATTITUDE_QUATERNION") / 4 == pytest.approx(220, abs=4)


@pytest.mark.parametrize(
    "name", ["HIL_STATE_QUATERNION", "ACTUATOR_OUTPUT_STATUS", "HIL_ACTUATOR_CONTROLS"]
)
def test_ground_truth_and_outputs_are_streamed_on_request(name: str) -> None:
    client = Client(emulator())
    assert client.command(511, ID_BY_NAME[name], 10_000) == [ACCEPTED]
    assert [m.name for m in client.collect(1.0)].count(name) == pytest.approx(100, abs=3)


def test_streams_without_data_are_accepted_and_stay_silent() -> None:
    client = Client(emulator())
    assert client.command(511, ID_BY_NAME["RC_CHANNELS"], 100_000) == [ACCEPTED]
    assert "RC_CHANNELS" not in [m.name for m in client.collect(1.0)]


def test_sticks_of_a_joystick_are_streamed_back_while_they_come() -> None:
    emu = emulator()
    client = Client(emu)
    assert client.command(511, ID_BY_NAME["MANUAL_CONTROL"], 200_000) == [ACCEPTED]
    assert "MANUAL_CONTROL" not in [m.name for m in client.collect(1.0)]

    for _ in range(20):
        client.send("MANUAL_CONTROL", target=1, x=100, y=-200, z=500, r=0)
        heard = [m for m in client.collect(0.1) if m.name == "MANUAL_CONTROL"]
    assert heard or [m for m in client.collect(0.2) if m.name == "MANUAL_CONTROL"]
    run_for(emu, 0.6)
    client.collect(0.1)
    assert "MANUAL_CONTROL" not in [m.name for m in client.collect(1.0)]


def test_a_requested_interval_is_that_of_the_stream_and_zero_for_unknown_messages() -> None:
    client = Client(emulator())
    for number, expected in ((32, 33333), (375, -1), (999, 0)):
        answers = client.send("COMMAND_LONG", command=510, target_system=1, param1=float(number))
        assert [m.name for m in answers] == ["COMMAND_ACK", "MESSAGE_INTERVAL"]
        assert answers[1].fields["interval_us"] == expected


def test_a_mode_by_the_old_message_gets_one_answer() -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    answers = client.send("SET_MODE", target_system=1, base_mode=1, custom_mode=393216)
    assert [(m.name, m.fields["command"], m.fields["result"]) for m in answers] == [
        ("COMMAND_ACK", 176, ACCEPTED)
    ]
    assert emu.autopilots[0].mode is Mode.OFFBOARD


def test_an_unknown_automatic_mode_is_rejected_and_other_numbers_change_nothing() -> None:
    emu = emulator()
    client = Client(emu)
    assert client.command(176, 1, 4, 99) == [ACCEPTED, REJECTED]
    assert emu.autopilots[0].journal.texts.newest[-1].text == "Unsupported auto mode\t"
    assert client.command(176, 1, 77) == [ACCEPTED, ACCEPTED]
    assert emu.autopilots[0].mode is Mode.LOITER


def test_missions_logs_files_and_the_shell_are_refused_or_empty_at_once() -> None:
    client = Client(emulator())
    (count,) = client.send("MISSION_REQUEST_LIST", target_system=1, target_component=1)
    assert (count.name, count.fields["count"]) == ("MISSION_COUNT", 0)
    (refusal,) = client.send("MISSION_COUNT", target_system=1, target_component=1, count=3)
    assert (refusal.name, refusal.fields["type"]) == ("MISSION_ACK", 3)
    (cleared,) = client.send("MISSION_CLEAR_ALL", target_system=1, target_component=1)
    assert (cleared.name, cleared.fields["type"]) == ("MISSION_ACK", 0)
    (entry,) = client.send("LOG_REQUEST_LIST", target_system=1, target_component=1)
    assert (entry.name, entry.fields["num_logs"]) == ("LOG_ENTRY", 0)
    opening = [5, 0, 0, 4, 3, 0] + [0] * 245
    (refused,) = client.send(
        "FILE_TRANSFER_PROTOCOL", target_system=1, target_component=1, payload=opening
    )
    assert refused.fields["payload"][:6] == [6, 0, 0, 129, 1, 4]
    assert refused.fields["payload"][12] == 10
    assert client.send("SERIAL_CONTROL", device=10, count=1) == []
    assert client.command(300) == [DENIED]


@pytest.mark.parametrize("number", [521, 530, 1000, 2000, 2500, 31010])
def test_commands_for_cameras_and_gimbals_and_unknown_ones_are_unsupported(number: int) -> None:
    assert Client(emulator()).command(number, math.nan, 1.0) == [UNSUPPORTED]


def test_the_versions_are_those_of_px4_1_16_with_bytewise_parameters() -> None:
    client = Client(emulator(px4="1.16"))
    (version,) = client.send("COMMAND_LONG", command=512, target_system=1, param1=148.0)[1:]
    assert version.fields["flight_sw_version"] >> 8 == 0x011000
    assert version.fields["capabilities"] & 0x10  # integers bytewise
    assert not version.fields["capabilities"] & 0x20000  # and not converted
    (protocol,) = client.send("COMMAND_LONG", command=519, target_system=0)[1:]
    assert protocol.fields["version"] == 200


def test_parameters_of_the_wrong_type_and_for_everybody_are_met_with_silence() -> None:
    emu = emulator()
    client = Client(emu)
    assert (
        client.send(
            "PARAM_SET", param_id=b"COM_OF_LOSS_T", param_value=1.0, param_type=6, target_system=1
        )
        == []
    )
    assert (
        client.send(
            "PARAM_SET", param_id=b"COM_OF_LOSS_T", param_value=1.0, param_type=9, target_system=0
        )
        == []
    )
    (value,) = client.send(
        "PARAM_REQUEST_READ", param_id=b"_HASH_CHECK", param_index=-1, target_system=1
    )
    assert (value.fields["param_index"], value.fields["param_type"]) == (0xFFFF, 5)
    (other,) = client.send(
        "PARAM_SET", param_id=b"COM_OF_LOSS_T", param_value=0.5, param_type=9, target_system=1
    )
    assert other.fields["param_value"] == 0.5
    (changed,) = client.send(
        "PARAM_REQUEST_READ", param_id=b"_HASH_CHECK", param_index=-1, target_system=1
    )
    assert changed.fields["param_value"] != value.fields["param_value"]


def test_a_reboot_on_command_keeps_the_parameters_and_is_denied_to_an_armed_vehicle() -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    client.send(
        "PARAM_SET", param_id=b"COM_OF_LOSS_T", param_value=0.5, param_type=9, target_system=1
    )
    assert client.command(400, 1) == [ACCEPTED]
    assert client.command(246, 1) == [DENIED]
    assert client.command(400, 0) == [ACCEPTED]
    assert client.command(246, 1) == [ACCEPTED]
    assert client.command(400, 1) == [REJECTED]  # it starts again
    run_for(emu, 5.0)
    assert client.command(400, 1) == [ACCEPTED]
    assert emu.autopilots[0].params["COM_OF_LOSS_T"] == 0.5


def test_a_vehicle_keeps_its_number_and_a_restart_shows_it_again() -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    emu.autopilots[0].params.values["MAV_SYS_ID"] = 7
    assert client.command(246, 1) == [ACCEPTED]
    assert emu.autopilots[0].params["MAV_SYS_ID"] == 1
    assert {message.system_id for message in client.collect(1.0)} == {1}


@pytest.mark.parametrize(
    ("number", "results", "is_reset"),
    [
        (0, [ACCEPTED], False),
        (1, [ACCEPTED], False),
        (2, [ACCEPTED], True),
        (3, [ACCEPTED], False),
        (4, [ACCEPTED], True),
        (5, [], False),
    ],
)
def test_parameters_are_reset_on_command_except_those_of_the_simulation(
    number: int, results: list[int], is_reset: bool
) -> None:
    emu = emulator((0.0, 0.0, 0.0), (3.0, 0.0, 0.0))
    client = Client(emu, 1)
    params = emu.autopilots[1].params
    params.values["COM_OF_LOSS_T"] = 3.0
    params.values["EKF2_GPS_CTRL"] = 0
    emu.parameters_changed(1)
    answers = client.send(
        "COMMAND_LONG", command=245, target_system=2, target_component=1, param1=float(number)
    )
    assert [m.fields["result"] for m in answers] == results
    assert (params["COM_OF_LOSS_T"] == params.defaults["COM_OF_LOSS_T"]) is is_reset
    assert emu.estimator.sensors[1].has_gps is is_reset
    assert params["MAV_SYS_ID"] == 2


def test_a_ground_station_that_knows_the_parameters_stops_the_list() -> None:
    client = Client(emulator())
    client.send("PARAM_REQUEST_LIST", target_system=1)
    client.collect(0.02)
    client.send(
        "PARAM_SET", param_id=b"_HASH_CHECK", param_value=0.0, param_type=5, target_system=1
    )
    assert "PARAM_VALUE" not in [m.name for m in client.collect(0.5)]


def in_hold() -> tuple[Emulator, Client]:
    """A vehicle that has taken off and holds, and its client."""
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    assert client.command(22, *[math.nan] * 7) == [ACCEPTED]
    assert client.command(400, 1) == [ACCEPTED]
    until(emu, lambda: emu.autopilots[0].mode is Mode.LOITER, 15.0)
    return emu, client


def test_a_reposition_command_moves_hold_to_a_position_on_earth() -> None:
    emu, client = in_hold()
    latitude, longitude, _ = client.link.view.to_global((4.0, 0.0, -2.5))
    answers = client.send(
        "COMMAND_INT",
        command=192,
        target_system=1,
        target_component=1,
        param2=1.0,
        param4=math.nan,
        x=round(latitude * 1e7),
        y=round(longitude * 1e7),
        z=math.nan,
    )
    assert [m.fields["result"] for m in answers] == [ACCEPTED]
    until(emu, lambda: emu.world.vehicles.states.position_ned_m[0, 0] > 3.0, 12.0)
    assert emu.world.vehicles.states.position_ned_m[0, 2] < -1.5


def test_a_reposition_command_turns_hold_to_its_heading_and_flies_at_its_speed() -> None:
    emu, client = in_hold()
    control = emu.autopilots[0].mode_control

    place = client.link.view.to_global((8.0, 0.0, -2.5))
    assert client.command(192, 1.0, 1, 0, math.pi, *place) == [ACCEPTED]
    run_for(emu, 4.0)
    assert emu.world.vehicles.states.velocity_ned_m_s[0, 0] == pytest.approx(1.0, abs=0.3)
    assert abs(math.remainder(emu.believed_yaw_rad(0) - math.pi, 2.0 * math.pi)) < 0.2

    # A heading alone keeps the position, and the speed of this Hold.
    nowhere = (math.nan, math.nan)
    assert client.command(192, -1, 1, 0, 0.0, *nowhere, math.nan) == [ACCEPTED]
    run_for(emu, 2.0)
    assert emu.world.vehicles.states.velocity_ned_m_s[0, 0] == pytest.approx(1.0, abs=0.3)
    assert control.goal is not None
    assert control.goal.position_ned_m[0] == pytest.approx(8.0, abs=0.5)  # degrees of 32 bits
    assert control.goal.yaw_rad == 0.0

    # Another Hold begins with neither.
    assert client.command(20) == [ACCEPTED]
    assert client.command(192, math.nan, 1, 0, math.nan, *place) == [ACCEPTED]
    assert control.cruise_m_s is None


@pytest.mark.parametrize(
    ("action", "goal_ned_m", "is_refused"),
    [
        (2, (12.0, 0.0, -2.5), True),
        (3, (0.0, 0.0, -9.0), True),
        (2, (3.0, 0.0, -2.5), False),
        (1, (12.0, 0.0, -2.5), False),
        (0, (12.0, 0.0, -2.5), False),
    ],
)
def test_a_reposition_command_beyond_the_fence_is_accepted_and_not_flown(
    action: int, goal_ned_m: tuple[float, float, float], is_refused: bool
) -> None:
    emu, client = in_hold()
    pilot = emu.autopilots[0]
    pilot.params.values.update(GF_ACTION=action, GF_MAX_HOR_DIST=10.0, GF_MAX_VER_DIST=8.0)
    goal = client.link.view.to_global(goal_ned_m)
    assert client.command(192, -1, 1, 0, math.nan, *goal) == [ACCEPTED]
    said = pilot.journal.texts.newest[-1].text == "Reposition is outside geofence\t"
    assert said is is_refused
    run_for(emu, 0.1)
    assert pilot.mode_control.goal is not None
    is_flown = math.dist(pilot.mode_control.goal.position_ned_m, goal_ned_m) < 1.0
    assert is_flown is not is_refused


def test_a_reposition_command_without_a_position_stops_a_vehicle_on_its_way() -> None:
    emu, client = in_hold()

    place = client.link.view.to_global((40.0, 0.0, -8.0))
    assert client.command(192, -1, 1, 0, math.nan, *place) == [ACCEPTED]
    run_for(emu, 4.0)
    stopped_at = np.array(emu.estimator.local(0).position_ned_m)
    assert client.command(192, -1, 1, *[math.nan] * 5) == [ACCEPTED]
    run_for(emu, 5.0)
    assert math.dist(emu.estimator.local(0).position_ned_m, stopped_at) < 1.0


@pytest.mark.parametrize("change_m", [20.0, -20.0])
@pytest.mark.parametrize("has_vision", [False, True])
def test_a_vehicle_that_holds_stays_where_it_is_when_its_origin_gets_another_altitude(
    change_m: float, has_vision: bool
) -> None:
    emu = emulator()
    client = Client(emu)

    def see() -> None:
        if has_vision and emu.world.vehicles.steps % 5 == 0:
            emu.vision(0, emu.world.vehicles.states.position_ned_m[0])

    run_for(emu, 5.0)
    assert client.command(22, *[math.nan] * 7) == [ACCEPTED]
    assert client.command(400, 1) == [ACCEPTED]
    until(emu, lambda: emu.autopilots[0].mode is Mode.LOITER, 15.0, see)
    true_before_m, estimated_before_m = heights_m(emu)

    altitude_mm = round(1e3 * (emu.origin.altitude_m + change_m))
    client.send("SET_GPS_GLOBAL_ORIGIN", target_system=1, **ZURICH_DEG, altitude=altitude_mm)
    run_for(emu, 4.0, see)
    true_m, estimated_m = heights_m(emu)
    assert true_m == pytest.approx(true_before_m, abs=0.5)
    assert estimated_m == pytest.approx(estimated_before_m - change_m, abs=0.5)


def reported_place(emu: Emulator, **origin: int) -> dict[str, dict[str, Any]]:
    """Return what a vehicle by vision alone reports of its place after it received an origin."""
    client = Client(emu)
    client.turn_satellites_off()
    client.command(511, ID_BY_NAME["HIL_STATE_QUATERNION"], 100_000)

    def see() -> None:
        if emu.world.vehicles.steps % 5 == 0:
            emu.vision(0, emu.world.vehicles.states.position_ned_m[0])

    run_for(emu, 5.0, see)
    client.send("SET_GPS_GLOBAL_ORIGIN", target_system=1, **origin)
    return {message.name: message.fields for message in client.collect(3.0, see)}


def test_a_vehicle_without_satellites_is_where_its_origin_says() -> None:
    emu = emulator()
    berlin = {"latitude": 520000000, "longitude": 130000000, "altitude": 50_000}
    seen = reported_place(emu, **berlin)
    origin = seen["GPS_GLOBAL_ORIGIN"]
    assert {name: origin[name] for name in berlin} == berlin

    place = seen["GLOBAL_POSITION_INT"]
    home = seen["HOME_POSITION"]
    assert [place["lat"], place["lon"]] == pytest.approx([520000000, 130000000], abs=50)
    assert [home["latitude"], home["longitude"]] == pytest.approx([520000000, 130000000], abs=50)
    truth = seen["HIL_STATE_QUATERNION"]
    assert [truth["lat"], truth["lon"]] == pytest.approx(list(ZURICH_DEG.values()), abs=1)

    emu.reboot(0)
    assert Client(emu).link.view.origin_deg == pytest.approx((47.397742, 8.545594))


@pytest.mark.parametrize(
    "origin", [{"latitude": 900000001}, {"longitude": -1800000001}], ids=["latitude", "longitude"]
)
def test_an_origin_that_is_not_on_earth_is_ignored(origin: dict[str, int]) -> None:
    emu = emulator()
    seen = reported_place(emu, altitude=50_000, **origin)
    assert "GPS_GLOBAL_ORIGIN" not in seen
    assert emu.estimator.local(0).position_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=0.3)


def test_an_altitude_of_the_origin_beyond_the_air_is_ignored() -> None:
    emu = emulator()
    reported_place(emu, **ZURICH_DEG, altitude=100_001_000)
    assert emu.estimator.local(0).position_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=0.3)


def test_an_origin_by_satellites_keeps_its_latitude_and_longitude() -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    client.send("SET_GPS_GLOBAL_ORIGIN", target_system=1, latitude=520000000, altitude=489_400)
    seen = {message.name: message.fields for message in client.collect(1.0)}
    assert seen["GPS_GLOBAL_ORIGIN"]["latitude"] == ZURICH_DEG["latitude"]
    assert seen["GLOBAL_POSITION_INT"]["lat"] == pytest.approx(ZURICH_DEG["latitude"], abs=50)


def test_altitudes_are_those_above_the_sea_whatever_altitude_the_origin_has() -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    client.send("SET_GPS_GLOBAL_ORIGIN", target_system=1, **ZURICH_DEG, altitude=50_000)
    client.command(511, ID_BY_NAME["HIL_STATE_QUATERNION"], 100_000)
    seen = {message.name: message.fields for message in client.collect(3.0)}

    altitude_m = emu.origin.altitude_m
    assert seen["LOCAL_POSITION_NED"]["z"] == pytest.approx(50.0 - altitude_m, abs=0.5)
    assert seen["GPS_GLOBAL_ORIGIN"]["altitude"] == 50_000
    altitudes_m = [
        seen["GLOBAL_POSITION_INT"]["alt"] * 1e-3,
        seen["GPS_RAW_INT"]["alt"] * 1e-3,
        seen["HOME_POSITION"]["altitude"] * 1e-3,
        seen["ALTITUDE"]["altitude_amsl"],
        seen["VFR_HUD"]["alt"],
        seen["OPEN_DRONE_ID_LOCATION"]["altitude_geodetic"],
        seen["HIGHRES_IMU"]["pressure_alt"],
        seen["HIL_STATE_QUATERNION"]["alt"] * 1e-3,
    ]
    assert altitudes_m == pytest.approx([altitude_m] * len(altitudes_m), abs=0.5)
    assert seen["GLOBAL_POSITION_INT"]["relative_alt"] * 1e-3 == pytest.approx(0.0, abs=0.5)
    assert seen["ALTITUDE"]["altitude_relative"] == pytest.approx(0.0, abs=0.5)


def test_altitudes_in_commands_count_from_the_sea_whatever_altitude_the_origin_has() -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    client.send("SET_GPS_GLOBAL_ORIGIN", target_system=1, **ZURICH_DEG, altitude=50_000)
    run_for(emu, 0.1)

    altitude_m = emu.origin.altitude_m
    nowhere = (math.nan, math.nan)
    assert client.command(22, 0, 0, 0, math.nan, *nowhere, altitude_m + 4.0) == [ACCEPTED]
    assert client.command(400, 1) == [ACCEPTED]
    until(emu, lambda: emu.autopilots[0].mode is Mode.LOITER, 15.0)
    assert heights_m(emu)[0] == pytest.approx(4.0, abs=0.8)

    assert client.command(192, -1, 1, 0, math.nan, *nowhere, altitude_m + 7.0) == [ACCEPTED]
    run_for(emu, 6.0)
    assert heights_m(emu)[0] == pytest.approx(7.0, abs=0.8)


def heights_m(emu: Emulator) -> tuple[float, float]:
    """Return the true and the estimated height of the first vehicle."""
    _, _, down_m = emu.world.vehicles.states.position_ned_m[0].tolist()
    _, _, estimated_down_m = emu.estimator.local(0).position_ned_m
    return -down_m, -estimated_down_m


def test_a_speed_command_holds_for_the_mode_and_changes_no_parameter() -> None:
    emu, client = in_hold()
    px4 = emu.autopilots[0]
    cruise_m_s = px4.params["MPC_XY_CRUISE"]
    assert client.command(178, 1, 0.3) == [ACCEPTED]
    px4.mode_control.hold_at(np.array([4.0, 0.0, math.nan]))
    run_for(emu, 5.0)
    assert 0.7 < emu.world.vehicles.states.position_ned_m[0, 0] < 1.7
    assert px4.params["MPC_XY_CRUISE"] == cruise_m_s
    # A speed of zero or below ends it.
    assert client.command(178, 1, -1.0) == [ACCEPTED]
    run_for(emu, 4.0)
    assert emu.world.vehicles.states.position_ned_m[0, 0] > 3.0
    # So does another mode.
    assert client.command(178, 1, 0.3) == [ACCEPTED]
    assert client.command(20) == [ACCEPTED]
    run_for(emu, 4.0)
    assert emu.world.vehicles.states.position_ned_m[0, 0] < 1.5


@pytest.mark.parametrize(
    ("above_sea_m", "height_m", "said"),
    [
        (math.nan, 2.5, "Using default takeoff altitude: 2.5 m\t"),
        (490.4, 1.0, None),
        (493.4, 4.0, None),
    ],
)
def test_a_take_off_climbs_to_the_requested_altitude_or_to_the_default(
    above_sea_m: float, height_m: float, said: str | None
) -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    assert client.command(22, 0, 0, 0, math.nan, math.nan, math.nan, above_sea_m) == [ACCEPTED]
    assert client.command(400, 1) == [ACCEPTED]
    pilot = emu.autopilots[0]
    assert [text.text for text in pilot.journal.texts.newest if "altitude" in text.text] == (
        [said] if said else []
    )
    until(emu, lambda: pilot.mode is Mode.LOITER, 15.0)
    assert -float(emu.estimator.position_ned_m[0, 2]) == pytest.approx(height_m, abs=0.4)


@pytest.mark.parametrize(("px4", "is_sideways"), [("1.16", True), ("1.18", False)])
def test_a_take_off_goes_to_its_latitude_and_longitude_in_the_climb_or_after_it(
    px4: str, is_sideways: bool
) -> None:
    emu = emulator(px4=px4)
    client = Client(emu)
    run_for(emu, 5.0)
    place = client.link.view.to_global((6.0, 0.0, -4.0))
    assert client.command(22, *[math.nan] * 4, *place) == [ACCEPTED]
    assert client.command(400, 1) == [ACCEPTED]
    until(emu, lambda: emu.autopilots[0].mode is Mode.LOITER, 15.0)
    north = float(emu.world.vehicles.states.position_ned_m[0, 0])
    assert (north > 3.0) is is_sideways
    run_for(emu, 6.0)
    north, _, down = emu.world.vehicles.states.position_ned_m[0].tolist()
    assert (north, down) == pytest.approx((6.0, -4.0), abs=1.0)


@pytest.mark.parametrize(("px4", "height_m"), [("1.16", 0.0), ("1.18", 4.0)])
def test_a_take_off_with_zeros_for_a_place_stays_on_the_ground_or_climbs_straight(
    px4: str, height_m: float
) -> None:
    emu = emulator(px4=px4)
    client = Client(emu)
    run_for(emu, 5.0)
    assert client.command(22, *[0.0] * 6, emu.origin.altitude_m + 4.0) == [ACCEPTED]
    assert client.command(400, 1) == [ACCEPTED]
    run_for(emu, 9.0)
    north, east, down = emu.world.vehicles.states.position_ned_m[0].tolist()
    assert math.hypot(north, east) < 1.0
    assert down == pytest.approx(-height_m, abs=0.6)


def test_a_take_off_to_an_altitude_below_the_ground_stays_on_the_ground() -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    assert client.command(22, *[math.nan] * 6, 3.0) == [ACCEPTED]
    assert client.command(400, 1) == [ACCEPTED]
    pilot = emu.autopilots[0]
    assert pilot.journal.texts.newest[-1].text == "Already higher than takeoff altitude\t"
    until(emu, lambda: not pilot.is_armed, 11.0)
    assert heights_m(emu)[0] == pytest.approx(0.0, abs=0.01)


def test_a_take_off_in_the_air_climbs_where_it_is_and_never_descends() -> None:
    emu, client = in_hold()
    pilot = emu.autopilots[0]
    pilot.mode_control.hold_at(np.array([4.0, 0.0, -6.0]))
    run_for(emu, 10.0)
    assert client.command(22, *[math.nan] * 7) == [ACCEPTED]
    assert pilot.mode is Mode.TAKEOFF
    until(emu, lambda: pilot.mode is Mode.LOITER, 6.0)
    run_for(emu, 2.0)
    north, _, down = emu.world.vehicles.states.position_ned_m[0].tolist()
    assert (north, down) == pytest.approx((4.0, -8.5), abs=0.6)

    assert client.command(22, *[math.nan] * 6, emu.origin.altitude_m + 3.0) == [ACCEPTED]
    assert pilot.journal.texts.newest[-1].text == "Already higher than takeoff altitude\t"
    run_for(emu, 3.0)
    assert heights_m(emu)[0] == pytest.approx(8.5, abs=0.6)


def test_the_ground_link_streams_less_and_events_as_well() -> None:
    emu = emulator()
    from sitl.mavlink.codec import Decoder
    from sitl.mavlink.link import Link

    link = Link(emu, 0, GCS_RATES_HZ)
    decoder = Decoder()
    names: list[str] = []
    run_for(emu, 5.0)
    link.poll()
    emu.autopilots[0].request_arm(emu.time_s, True, 0.0)

    def poll() -> None:
        names.extend(m.name for datagram in link.poll() for m in decoder.decode(datagram))

    run_for(emu, 4.0, poll)
    assert names.count("ATTITUDE") == pytest.approx(60, abs=2)
    assert "EVENT" in names
    assert "HIGHRES_IMU" not in names


def test_setpoints_for_positions_on_earth_are_flown() -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    latitude, longitude, _ = client.link.view.to_global((3.0, -1.0, 0.0))
    place = {"lat_int": round(latitude * 1e7), "lon_int": round(longitude * 1e7), "alt": 2.0}

    def send() -> None:
        if emu.world.vehicles.steps % 10 == 0:
            client.send(
                "SET_POSITION_TARGET_GLOBAL_INT",
                **place,
                target_system=1,
                coordinate_frame=6,
                type_mask=0xFF8,
            )

    run_for(emu, 0.2, send)
    assert client.command(176, 1, 6) == [ACCEPTED, ACCEPTED]
    assert client.command(400, 1) == [ACCEPTED]
    run_for(emu, 12.0, send)
    north, east, down = emu.world.vehicles.states.position_ned_m[0].tolist()
    assert math.dist((north, east, down), (3.0, -1.0, -2.0)) < 1.5


@pytest.mark.parametrize(
    "ahead", [{"x": 100.0, "type_mask": 0xDF8}, {"vx": 11.0, "type_mask": 0xDC7}], ids=["x", "vx"]
)
def test_setpoints_are_flown_faster_than_px4_cruises_by_itself(ahead: dict[str, Any]) -> None:
    emu = emulator()
    client = Client(emu)
    px4 = emu.autopilots[0]
    goal = {"z": -5.0, "vz": -1.0, **ahead}

    def send() -> None:
        if emu.world.vehicles.steps % 10 == 0:
            client.send(
                "SET_POSITION_TARGET_LOCAL_NED", target_system=1, coordinate_frame=1, **goal
            )

    run_for(emu, 5.0, send)
    assert client.command(176, 1, 6) == [ACCEPTED, ACCEPTED]
    assert client.command(400, 1) == [ACCEPTED]
    run_for(emu, 6.0, send)
    assert client.command(178, 1, 1.0) == [ACCEPTED]  # a speed of automatic modes only
    run_for(emu, 2.0, send)
    north_m_s = float(emu.world.vehicles.states.velocity_ned_m_s[0, 0])
    assert px4.params["MPC_XY_CRUISE"] + 1.0 < north_m_s < px4.params["MPC_XY_VEL_MAX"]


def test_a_setpoint_in_an_unknown_frame_or_of_nothing_is_refused_in_words() -> None:
    emu = emulator()
    client = Client(emu)
    client.send("SET_POSITION_TARGET_LOCAL_NED", target_system=1, coordinate_frame=9, x=1.0)
    client.send(
        "SET_POSITION_TARGET_LOCAL_NED", target_system=1, coordinate_frame=1, type_mask=0x1FF
    )
    said = [text.text for text in emu.autopilots[0].journal.texts.newest]
    assert said == [
        "SET_POSITION_TARGET_LOCAL_NED coordinate frame 9 unsupported\t",
        "SET_POSITION_TARGET_LOCAL_NED invalid\t",
    ]
    assert emu.autopilots[0].setpoint is None


@pytest.mark.parametrize(
    ("frame", "mask", "is_taken"),
    [
        (8, 0b1101_1110_0111, False),  # a velocity without its third axis
        (8, 0b1101_0011_1111, False),  # an acceleration without its third axis
        (8, 0b1101_1100_0111, True),
        (1, 0b1101_1110_0111, True),
    ],
)
def test_a_velocity_or_acceleration_in_the_body_frame_is_taken_only_with_all_its_axes(
    frame: int, mask: int, is_taken: bool
) -> None:
    emu = emulator()
    client = Client(emu)
    client.send(
        "SET_POSITION_TARGET_LOCAL_NED", target_system=1, coordinate_frame=frame, type_mask=mask
    )
    px4 = emu.autopilots[0]
    assert (px4.setpoint is not None) is is_taken
    said = [text.text for text in px4.journal.texts.newest]
    assert said == ([] if is_taken else ["SET_POSITION_TARGET_LOCAL_NED invalid\t"])


def test_a_velocity_in_the_body_frame_turns_with_the_heading_and_a_yaw_rate_turns_it() -> None:
    emu = emulator()
    client = Client(emu)
    mask = 0x7C7 & ~0x800
    speed = {"vx": 1.0, "yaw_rate": 0.0}

    def send() -> None:
        if emu.world.vehicles.steps % 10 == 0:
            client.send(
                "SET_POSITION_TARGET_LOCAL_NED",
                target_system=1,
                coordinate_frame=8,
                type_mask=mask,
                vz=climb,
                **speed,
            )

    climb = -0.5
    run_for(emu, 5.0, send)
    assert client.command(176, 1, 6) == [ACCEPTED, ACCEPTED]
    assert client.command(400, 1) == [ACCEPTED]
    run_for(emu, 4.0, send)
    climb = 0.0
    run_for(emu, 4.0, send)
    north, east, _ = emu.world.vehicles.states.velocity_ned_m_s[0].tolist()
    assert east == pytest.approx(1.0, abs=0.5)  # body x points east
    assert abs(north) < 0.5
    before = float(emu.world.vehicles.states.yaw_rad[0])
    speed["yaw_rate"] = 0.5
    run_for(emu, 3.0, send)
    turned = math.remainder(float(emu.world.vehicles.states.yaw_rad[0]) - before, 2.0 * math.pi)
    assert 0.6 < turned < 1.8


def test_an_acceleration_alone_is_flown() -> None:
    emu = emulator()
    client = Client(emu)
    mask = 0xC3F & ~0x400

    def send() -> None:
        if emu.world.vehicles.steps % 10 == 0:
            client.send(
                "SET_POSITION_TARGET_LOCAL_NED",
                target_system=1,
                coordinate_frame=1,
                type_mask=mask,
                afx=1.0,
                afz=-0.5,
                yaw=math.pi / 2,
            )

    run_for(emu, 5.0, send)
    assert client.command(176, 1, 6) == [ACCEPTED, ACCEPTED]
    assert client.command(400, 1) == [ACCEPTED]
    run_for(emu, 4.0, send)
    north, east, down = emu.world.vehicles.states.velocity_ned_m_s[0].tolist()
    assert north > 0.5
    assert abs(east) < 0.3
    assert down < 0.0


def test_another_component_and_another_system_are_not_this_autopilot() -> None:
    emu = emulator()
    client = Client(emu)
    command = Encoder(245, 190)
    for system, component in ((1, 100), (2, 1), (0, 1)):
        frame = command.encode_named(
            "COMMAND_LONG",
            command=400,
            target_system=system,
            target_component=component,
            param1=1.0,
        )
        assert client.send_bytes(frame) == []
    assert client.send_bytes(
        command.encode_named("COMMAND_LONG", command=512, target_system=0, param1=148.0)
    )
