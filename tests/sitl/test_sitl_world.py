"""Vehicles that share a room: touching has consequences, truth has none."""

from __future__ import annotations

import numpy as np

from sitl.emulator import Emulator
from sitl.modes import Mode
from tests.sitl.sitl_flying import emulator, height_m, run_for, streamer, until


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
    emu = airborne_pair(0.45)
    until(emu, lambda: bool(emu.world.collisions), 3.0, streamer(emu, 0.55))
    assert emu.world.vehicles.states.motors_dead.all()
    run_for(emu, 2.0, streamer(emu, 0.9))
    assert height_m(emu) == 0.0


def test_vehicles_side_by_side_beyond_a_diameter_do_not_touch() -> None:
    emu = airborne_pair(0.55)
    run_for(emu, 1.5, streamer(emu, 0.52))
    assert height_m(emu) > 0.1
    assert not emu.world.collisions


def test_a_vehicle_well_above_another_does_not_touch_it() -> None:
    emu = airborne_pair(3.0)
    until(emu, lambda: height_m(emu) > 1.0, 5.0, streamer(emu, 0.6))
    emu.world.vehicles.states.position_ned_m[1, :2] = emu.world.vehicles.states.position_ned_m[0, :2]
    run_for(emu, 0.2, streamer(emu, 0.55))
    assert not emu.world.collisions


def test_parked_vehicles_do_not_collide() -> None:
    emu = emulator((0.0, 0.0, 0.0), (0.2, 0.0, 0.0))
    run_for(emu, 1.0)
    assert not emu.world.collisions


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
