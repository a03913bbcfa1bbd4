"""Ground truth of real PX4s on the bus: the frame, the first place, and how PX4 is asked for its
rate.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from groundstation.cli import main
from onboard.bus.schema import Truth
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import load_fleet
from sitl.mavlink.codec import Decoder, Encoder
from sitl.sih_truth import Body, Listener, TruthRelay

ROOT = Path(__file__).parents[2]
GLOBAL = load_fleet(ROOT / "configs/fleets/px4-sitl.toml")
ROOM = load_fleet(ROOT / "configs/fleets/sih.toml")
HOME = {"lat": 473977420, "lon": 85455940, "alt": 489400, "vx": 0, "vy": 0, "vz": 0}
LEVEL_NORTH = [1.0, 0.0, 0.0, 0.0]


def state(**changes: int) -> dict[str, Any]:
    return {**HOME, "attitude_quaternion": LEVEL_NORTH, **changes}


def test_truth_is_placed_by_the_fleet_s_global_origin() -> None:
    body = Body(GLOBAL.vehicles["mav0"], GLOBAL.fleet.global_origin)
    body.truth(state(), 1)
    seen = body.truth(
        state(lat=473977420 + 898, lon=85455940 + 1328, alt=491400, vx=100, vy=-50, vz=-25), 2
    )
    assert seen.position_enu_m == pytest.approx((10.0, 10.0, 2.0), abs=0.02)
    assert seen.velocity_enu_m_s == pytest.approx((-0.5, 1.0, 0.25))
    assert not seen.is_on_ground


def test_in_a_room_the_first_place_counts_as_the_fleet_file_s() -> None:
    vehicle = ROOM.vehicles["mav2"]
    body = Body(vehicle, None)
    assert body.truth(state(), 1).position_enu_m == pytest.approx(vehicle.start_enu_m)
    assert body.truth(state(), 1).is_on_ground
    moved = body.truth(state(lon=85455940 + 133), 2)
    assert moved.position_enu_m[0] - vehicle.start_enu_m[0] == pytest.approx(1.0, abs=0.01)


def test_the_speed_at_which_the_ground_stops_a_vehicle_is_told_once() -> None:
    body = Body(ROOM.vehicles["mav0"], None)
    body.truth(state(), 0)
    body.truth(state(alt=490400), 10_000_000)
    for step in range(10):
        body.truth(state(alt=489500 - 7 * step, vz=70), 20_000_000 + 10_000_000 * step)

    down = [body.truth(state(alt=489430), 120_000_000 + 10_000_000 * step) for step in range(20)]
    assert {truth.touchdowns for truth in down} == {1}
    assert down[-1].touchdown_m_s == pytest.approx(0.7)


def test_a_nose_to_the_north_is_a_quarter_turn_in_the_fleet_frame() -> None:
    seen: Truth = Body(ROOM.vehicles["mav0"], None).truth(state(), 1)
    assert seen.quaternion_enu_flu_wxyz == pytest.approx((0.7071, 0.0, 0.0, 0.7071), abs=1e-4)


def test_px4_is_asked_for_its_rate_once_and_again_when_it_restarts() -> None:
    sent: list[bytes] = []

    class Transport(asyncio.DatagramTransport):
        def sendto(self, data: Any, addr: Any = None) -> None:
            sent.append(bytes(data))

    heard: list[int] = []
    listener = Listener(3, lambda fields, stamp_ns: heard.append(fields["alt"]))
    listener.connection_made(Transport())
    theirs = Encoder(system_id=3)
    other = Encoder(system_id=4)
    actuators = theirs.encode_named("HIL_ACTUATOR_CONTROLS")
    pose = theirs.encode_named("HIL_STATE_QUATERNION", **state())
    for datagram in (
        actuators,
        actuators,
        pose,
        other.encode_named("HIL_STATE_QUATERNION", **state()),
        b"\xfd\x00",
    ):
        listener.datagram_received(datagram, ("127.0.0.1", 19452))
    asked = [message.fields for one in sent for message in Decoder().decode(one)]
    assert [(fields["command"], fields["param1"]) for fields in asked] == [
        (511, 115.0),
        (511, 93.0),
    ]
    assert heard == [489400]


def test_truth_started_anew_in_flight_or_over_a_sunken_vehicle_has_the_same_zero() -> None:
    sent: list[bytes] = []

    class Transport(asyncio.DatagramTransport):
        def sendto(self, data: Any, addr: Any = None) -> None:
            sent.append(bytes(data))

    vehicle = ROOM.vehicles["mav2"]
    px4 = Encoder(system_id=3)
    for alt, height_m in ((491400, 2.0), (489100, -0.3)):
        body = Body(vehicle, None)
        truths = list[Truth]()

        def note(fields, stamp_ns, body=body, truths=truths):
            truths.append(body.truth(fields, 1))

        listener = Listener(3, note, body)
        listener.connection_made(Transport())
        flying = px4.encode_named("HIL_STATE_QUATERNION", **state(lon=85455940 + 133, alt=alt))
        listener.datagram_received(flying, ("127.0.0.1", 19452))
        assert not truths  # nothing is published before the zero is known
        for name, value in (
            ("SIH_LOC_LAT0", 47.397742),
            ("SIH_LOC_LON0", 8.545594),
            ("SIH_LOC_H0", 489.4),
        ):
            answer = px4.encode_named(
                "PARAM_VALUE", param_id=name.encode(), param_value=value, param_type=9
            )
            listener.datagram_received(answer, ("127.0.0.1", 19452))
        listener.datagram_received(flying, ("127.0.0.1", 19452))
        position = truths[-1].position_enu_m
        assert position[0] - vehicle.start_enu_m[0] == pytest.approx(1.0, abs=0.1)
        assert position[2] - vehicle.start_enu_m[2] == pytest.approx(height_m, abs=0.01)
    requests = [
        message.fields["param_id"].rstrip(b"\0").decode()
        for one in sent
        for message in Decoder().decode(one)
    ]
    assert requests[:3] == ["SIH_LOC_LAT0", "SIH_LOC_LON0", "SIH_LOC_H0"]


def test_poses_of_a_vehicle_that_stands_are_never_the_same_twice_and_come_at_fifty_hertz() -> None:
    published: list[Any] = []

    class Bus:
        def publish(self, topic: Topic, name: str, message: Any) -> None:
            published.append((topic, name, message))

    vehicle = ROOM.vehicles["mav1"]
    relay = TruthRelay(cast(BusSession, Bus()), Body(vehicle, None), with_mocap=True, boot_id=1)
    for count in range(100):
        relay.take(state(), 10_000_000 * (count + 1))
    poses = [message for topic, _, message in published if topic is Topic.MOCAP]
    assert sum(topic is Topic.TRUTH for topic, _, _ in published) == 100
    assert len(poses) == 50
    assert len({pose.position_enu_m for pose in poses}) == 50
    assert all(
        pose.position_enu_m == pytest.approx(vehicle.start_enu_m, abs=0.01) for pose in poses
    )
    assert [pose.sequence for pose in poses] == list(range(1, 51))


def test_poses_of_two_vehicles_have_different_errors() -> None:
    """The same errors would leave none in relative positions."""
    east_m: dict[str, list[float]] = {"mav0": [], "mav1": []}

    class Bus:
        def publish(self, topic: Topic, name: str, message: Any) -> None:
            if topic is Topic.MOCAP:
                east_m[name].append(message.position_enu_m[0])

    for name in east_m:
        body = Body(ROOM.vehicles[name], None)
        relay = TruthRelay(cast(BusSession, Bus()), body, with_mocap=True, boot_id=1)
        for count in range(100):
            relay.take(state(), 10_000_000 * (count + 1))
    correlation = np.corrcoef(east_m["mav0"], east_m["mav1"])[0, 1]
    assert abs(correlation) < 0.5


def test_a_wrong_fleet_file_ends_with_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sitl-truth", "--fleet", "no-such.toml"]) == 2
    assert "no-such.toml" in capsys.readouterr().err
