"""Faults: refused in words when they make no sense, planned in simulated time, and felt as a lab
would feel them.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from sitl.emulator.emulator import Emulator, Environment
from sitl.emulator.mocap import Mocap, MocapSettings, Pose
from sitl.faults.catalogue import FAULT_KINDS, Fault, FaultError, check, listing, parse
from sitl.mavlink.lossy_link import LossyLink
from sitl.mavlink.streams import SIMULATOR_RATES_HZ
from sitl.physics.earth import metres_from
from sitl.physics.vehicle import STEP_S
from sitl.physics.wind import WindSettings
from sitl.px4.estimator_errors import Source
from sitl.px4.modes import Mode
from tests.sitl.sitl_flying import CLIENT, EAST_WXYZ, emulator, height_m, run_for, streamer, until

NAMES = ["v0", "v1"]


def flying(*starts: tuple[float, float, float]) -> Emulator:
    """Vehicles in OFFBOARD at more than 2 m, climbing slowly."""
    emu = emulator(*(starts or ((0.0, 0.0, 0.0),)))
    senders = [streamer(emu, 0.55, index=i) for i in range(len(emu.specs))]

    def send() -> None:
        for sender in senders:
            sender()

    run_for(emu, 5.0, send)
    for autopilot in emu.autopilots:
        autopilot.request(emu.time_s, Mode.OFFBOARD)
        assert autopilot.request_arm(emu.time_s, True, 0.0).value == 0
    until(emu, lambda: min(height_m(emu, i) for i in range(len(emu.specs))) > 2.0, 10.0, send)
    return emu


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("v0", "is no fault"),
        ("motor_dead at=3", "is no fault"),
        ("v0 explode", "there is no fault 'explode'. Known: motor_weak"),
        ("v9 gps_loss", "'v9' is not emulated here; there are v0, v1"),
        ("v0 motor_dead", "needs the parameter 'motor'"),
        ("v0 motor_dead motor=5", "must lie between 1 and 4"),
        ("v0 motor_dead motor=1.5", "must be a whole number"),
        ("v0 motor_dead motor=one", "must lie between 1 and 4"),
        ("v0 motor_weak motor=1 effectiveness=nan", "must lie between 0.1 and 0.99"),
        ("v0 motor_dead motor=1 motor=2", "'motor=2' is not understood"),
        ("v0 gps_loss satellites=3", "gps_loss has no parameter 'satellites'; it has none"),
        ("v0 gps_loss at=-1", "at is -1 s"),
        ("v0 gps_loss at=soon", "give a number of seconds"),
        ("v0 gps_loss duration=inf", "duration inf s"),
        ("v0 autopilot_reboot duration=3", "happens once"),
        ("v0 mocap_swapped other=v0", "must be one of v1"),
        ("v0 link_loss direction=up", "must be one of in, out, both"),
        ("v0 link_loss share=2", "must lie between 0.001 and 1"),
        ("v0 link_delay delay_s", "'delay_s' is not understood"),
    ],
)
def test_nonsense_is_refused_in_words(line: str, words: str) -> None:
    with pytest.raises(FaultError) as refused:
        check(parse(line), NAMES)
    assert words in str(refused.value)


def test_a_line_of_text_describes_a_whole_fault() -> None:
    fault = check(parse("v1 motor_weak at=20 duration=5 motor=2 effectiveness=0.6"), NAMES)
    assert fault == Fault(
        name="motor_weak",
        vehicle="v1",
        at_s=20.0,
        duration_s=5.0,
        parameters={"motor": 2.0, "effectiveness": 0.6},
    )
    assert fault.sentence == "v1: motor 2 gives only 0.6 of its thrust"
    assert fault.end_s == 25.0
    assert check(parse("v0 gps_loss"), NAMES).end_s == math.inf


def test_every_fault_of_the_table_has_a_sentence_and_can_begin_and_end() -> None:
    needed: dict[str, float | str] = {"motor": 1.0, "other": "v1", "speed_m_s": 2.0}
    for name, kind in FAULT_KINDS.items():
        emu = emulator((0.0, 0.0, 0.0), (3.0, 0.0, 0.0))
        if kind.is_outside:
            with pytest.raises(FaultError, match="lockstep"):
                emu.inject(Fault(name, "v0", 0.1))
        emu.outside = lambda fault, is_on: None
        values = {p.name: needed[p.name] for p in kind.parameters if p.default is None}
        fault = emu.inject(
            Fault(
                name=name,
                vehicle="v0",
                at_s=0.1,
                duration_s=0.0 if kind.is_instant else 0.1,
                parameters=values,
            )
        )
        assert "{" not in fault.sentence
        run_for(emu, 0.4)
        notices = emu.disturbances.take_notices()
        assert notices[0] == f"fault: {fault.sentence}"
        assert len(notices) == (1 if kind.is_instant else 2)
        assert emu.disturbances.plan.next_s == math.inf  # nothing waits and nothing acts
        assert name in listing()


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("v0 motor_weak at=1 motor=2", "v0 motor_dead at=5 motor=2"),
        ("v0 mocap_frozen at=1 duration=5", "v0 mocap_lost at=3"),
        ("v0 mocap_swapped at=1 other=v1", "v1 mocap_jump at=3"),
        ("v0 autopilot_hang at=1 duration=5", "v0 autopilot_reboot at=3"),
        ("v0 link_loss at=1 share=0.5", "v0 link_loss at=2 share=0.1 direction=in"),
        ("v0 gps_loss", "v0 gps_loss at=9"),
    ],
)
def test_contradictory_faults_are_refused_in_words(first: str, second: str) -> None:
    emu = emulator((0.0, 0.0, 0.0), (3.0, 0.0, 0.0))
    emu.inject(parse(first))
    with pytest.raises(
        FaultError, match=r"contradict each other: both act on the .* at the same time"
    ):
        emu.inject(parse(second))


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("v0 motor_weak at=1 motor=2", "v0 motor_weak at=1 motor=3"),
        ("v0 mocap_frozen at=1 duration=2", "v0 mocap_lost at=3"),
        ("v0 mocap_frozen at=1", "v0 vision_frozen at=1"),
        ("v0 link_loss at=1 direction=in", "v0 link_delay at=1 direction=in"),
        ("v0 link_loss at=1 direction=in", "v0 link_loss at=1 direction=out"),
        ("v0 gps_loss", "v1 gps_loss"),
    ],
)
def test_faults_that_can_be_together_are_taken(first: str, second: str) -> None:
    emu = emulator((0.0, 0.0, 0.0), (3.0, 0.0, 0.0))
    emu.inject(parse(first))
    emu.inject(parse(second))


def test_a_fault_begins_and_ends_on_the_step_of_its_time() -> None:
    emu = emulator()
    emu.inject(parse("v0 gps_loss at=4 duration=1"))
    run_for(emu, 4.0)
    assert emu.estimator.source(0) is Source.GPS
    run_for(emu, 0.05)
    assert emu.estimator.source(0) is Source.NONE
    run_for(emu, 1.0)
    assert emu.estimator.source(0) is Source.GPS


def test_a_dead_motor_brings_the_vehicle_down() -> None:
    emu = flying()
    emu.inject(parse("v0 motor_dead motor=1"))
    run_for(emu, 3.0, streamer(emu, 0.8))
    assert height_m(emu) == 0.0
    assert emu.world.vehicles.states.motors_dead[0]


def test_a_failing_cell_costs_charge_at_once() -> None:
    emu = flying()
    before = emu.autopilots[0].battery.remaining_frac
    emu.inject(parse("v0 battery_cell drop_pct=30"))
    run_for(emu, 0.1, streamer(emu, 0.5))
    assert before - emu.autopilots[0].battery.remaining_frac == pytest.approx(0.3, abs=0.01)


def test_the_charge_of_a_failed_cell_does_not_come_back_while_the_vehicle_is_disarmed() -> None:
    emu = emulator((0.0, 0.0, 0.0))
    emu.inject(parse("v0 battery_cell drop_pct=90"))
    run_for(emu, 5.0)
    assert emu.autopilots[0].battery.remaining_frac == pytest.approx(0.1)


def test_a_hung_autopilot_is_deaf_its_clock_stands_still_and_then_it_goes_on_as_before() -> None:
    emu = flying()
    emu.inject(parse("v0 autopilot_hang duration=3"))
    send = streamer(emu, 0.49)
    run_for(emu, 0.1, send)
    clock_s = emu.clock_s(0)
    commanded = emu.world.commands.thrust_frac[0]
    run_for(emu, 2.5, streamer(emu, 0.1))
    assert emu.clock_s(0) == clock_s
    assert emu.world.commands.thrust_frac[0] == commanded  # the motors go on
    run_for(emu, 0.5, send)
    assert emu.clock_s(0) == pytest.approx(clock_s + 0.1, abs=0.02)
    assert emu.autopilots[0].is_armed
    assert emu.autopilots[0].mode is Mode.OFFBOARD
    run_for(emu, 1.0, send)
    assert emu.autopilots[0].mode is Mode.OFFBOARD


@pytest.mark.parametrize("link", ["companion", "ground", "simulator"])
def test_a_hung_autopilot_obeys_on_no_link_until_it_goes_on(link: str) -> None:
    emu = flying()
    lossy = LossyLink(emu, 0, SIMULATOR_RATES_HZ, link)

    def poll() -> None:
        lossy.poll()

    emu.inject(parse("v0 autopilot_hang duration=1"))
    run_for(emu, 0.1)
    disarm = CLIENT.encode_named(
        "COMMAND_LONG", command=400, target_system=1, target_component=1, param2=21196.0
    )
    assert lossy.receive(disarm) == []
    run_for(emu, 0.5, poll)
    assert emu.autopilots[0].is_armed
    run_for(emu, 1.0, poll)
    assert not emu.autopilots[0].is_armed


def test_a_reboot_in_flight_stops_the_motors_forgets_and_counts_anew() -> None:
    emu = flying()
    emu.autopilots[0].params.values["COM_OF_LOSS_T"] = 0.3
    charge = emu.autopilots[0].battery.remaining_frac
    emu.inject(parse("v0 autopilot_reboot"))
    run_for(emu, 0.1, streamer(emu, 0.6))
    pilot = emu.autopilots[0]
    assert not pilot.is_armed
    assert not emu.world.commands.motors_on[0]
    assert emu.disturbances.boots[0] == 1
    assert emu.clock_s(0) - pilot.boot_time_s == pytest.approx(0.1, abs=0.01)
    assert pilot.params["COM_OF_LOSS_T"] == pytest.approx(0.3)
    assert pilot.battery.remaining_frac == pytest.approx(charge, abs=0.05)
    assert emu.estimator.reset_counter(0) == 9
    assert pilot.request_arm(emu.clock_s(0), True, 0.0).value != 0  # still booting
    until(emu, lambda: height_m(emu) == 0.0, 3.0)
    run_for(emu, 5.0)
    assert emu.estimator.reset_counter(0) == 13


def test_the_log_of_a_flight_ends_with_a_reboot() -> None:
    emu = emulator()
    (logs,) = emu.keep_logs()
    run_for(emu, 5.0)
    emu.autopilots[0].request_arm(emu.time_s, True, 0.0)
    run_for(emu, 1.0)
    size = len(logs.files[0].content)
    emu.inject(parse("v0 autopilot_reboot"))
    run_for(emu, 1.0)
    assert len(logs.files[0].content) == size  # no sample with a time since the second start


def test_a_pilot_is_heard_again_after_a_reboot() -> None:
    emu = emulator()
    run_for(emu, 5.0)
    emu.inject(parse("v0 pilot"))
    run_for(emu, 0.1)
    emu.inject(parse("v0 autopilot_reboot"))
    run_for(emu, 0.1)
    assert emu.autopilots[0].has_sticks(emu.clock_s(0))


def test_after_a_ramp_the_wind_blows_as_before() -> None:
    before_enu_m_s = (4.0, 1.0, 0.0)
    environment = Environment(wind=WindSettings(mean_enu_m_s=before_enu_m_s))
    emu = Emulator(emulator().specs, environment=environment)
    emu.inject(parse("v0 wind_ramp speed_m_s=9 over_s=1 duration=2"))
    run_for(emu, 1.5)
    assert emu.world.wind.mean_enu_m_s == pytest.approx((9.0, 0.0, 0.0))
    run_for(emu, 2.0)
    assert emu.world.wind.mean_enu_m_s == pytest.approx(before_enu_m_s)


def test_a_drifting_clock_gains_or_loses() -> None:
    emu = emulator()
    emu.inject(parse("v0 clock_drift ms_per_s=-8 duration=10"))
    run_for(emu, 10.0)
    assert emu.clock_s(0) == pytest.approx(10.0 - 0.08, abs=1e-3)
    run_for(emu, 5.0)
    assert emu.clock_s(0) == pytest.approx(15.0 - 0.08, abs=1e-3)


def test_arming_can_be_refused_for_a_while() -> None:
    emu = emulator()
    run_for(emu, 5.0)
    emu.inject(parse("v0 arming_refused duration=1"))
    run_for(emu, 0.5)
    assert emu.autopilots[0].request_arm(emu.time_s, True, 0.0).value != 0
    run_for(emu, 1.0)
    assert emu.autopilots[0].request_arm(emu.time_s, True, 0.0).value == 0


def test_ignored_setpoints_keep_offboard_alive_and_change_nothing() -> None:
    emu = flying()
    emu.inject(parse("v0 setpoints_ignored duration=3"))
    run_for(emu, 0.1, streamer(emu, 0.5))
    before = emu.world.commands.thrust_frac[0]
    run_for(emu, 2.0, streamer(emu, 0.1))
    assert emu.world.commands.thrust_frac[0] == before
    assert emu.autopilots[0].mode is Mode.OFFBOARD
    run_for(emu, 1.0, streamer(emu, 0.4))
    assert emu.world.commands.thrust_frac[0] == pytest.approx(0.4)


def test_it_is_known_who_flies_when_setpoints_are_ignored_or_end() -> None:
    emu = flying()
    run_for(emu, 0.1, streamer(emu, 0.5))
    assert emu.follows_setpoints(0)
    run_for(emu, 0.25)
    assert emu.autopilots[0].mode is Mode.OFFBOARD
    assert not emu.follows_setpoints(0)

    run_for(emu, 0.1, streamer(emu, 0.5))
    assert emu.follows_setpoints(0)
    emu.inject(parse("v0 setpoints_ignored duration=0.5"))
    run_for(emu, 0.1, streamer(emu, 0.5))
    assert not emu.follows_setpoints(0)

    run_for(emu, 0.5, streamer(emu, 0.5))
    assert emu.follows_setpoints(0)
    run_for(emu, 2.0)
    assert emu.autopilots[0].mode is not Mode.OFFBOARD
    assert not emu.follows_setpoints(0)


def vision_follower(emu: Emulator, index: int, place: tuple[float, float, float]) -> None:
    """Send one vision message to a vehicle without satellites."""
    emu.autopilots[index].params.values.update({"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 0})
    emu.parameters_changed(index)
    emu.vision(index, np.array(place))


def test_external_positions_can_freeze_jump_be_swapped_late_or_lost() -> None:
    def believed(line: str) -> np.ndarray:
        emu = emulator((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), seed=2)
        emu.inject(parse(line))
        for k in range(600):
            if k % 5 == 0:
                for i, x in enumerate((1.0, 2.0)):
                    vision_follower(emu, i, (x + 1e-3 * k, 0.0, 0.0))
            emu.step()
        return np.array([emu.estimator.local(i).position_ned_m for i in (0, 1)])

    good = believed("v0 gps_loss")
    assert good[:, 0] == pytest.approx([1.6, 2.6], abs=0.15)
    assert believed("v0 vision_frozen at=1.2")[:, 0] == pytest.approx([1.3, 2.6], abs=0.15)
    assert believed("v0 vision_jump at=1.2 north_m=-2 east_m=0")[:, 0] == pytest.approx(
        [-0.4, 2.6], abs=0.15
    )
    assert believed("v0 vision_swapped at=1.2 other=v1")[:, 0] == pytest.approx(
        [2.6, 1.6], abs=0.15
    )
    assert believed("v0 vision_late at=0 delay_s=0.8")[0, 0] == pytest.approx(1.4, abs=0.15)
    lost = emulator()
    lost.inject(parse("v0 vision_lost"))
    run_for(lost, 2.0, lambda: vision_follower(lost, 0, (1.0, 0.0, 0.0)))
    assert lost.estimator.source(0) is Source.NONE


@pytest.mark.parametrize("line", ["v0 vision_lost at=3", "v0 vision_late at=3 delay_s=0.4"])
def test_a_reset_of_vision_takes_effect_when_its_message_arrives(line: str) -> None:
    emu = emulator()
    emu.inject(parse("v0 gps_loss"))
    emu.inject(parse(line))
    run_for(emu, 3.1, lambda: vision_follower(emu, 0, (1.0, 0.0, 0.0)))
    resets = emu.estimator.reset_counter(0)

    emu.vision(0, np.array([1.05, 0.0, 0.0]), reset_count=1)
    run_for(emu, 0.3)
    assert emu.estimator.source(0) is Source.VISION
    assert emu.estimator.reset_counter(0) == resets
    run_for(emu, 0.3)
    jumps = 2 if "late" in line else 0  # in the plane and in height
    assert emu.estimator.reset_counter(0) == resets + jumps


def test_a_vehicle_that_holds_on_vision_stays_where_it_is_when_vision_jumps() -> None:
    emu = emulator(seed=5)
    emu.has_global_origin[0] = True
    jump_m = 0.0

    def see() -> None:
        if emu.world.vehicles.steps % 5 == 0:
            place = emu.world.vehicles.states.position_ned_m[0] + [jump_m, 0.0, 0.0]
            vision_follower(emu, 0, tuple(place.tolist()))

    run_for(emu, 6.0, see)
    emu.autopilots[0].request(emu.time_s, Mode.TAKEOFF)
    assert emu.autopilots[0].request_arm(emu.time_s, True, 0.0).value == 0
    until(emu, lambda: emu.autopilots[0].mode is Mode.LOITER, 15.0, see)
    run_for(emu, 3.0, see)
    before = emu.world.vehicles.states.position_ned_m[0].copy()
    jump_m = 3.0
    run_for(emu, 4.0, see)
    moved = emu.world.vehicles.states.position_ned_m[0] - before
    assert np.hypot(*moved[:2]) < 1.0
    assert emu.estimator.local(0).position_ned_m[0] - before[0] == pytest.approx(3.0, abs=1.0)


def poses(line: str, duration_s: float = 2.0) -> list[tuple[float, Pose]]:
    """What a motion capture without noise gives of two bodies moving east at 1 m/s, 3 m apart."""
    emu = emulator((0.0, 0.0, 0.0), (3.0, 0.0, 0.0))
    emu.inject(parse(line))
    capture = Mocap(2, MocapSettings(noise_m=0.0), faults=emu.disturbances.mocap)
    level = np.array([[1.0, 0.0, 0.0, 0.0]] * 2)
    out = []
    for _ in range(round(duration_s / STEP_S)):
        emu.step()
        t = emu.time_s
        out += [
            (t, pose)
            for pose in capture.step(t, np.array([[t, 0.0, 0.0], [t + 3.0, 0.0, 0.0]]), level)
        ]
    return out


def test_the_motion_capture_can_freeze_jump_swap_be_late_or_lost() -> None:
    def newest(line: str) -> list[tuple[float, Pose]]:
        found = poses(line)
        return [
            next((t, pose) for t, pose in reversed(found) if pose.index == index)
            for index in (0, 1)
        ]

    x0, x1 = (pose.position_enu_m[0] for _, pose in newest("v0 gps_loss"))
    assert (x0, x1) == (pytest.approx(1.97, abs=0.03), pytest.approx(4.97, abs=0.03))
    (_, frozen), (_, other) = newest("v0 mocap_frozen at=1")
    assert frozen.position_enu_m[0] == pytest.approx(1.0, abs=0.03)
    assert frozen.is_tracked
    assert frozen.time_s == other.time_s
    assert newest("v0 mocap_jump at=1 east_m=0 up_m=0.5")[0][1].position_enu_m[2] == pytest.approx(
        0.5
    )
    (_, first), (_, second) = newest("v0 mocap_swapped at=1 other=v1")
    assert first.position_enu_m[0] - second.position_enu_m[0] == pytest.approx(3.0, abs=0.01)
    (_, flipped), _ = newest("v0 mocap_flipped at=1 yaw_deg=180")
    assert abs(flipped.quaternion_enu_flu_wxyz[3]) == pytest.approx(
        abs(other.quaternion_enu_flu_wxyz[0]), abs=0.01
    )
    (arrival_s, late), _ = newest("v0 mocap_late at=1 delay_s=0.4")
    assert arrival_s - late.time_s == pytest.approx(0.42, abs=0.01)
    (_, lost), (_, seen) = newest("v0 mocap_lost at=1")
    assert not lost.is_tracked
    assert seen.is_tracked


def test_after_a_fault_of_the_motion_capture_all_is_as_before() -> None:
    for line in (
        "v0 mocap_frozen",
        "v0 mocap_swapped other=v1",
        "v0 mocap_jump",
        "v0 mocap_flipped",
        "v0 mocap_late",
        "v0 mocap_lost",
    ):
        last = [pose for _, pose in poses(f"{line} at=0.5 duration=0.5")][-2:]
        assert [pose.position_enu_m[0] for pose in last] == pytest.approx([1.97, 4.97], abs=0.03), (
            line
        )
        assert all(pose.is_tracked for pose in last)


def test_equal_seeds_give_equal_flights_with_faults() -> None:
    ends = []
    for _ in range(2):
        emu = emulator((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), seed=9)
        emu.inject(parse("v0 motor_weak at=6 motor=1"))
        emu.inject(parse("v1 gps_loss at=5 duration=2"))
        for i in (0, 1):
            emu.attitude_setpoint(i, EAST_WXYZ, [0.0] * 3, 0.6, 7)
        run_for(emu, 8.0)
        ends.append(
            np.hstack([emu.estimator.position_ned_m, emu.estimator.velocity_ned_m_s]).copy()
        )
    np.testing.assert_array_equal(ends[0], ends[1])


def test_the_readme_names_every_fault() -> None:
    readme = (Path(__file__).resolve().parents[3] / "sitl" / "README.md").read_text(
        encoding="utf-8"
    )
    assert [name for name in FAULT_KINDS if f"`{name}`" not in readme] == []


def test_the_local_frame_begins_where_a_vehicle_by_satellites_is_rebooted() -> None:
    emu = emulator()
    run_for(emu, 1.0)
    emu.world.vehicles.states.position_ned_m[0] = (30.0, 40.0, 0.0)
    emu.inject(parse("v0 autopilot_reboot"))
    run_for(emu, 1.0)

    north_m, east_m = metres_from(emu.origin, *emu.local_origins[0][:2])
    assert (north_m, east_m) == pytest.approx((30.0, 40.0), abs=0.01)
