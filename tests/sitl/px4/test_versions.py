"""What differs between the versions of PX4 that the emulator can be, seen from its links and in its
flight.
"""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path

import pytest
from msgspec.structs import replace

import sitl.px4
from onboard.config.fleet import Vehicle, load_fleet
from sitl.emulator.emulator import Emulator
from sitl.fleet_emulator import profile_of
from sitl.mavlink.codec import text_of
from sitl.px4.modes import Mode
from sitl.px4.parameters import DEFAULTS
from sitl.px4.versions import VERSIONS
from tests.sitl.px4.test_commander import offboard_at_height
from tests.sitl.sitl_flying import EAST_WXYZ, Client, emulator, run_for, streamer, until

UNSUPPORTED = 3
ALL = sorted(VERSIONS)


def test_no_code_of_the_emulator_compares_versions_by_name() -> None:
    folder = Path(sitl.px4.__file__).parents[1]
    rooms = ("px4", "mavlink", "emulator", "physics")
    texts = {
        path: path.read_text(encoding="utf-8")
        for room in rooms
        for path in (folder / room).glob("*.py")
    }
    asking = [
        path.name
        for path, text in texts.items()
        if re.search(r'(==|is|in|>=|<) *\(?"1\.1\d"', text)
    ]
    assert asking == []


@pytest.mark.parametrize("px4", ALL)
def test_autopilot_version_reports_the_emulated_version(px4: str) -> None:
    client = Client(emulator(px4=px4))
    (version,) = client.send("COMMAND_LONG", command=512, target_system=1, param1=148.0)[1:]
    number = version.fields["flight_sw_version"]
    assert f"{number >> 24}.{number >> 16 & 0xFF}" == px4


def test_commands_for_single_messages_are_gone_in_v1_18_and_a_mode_is_answered_once() -> None:
    old = Client(emulator(px4="1.17"))
    new = Client(emulator(px4="1.18"))
    for number in (410, 519, 520, 528):
        assert old.command(number, 1.0) == [0], number
        assert new.command(number, 1.0) == [UNSUPPORTED], number
    assert old.command(176, 1.0, 4.0, 3.0) == [0, 0]
    assert new.command(176, 1.0, 4.0, 3.0) == [0]


def test_each_version_has_its_parameters() -> None:
    for px4, known, unknown, refused in (
        ("1.17", "COM_RC_OVERRIDE", "MAN_OVERRIDE_SPD", []),
        ("1.18", "MC_REF_W_N", "EKF2_GPS_DELAY", ["PARAM_ERROR"]),
    ):
        client = Client(emulator(px4=px4))
        read = {"target_system": 1, "target_component": 1, "param_index": -1}
        (value,) = client.send("PARAM_REQUEST_READ", param_id=known.encode(), **read)
        assert text_of(value.fields["param_id"]) == known
        assert value.fields["param_count"] == len(DEFAULTS[px4])
        answers = client.send("PARAM_REQUEST_READ", param_id=unknown.encode(), **read)
        assert [answer.name for answer in answers] == refused


def test_an_attitude_without_thrust_is_no_sign_of_life_in_v1_18() -> None:
    for px4, mode in (("1.17", Mode.OFFBOARD), ("1.18", Mode.LAND)):
        emu = emulator(px4=px4)
        offboard_at_height(emu, 12.0, loss_action=4)

        def ignoring(emu=emu) -> None:
            emu.attitude_setpoint(0, [1.0, 0.0, 0.0, 0.0], [0.0] * 3, 0.5, 7 | 64)

        run_for(emu, 1.2, ignoring)
        assert emu.autopilots[0].mode is mode, px4


@pytest.mark.parametrize("part", [0.0, math.nan])
def test_an_attitude_that_is_no_rotation_ends_attitude_control_for_good_in_v1_18(
    part: float,
) -> None:
    for px4, is_lost in (("1.16", False), ("1.18", True)):
        emu = emulator(px4=px4)
        offboard_at_height(emu, 5.0)
        emu.attitude_setpoint(0, [part] * 4, [0.0] * 3, 0.49, 7)
        half = math.radians(5.0)
        run_for(emu, 1.5, streamer(emu, 0.49, [math.cos(half), math.sin(half), 0.0, 0.0]))
        roll_deg = math.degrees(emu.world.vehicles.states.tilt_rad[0, 0])
        assert (roll_deg < -5.0) is is_lost, (px4, roll_deg)
        assert (7.0 < roll_deg < 12.0) is not is_lost, (px4, roll_deg)
        pilot = emu.autopilots[0]
        pilot.request_arm(emu.time_s, False, 21196.0)
        assert bool(pilot.arming_obstacles(emu.time_s)) is is_lost
        emu.reboot(0)
        run_for(emu, 5.0)
        assert pilot is not emu.autopilots[0]
        assert "the attitude control has failed" not in emu.autopilots[0].arming_obstacles(
            emu.time_s
        )


def _moved(emu, client: Client, speed_1_s: float, most: float) -> Mode:
    begin_s = emu.time_s + 0.5
    stream = streamer(emu, 0.49)

    def each() -> None:
        stream()
        if emu.world.vehicles.steps % 12 == 0:
            x = min(most, max(0.0, speed_1_s * (emu.time_s - begin_s)))
            client.send("MANUAL_CONTROL", target=1, x=round(1000 * x), y=0, z=500, r=0)

    run_for(emu, 2.0, each)
    return emu.autopilots[0].mode


