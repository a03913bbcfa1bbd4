"""What an independent MAVLink decoder reads of the poses that the link forwards."""

from __future__ import annotations

import math
import os
import socket
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink

from onboard.px4.mavsdk_link import Px4Link
from tests.oracles.rotation import quaternion_from_yaw

_SYSTEM = 9


class _Decoder:
    """Looks like a PX4 to the link: heartbeats out, everything that comes in is decoded by
    pymavlink.
    """

    def __init__(self, port: int) -> None:
        self.messages: list[mavlink.MAVLink_message] = []
        self.origin_mm: int | None = None  # altitude of the global origin that it tells
        self._to = ("127.0.0.1", port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.05)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._stopped.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        out = mavlink.MAVLink(None, _SYSTEM, 1)
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        beat = out.heartbeat_encode(mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, 1, 0, 3)
        next_s = 0.0
        while not self._stopped.is_set():
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + 0.2
                self._socket.sendto(beat.pack(out), self._to)
                if self.origin_mm is not None:
                    origin = out.gps_global_origin_encode(473977420, 85455940, self.origin_mm)
                    self._socket.sendto(origin.pack(out), self._to)
            try:
                data, _ = self._socket.recvfrom(2048)
            except TimeoutError:
                continue
            self.messages += parser.parse_buffer(data) or []

    def wait(self, kind: str, accept=lambda message: True) -> mavlink.MAVLink_message:
        end = time.monotonic() + 10.0
        while time.monotonic() < end:
            for message in list(self.messages):
                if message.get_type() == kind and accept(message):
                    return message
            time.sleep(0.01)
        raise AssertionError(f"no {kind} came")


@pytest.fixture
def wire() -> Iterator[tuple[Px4Link, _Decoder]]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    link = Px4Link(f"udpin://127.0.0.1:{port}", _SYSTEM)
    link.start()
    decoder = _Decoder(port)
    try:
        assert link.connect(10.0)
        yield link, decoder
    finally:
        link.stop()
        decoder.stop()


def test_a_pose_goes_out_in_px4s_axes_with_its_variance_and_its_count_and_without_a_velocity(
    wire,
) -> None:
    link, decoder = wire
    # facing 30 degrees north of east; not quite a unit quaternion, as mocaps give them
    facing = tuple(1.01 * part for part in quaternion_from_yaw(math.radians(30.0)))
    link.send_odometry((1.0, 2.0, 3.0), facing, 0.02, 255)
    sent = decoder.wait("ODOMETRY")
    assert (sent.x, sent.y, sent.z) == pytest.approx((2.0, 1.0, -3.0))  # north, east, down
    assert abs(np.linalg.norm(sent.q) - 1.0) < 1e-6  # PX4 takes 1e-5
    w, x, y, z = sent.q
    assert math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))) == pytest.approx(
        60.0, abs=1e-3
    )
    assert (abs(x), abs(y)) == pytest.approx((0.0, 0.0), abs=1e-6)  # level stays level
    assert (sent.frame_id, sent.child_frame_id) == (
        mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_BODY_FRD,
    )
    covariance = sent.pose_covariance
    assert [covariance[place] for place in (0, 6, 11)] == pytest.approx([4e-4] * 3)
    assert all(covariance[place] > 0.0 for place in (15, 18, 20))
    assert all(
        math.isnan(value)
        for value in (sent.vx, sent.vy, sent.vz, sent.rollspeed, sent.velocity_covariance[0])
    )
    assert (sent.reset_counter, sent.estimator_type, sent.quality) == (
        255,
        mavlink.MAV_ESTIMATOR_TYPE_VISION,
        100,
    )


def _until(holds) -> None:
    end = time.monotonic() + 10.0
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_tilted_body_tilts_the_same_way_in_px4s_axes(wire) -> None:
    link, decoder = wire
    half = math.radians(10.0) / 2.0
    # nose down by 10 degrees: about +y of FLU (left); PX4 counts nose up about +y of FRD (right)
    link.send_odometry((0.0, 0.0, 1.0), (math.cos(half), 0.0, math.sin(half), 0.0), 0.01)
    w, x, y, z = decoder.wait("ODOMETRY").q
    assert math.degrees(math.asin(2.0 * (w * y - z * x))) == pytest.approx(-10.0, abs=1e-3)


def test_px4_gets_its_global_origin_before_the_first_pose_and_never_between_two(wire) -> None:
    link, decoder = wire
    pose = ((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), 0.01)
    link.send_odometry(*pose)  # as a program that ran before this one may have done
    decoder.wait("ODOMETRY")
    decoder.messages.clear()
    assert not link.settle_global_origin(sets_ours=True)
    decoder.wait("COMMAND_LONG", lambda message: message.command == 512 and message.param1 == 49)
    link.send_odometry(*pose)  # withheld
    _until(
        lambda: (
            not link.settle_global_origin(sets_ours=True)
            and any(
                message.get_type() == "SET_GPS_GLOBAL_ORIGIN" for message in list(decoder.messages)
            )
        )
    )
    sent = decoder.wait("SET_GPS_GLOBAL_ORIGIN")
    assert (sent.target_system, sent.altitude) == (_SYSTEM, 0)
    assert (sent.latitude, sent.longitude) != (0, 0)
    assert not [message for message in decoder.messages if message.get_type() == "ODOMETRY"]
    decoder.origin_mm = 489_400  # of satellites: not ours
    assert not link.settle_global_origin(sets_ours=True)
    decoder.origin_mm = 0
    _until(lambda: link.settle_global_origin(sets_ours=True))
    link.send_odometry(*pose)
    decoder.wait("ODOMETRY")
