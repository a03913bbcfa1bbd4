"""What tilting the vehicles by hand tells: whose body it is, how its axes lie, and by how much its
stamps lag.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from onboard.bus.clock_offsets import Clocks
from onboard.bus.schema import ClockMessage
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, load_fleet
from onboard.mocap.relay.body_check import BodyFinding, MocapCheck, Samples, judge
from onboard.mocap.relay.statistics import MocapStatistics
from tests.onboard.bus.sessions import started, until
from tests.onboard.mocap.test_latency import quaternions, smooth
from tests.onboard.mocap.test_mocap_relay import body_pose, fleet_file

_VEHICLES = {"mav0": "a", "mav1": "b"}


def _tilted(
    seed: int, *, lag_s: float = 0.0, turned_deg: float = 0.0, size_deg: float = 8.0
) -> Samples:
    """Twelve seconds of a tilt by hand, as a source with this lag sees it whose body is turned
    about up.
    """
    times = np.arange(0.0, 12.0, 0.02)
    rng = np.random.default_rng(seed)
    tilts = smooth(rng, size_deg)(times - lag_s)
    c = math.cos(math.radians(turned_deg))
    s = math.sin(math.radians(turned_deg))
    tilts = np.array([[c, s], [-s, c]]) @ tilts
    return deque(zip(times.tolist(), quaternions(tilts, 0.7), strict=True))


def _judge(a: Samples, b: Samples, *, latency_s: float = 0.010) -> dict[str, BodyFinding]:
    px4s = {"mav0": _tilted(1), "mav1": _tilted(2)}
    return {
        found.vehicle: found
        for found in judge(_VEHICLES, {"a": a, "b": b}, px4s, latency_s=latency_s)
    }


def test_bodies_that_tilt_with_their_vehicles_are_right() -> None:
    found = _judge(_tilted(1, lag_s=0.005), _tilted(2))
    assert [each.is_ok for each in found.values()] == [True, True]


def test_bodies_with_each_others_names_are_found() -> None:
    found = _judge(_tilted(2), _tilted(1))
    assert [each.is_ok for each in found.values()] == [False, False]
    assert 'vehicles.mav0.mocap_body = "b"' in found["mav0"].sentence


@pytest.mark.parametrize("lag_s", [0.06, -0.03])
def test_stamps_that_are_off_the_motion_come_with_the_value_to_set(lag_s: float) -> None:
    found = _judge(_tilted(1, lag_s=lag_s), _tilted(2), latency_s=0.05)
    assert found["mav0"].is_ok is False
    value = float(found["mav0"].sentence.split("mocap.latency_s = ")[1].split()[0])
    assert value == pytest.approx(0.05 + lag_s, abs=0.006)
    assert found["mav1"].is_ok


@pytest.mark.parametrize("degrees", [90.0, 180.0, 270.0])
def test_a_body_whose_nose_points_elsewhere_is_found(degrees: float) -> None:
    found = _judge(_tilted(1, turned_deg=degrees), _tilted(2))
    assert found["mav0"].is_ok is False
    assert f"turned by about {degrees:.0f}°" in found["mav0"].sentence


def test_a_body_that_nothing_moves_with_is_found() -> None:
    found = _judge(_tilted(7), _tilted(2))
    assert found["mav0"].is_ok is False
    assert "does not tilt as its PX4 does" in found["mav0"].sentence


def test_a_vehicle_that_was_not_tilted_or_is_missing_is_not_judged() -> None:
    found = _judge(_tilted(1), deque())
    assert found["mav1"].is_ok is False or "not" in found["mav1"].sentence
    (alone,) = judge({"mav0": "a"}, {"a": _tilted(1)}, {}, latency_s=0.0)
    assert alone.is_ok is None
    (still,) = judge(
        {"mav0": "a"}, {"a": _tilted(1)}, {"mav0": _tilted(1, size_deg=0.05)}, latency_s=0.0
    )
    assert still.is_ok is None
    assert "propellers off" in still.sentence


def test_a_body_that_is_not_tracked_while_its_vehicle_tilts_is_wrong() -> None:
    found = _judge(deque(), _tilted(2))
    assert found["mav0"].is_ok is False
    assert "was not tracked" in found["mav0"].sentence


def test_markers_that_look_alike_from_two_sides_are_named() -> None:
    report = MocapStatistics({"mav0": "a"})
    for n in range(50):
        half = math.pi / 4 if n in (20, 21, 30) else 0.0
        report.add(
            body_pose(0.02 * n, 1e-4 * n, quaternion=(math.cos(half), 0.0, 0.0, math.sin(half)))
        )
    assert report.bodies["a"].flips == 4
    assert any("look alike from several sides" in line for line in report.findings())


class _RelayOfAnotherComputer:
    """Sends poses of body "a", with stamps by a clock that is ahead of this computer's."""

    def __init__(self, fleet: FleetConfig, ahead_s: float) -> None:
        self.bus = BusSession(
            namespace=fleet.namespace, node="mocap", listen=[fleet.simulator_endpoint]
        )
        self._ahead_ns = round(ahead_s * 1e9)
        self._clocks = Clocks("mocap", host=1)

    def _now_ns(self) -> int:
        return time.monotonic_ns() + self._ahead_ns

    def send_for(self, duration_s: float) -> None:
        self.bus.subscribe(Topic.CLOCK, "*", self._hear)
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            self.bus.publish(Topic.CLOCK, "mocap", self._clocks.message(self._now_ns()))
            pose = body_pose(1e-9 * self._now_ns(), 0.1 * math.sin(time.monotonic()))
            self.bus.publish(Topic.MOCAP, "a", replace(pose, source="mocap"))
            time.sleep(0.02)

    def _hear(self, _topic: Topic, _name: str, message: object) -> None:
        if isinstance(message, ClockMessage):
            self._clocks.hear(message, self._now_ns())


@pytest.mark.realtime
@pytest.mark.parametrize("ahead_s", [-3600.0, 3600.0])
def test_a_body_counts_as_tracked_by_when_its_poses_arrive_whatever_the_relays_clock(
    tmp_path: Path, ahead_s: float
) -> None:
    fleet = load_fleet(fleet_file(tmp_path, mav0="a"))
    relay = _RelayOfAnotherComputer(fleet, ahead_s)
    lines: list[str] = []
    check = MocapCheck(fleet, lines.append)
    stopped = threading.Event()
    options = {"seconds": None, "every_s": 0.3, "stopped": stopped}
    checking = threading.Thread(target=check.run, kwargs=options)

    with started(relay.bus):
        checking.start()
        try:
            relay.send_for(3.0)
            assert "a" in check.statistics.bodies
            assert not any("'a' is not tracked now" in line for line in lines)
            assert until(lambda: any("'a' is not tracked now" in line for line in lines))
        finally:
            stopped.set()
            checking.join()