@pytest.mark.parametrize(
    ("px4", "override", "speed_1_s", "most", "mode"),
    [
        ("1.17", None, 3.0, 0.5, Mode.OFFBOARD),
        ("1.18", None, 3.0, 0.5, Mode.POSCTL),
        ("1.18", None, 0.5, 0.5, Mode.OFFBOARD),
        ("1.18", None, 100.0, 0.1, Mode.OFFBOARD),  # a step is one sample
        ("1.18", -1.0, 3.0, 0.5, Mode.OFFBOARD),
    ],
)
def test_a_stick_takes_a_vehicle_out_of_offboard_as_the_version_does(
    px4, override, speed_1_s, most, mode
) -> None:
    emu = emulator(px4=px4)
    client = Client(emu)
    if override is not None:
        emu.autopilots[0].params.values["MAN_OVERRIDE_SPD"] = override
    offboard_at_height(emu, 3.0)
    assert _moved(emu, client, speed_1_s, most) is mode


@pytest.mark.parametrize(
    ("action", "old", "new"), [(0, Mode.POSCTL, Mode.RTL), (2, Mode.STABILIZED, Mode.RTL)]
)
def test_without_sticks_v1_18_returns_where_others_sink_blindly(
    action: int, old: Mode, new: Mode
) -> None:
    for px4, mode in (("1.17", old), ("1.18", new)):
        emu = emulator(px4=px4)
        offboard_at_height(emu, 3.0, loss_action=action)
        run_for(emu, 1.2)
        assert emu.autopilots[0].mode is mode


def test_a_flight_that_a_failsafe_ends_shows_offboard_in_v1_18() -> None:
    for px4, shown in (("1.17", Mode.TERMINATION), ("1.18", Mode.OFFBOARD)):
        emu = emulator(px4=px4)
        offboard_at_height(emu, 3.0, loss_action=6)
        run_for(emu, 1.2)
        assert (emu.autopilots[0].mode, emu.autopilots[0].shown_mode) == (Mode.TERMINATION, shown)


@pytest.mark.parametrize(
    ("px4", "parameters", "t63_s", "t90_s"),
    [
        ("1.16", {}, 0.188, 0.249),
        ("1.17", {}, 0.259, 0.416),
        ("1.17", {"MC_ROLL_P": 6.5}, 0.188, 0.249),
        ("1.18", {}, 0.288, 0.457),
        ("1.18", {"MC_ROLL_P": 6.5}, 0.227, 0.295),
    ],
)
def test_a_roll_of_ten_degrees_takes_as_long_as_it_took_a_real_px4(
    px4, parameters, t63_s, t90_s
) -> None:
    emu = emulator(px4=px4)
    emu.autopilots[0].params.values.update(parameters)
    emu.parameters_changed(0)
    offboard_at_height(emu, 5.0)
    run_for(emu, 1.0, streamer(emu, 0.49, [1.0, 0.0, 0.0, 0.0]))
    half = math.radians(5.0)
    emu.attitude_setpoint(0, [math.cos(half), math.sin(half), 0.0, 0.0], [0.0] * 3, 0.49, 7)
    roll = emu.world.vehicles.states.tilt_rad

    def reaches(share: float) -> float:
        return until(emu, lambda: roll[0, 0] >= share * math.radians(10.0), 1.0)

    first_s = reaches(0.63)
    assert first_s == pytest.approx(t63_s, abs=0.03)
    assert first_s + reaches(0.9) == pytest.approx(t90_s, abs=0.04)


FLEET = load_fleet("configs/fleets/sih.toml")
TYPES = tomllib.loads(Path("configs/fleets/sih.toml").read_text(encoding="utf-8"))["types"]


def _of_type(name: str) -> Vehicle:
    table = {key: value for key, value in TYPES[name].items() if key != "sitl"}
    return replace(FLEET.vehicles["mav0"], **table)


def _lag_s(emu: Emulator) -> float:
    """How long the roll is behind a setpoint that turns at a constant rate."""
    rate_rad_s = math.radians(10.0)
    begin_s = emu.time_s

    def each() -> None:
        half = 0.5 * rate_rad_s * (emu.time_s - begin_s)
        w = math.cos(half)
        x = math.sin(half)
        (yaw_w, _, _, yaw_z) = EAST_WXYZ
        emu.attitude_setpoint(0, [yaw_w * w, yaw_w * x, yaw_z * x, yaw_z * w], [0.0] * 3, 0.49, 7)

    run_for(emu, 1.5, each)
    return 1.5 - float(emu.world.vehicles.states.tilt_rad[0, 0]) / rate_rad_s


@pytest.mark.parametrize("name", sorted(TYPES))
def test_each_shipped_type_lags_in_the_emulator_as_it_says_under_its_version(
    name: str,
) -> None:
    vehicle = _of_type(name)
    # the same quadrotor, identified with this version, and with v1.17 and 6.5
    for body in (name, "sih"):
        emu = emulator(profile=profile_of(_of_type(body)), px4=vehicle.px4_version)
        params = emu.autopilots[0].params.values
        params.update({key: value for key, value in vehicle.px4_params.items() if key in params})
        emu.parameters_changed(0)
        offboard_at_height(emu, 5.0)
        assert _lag_s(emu) == pytest.approx(vehicle.lag_s, abs=0.012 if body == name else 0.02), (
            body
        )
