"""Vehicles that share a room: touching has consequences, truth has none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onboard.config.fleet import load_fleet
from sitl.bus_messages import Broadcast
from sitl.emulator.emulator import Emulator
from sitl.physics import contacts, frames
from sitl.physics.jit import records
from sitl.physics.step import MOTION
from sitl.physics.wind import Wind, WindSettings
from sitl.physics.world import SpawnError, World
from sitl.px4.modes import Mode
from tests.oracles import emulated_vehicles
from tests.sitl.sitl_flying import SIH, emulator, height_m, run_for, streamer, until

ROOT = Path(__file__).resolve().parents[3]
PAPER = load_fleet(ROOT / "configs" / "fleets" / "paper.toml")


def airborne_pair(distance_m: float) -> Emulator:
    """Two vehicles, the first one in OFFBOARD at 1 m."""
    emu = emulator((0.0, 0.0, 0.0), (distance_m, 0.0, 0.0))
    climb = streamer(emu, 0.55)
    run_for(emu, 5.0, climb)
    pilot = emu.autopilots[0]
    pilot.request(emu.time_s, Mode.OFFBOARD)
    assert pilot.request_arm(emu.time_s, True, 0.0).value == 0
    return emu


def test_a_flying_vehicle_that_touches_another_falls_with_it() -> None:
    emu = airborne_pair(0.55)
    leans_east = frames.from_yaw_and_tilt(np.array(np.pi / 2), np.array([0.0, -0.3])).tolist()
    until(emu, lambda: bool(emu.world.collisions), 3.0, streamer(emu, 0.5, leans_east))
    assert emu.world.vehicles.states.motors_dead.all()
    run_for(emu, 2.0, streamer(emu, 0.9))
    assert height_m(emu) == 0.0


def test_a_vehicle_that_hits_the_ground_on_its_side_has_collided_with_nobody() -> None:
    emu = airborne_pair(1.2)
    on_its_side = frames.from_yaw_and_tilt(np.array(np.pi / 2), np.array([-1.4, 0.0])).tolist()
    until(emu, lambda: height_m(emu) > 0.5, 5.0, streamer(emu, 0.6))
    until(
        emu,
        lambda: bool(emu.world.vehicles.states.motors_dead[0]),
        3.0,
        streamer(emu, 0.2, on_its_side),
    )
    assert height_m(emu) == 0.0
    assert emu.world.collided == set()

    emu.world.collided.add(1)  # as after a contact in the air
    vehicles = [PAPER.vehicles[name] for name in ("mav0", "mav1")]
    told = Broadcast(emu, vehicles, None, seed=1, boot_id=1, stamp_ns=lambda time_s: 0)
    _, truths = told.messages()
    assert [truth.is_collided for truth in truths] == [False, True]
    assert [truth.contacts_known_by for truth in truths] == [1, 1]


def test_vehicles_side_by_side_beyond_a_diameter_do_not_touch() -> None:
    emu = airborne_pair(0.55)
    run_for(emu, 1.5, streamer(emu, 0.52))
    assert height_m(emu) > 0.1
    assert not emu.world.collisions


def test_a_vehicle_well_above_another_does_not_touch_it() -> None:
    emu = airborne_pair(3.0)
    until(emu, lambda: height_m(emu) > 1.0, 5.0, streamer(emu, 0.6))
    emu.world.vehicles.states.position_ned_m[1, :2] = emu.world.vehicles.states.position_ned_m[
        0, :2
    ]
    run_for(emu, 0.2, streamer(emu, 0.55))
    assert not emu.world.collisions


def test_parked_vehicles_do_not_collide() -> None:
    emu = emulator((0.0, 0.0, 0.0), (0.55, 0.0, 0.0))
    emu.world.vehicles.states.position_ned_m[1] = 0.0
    run_for(emu, 1.0)
    assert not emu.world.collisions


def test_vehicles_that_would_start_inside_each_other_are_refused_in_words() -> None:
    with pytest.raises(
        SpawnError, match=r"v0 and v2 would start inside each other: 0\.20 m .* Move one"
    ):
        emulator((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.2, 0.0, 0.0))


def test_downwash_pushes_a_lower_vehicle_down_and_less_so_farther_away() -> None:
    sinks = []
    for gap_m, aside_m in ((0.5, 0.0), (1.5, 0.0), (0.5, 0.6), (-0.5, 0.0)):
        start = np.array([[0.0, 0.0, 10.0], [aside_m, 0.0, 10.0 - gap_m]])
        world = World([SIH, SIH], start, seed=0)
        world.commands.motors_on[:] = True
        world.commands.thrust_frac[:] = SIH.hover_thrust_frac
        world.vehicles.states.thrust_frac[:] = SIH.hover_thrust_frac
        for _ in range(50):
            world.step()
        sinks.append(float(world.vehicles.states.velocity_ned_m_s[1, 2]))
    assert sinks[0] > 0.1
    assert 0.0 < sinks[1] < 0.5 * sinks[0]
    assert 0.0 < sinks[2] < 0.5 * sinks[0]
    assert sinks[3] == pytest.approx(0.0, abs=1e-9)


def test_collisions_and_downwash_of_pairs_are_those_of_the_oracle() -> None:
    rng = np.random.default_rng(5)
    for case in range(50):
        n = int(rng.integers(1, 12))
        motion = records(n, MOTION)
        motion["position"] = rng.uniform(-1.0, 1.0, (n, 3))
        motion["lift_share"] = rng.uniform(0.0, 1.5, n)
        motion["on_ground"] = rng.random(n) < 0.3
        touched = np.triu(rng.random((n, n)) < 0.3, k=1)
        results = []
        for function in (contacts.find_collisions_and_downwash, emulated_vehicles.meet):
            met = touched.copy()
            push = np.ones((n, 3))
            pairs = np.zeros((200, 2), dtype=np.int64)
            count = function(motion, met, 0.5, 3.0, 0.2, push, pairs)
            results.append((count, met, push, pairs[:count]))
        for one, other in zip(*results, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-12, err_msg=f"case {case}")


def test_wind_has_its_mean_its_strength_and_its_correlation_time() -> None:
    wind = Wind(40, WindSettings((1.0, -0.5, 0.0), gust_std_m_s=0.6, gust_time_s=0.8), seed=3)
    air = np.array([wind.step() for _ in range(5000)])[500:]
    np.testing.assert_allclose(air.mean(axis=(0, 1)), [-0.5, 1.0, 0.0], atol=0.05)
    np.testing.assert_allclose(air.std(axis=(0, 1)), [0.6, 0.6, 0.3], rtol=0.1)
    later = air[200:, :, 0] + 0.5
    assert np.mean((air[:-200, :, 0] + 0.5) * later) / 0.36 == pytest.approx(np.exp(-1.0), abs=0.06)


def test_the_mean_wind_goes_straight_to_another_one_within_a_time() -> None:
    wind = Wind(2, WindSettings(), seed=1)
    wind.change_mean((4.0, -2.0, 0.0), over_s=2.0)
    air = np.array([wind.step() for _ in range(750)])
    np.testing.assert_allclose(air[249, 0], [-1.0, 2.0, 0.0], atol=0.02)
    np.testing.assert_allclose(air[-1], [[-2.0, 4.0, 0.0]] * 2, atol=1e-9)
    assert wind.mean_enu_m_s == pytest.approx((4.0, -2.0, 0.0))


def test_gusts_of_a_vehicles_own_push_it_alone() -> None:
    calm = replace(SIH, drag_1_s=0.0)
    world = World(
        [replace(calm, gust_std_m_s2=0.5), calm], np.array([[0.0, 0.0, 50.0], [9.0, 0.0, 50.0]])
    )
    world.commands.motors_on[:] = True
    world.commands.thrust_frac[:] = SIH.hover_thrust_frac
    pushes = []
    for _ in range(5000):
        world.step()
        pushes.append(world.vehicles.push_ned_m_s2.copy())
    assert np.array(pushes)[:, 0, :2].std() == pytest.approx(0.5, rel=0.4)
    assert not np.array(pushes)[:, 1].any()


def test_wind_carries_a_hovering_vehicle_away_and_common_gusts_carry_all_alike() -> None:
    start = np.array([[0.0, 0.0, 5.0], [3.0, 0.0, 5.0]])
    for is_common in (True, False):
        world = World(
            [SIH, SIH], start, seed=1, wind=WindSettings((2.0, 0.0, 0.0), 0.5, 1.0, is_common)
        )
        world.commands.motors_on[:] = True
        world.commands.thrust_frac[:] = SIH.hover_thrust_frac
        for _ in range(1000):
            world.step()
        _, velocity, _ = world.truth_enu()
        assert velocity[0, 0] == pytest.approx(2.0, abs=1.0)
        assert bool(np.allclose(velocity[0], velocity[1])) is is_common


def test_falsified_truth_changes_nothing_in_a_flight() -> None:
    tracks = []
    for falsify in (False, True):
        emu = emulator((0.0, 0.0, 0.0), (2.0, 0.0, 0.0))
        emu.autopilots[0].request(0.0, Mode.TAKEOFF)
        track = []
        for step in range(2500):
            if step == 1500:
                assert emu.autopilots[0].request_arm(emu.time_s, True, 0.0).value == 0
            emu.step()
            shown = emu.world.truth_enu()
            if falsify:
                for values in shown:
                    values += 17.0
            track.append(emu.world.vehicles.states.position_ned_m.copy())
        tracks.append(np.array(track))
    assert np.array_equal(tracks[0], tracks[1])
    assert tracks[0][-1, 0, 2] < -0.5


def test_truth_is_where_the_fleet_file_puts_the_vehicles() -> None:
    emu = emulator((1.5, -2.0, 0.0))
    position, velocity, attitude = emu.world.truth_enu()
    np.testing.assert_allclose(position[0], [1.5, -2.0, 0.0], atol=1e-12)
    assert not velocity.any()
    np.testing.assert_allclose(np.abs(attitude[0]), [1.0, 0.0, 0.0, 0.0], atol=1e-12)
