"""``covey mocap --check``: whether each vehicle has its own body, axes and stamps, by tilting it.
Listens only.

A vehicle that is tilted by hand, propellers off, tilts twice: in its PX4 and in one body. Agents
and the mocap's source must run.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from onboard.arrays import Array
from onboard.bus.clock_sync import ClockNode
from onboard.bus.codec import Malformed
from onboard.bus.schema import Message, MocapPose, TickBatch, Vec4
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from onboard.exit_status import EXIT_FAILED, EXIT_NO_ANSWER, EXIT_OK
from onboard.mocap.relay import latency
from onboard.mocap.relay.relay import bodies_of, report_times
from onboard.mocap.relay.statistics import MocapStatistics
from onboard.security.credentials import credentials_of
from onboard.security.node_roles import NodeRole

GOOD_LAG_S = 0.015
_MAX_SAMPLES = 6000
_QUARTERS = (90, 180, 270)

Samples = deque[tuple[float, Vec4]]  # time [s] on our clock, quaternion
Curve = tuple[Array, Array]  # times (n,) [s], and latency.gravity (n, 2) at them


@dataclass(frozen=True, slots=True)
class BodyFinding:
    """Result for one vehicle's body."""

    vehicle: str
    is_ok: bool | None  # None while it has not been tilted enough
    sentence: str


def judge(
    vehicles: Mapping[str, str],
    bodies: Mapping[str, Samples],
    px4s: Mapping[str, Samples],
    *,
    latency_s: float,
) -> Iterator[BodyFinding]:
    """Compare the tilts of bodies and vehicles.

    Args:
        vehicles: vehicle -> body.
        bodies: body -> attitudes that the mocap measured.
        px4s: vehicle -> attitudes that its PX4 measured.
        latency_s: latency that the stamps already account for.
    Yields:
        one finding for each vehicle.
    """
    curves = {name: _curve(samples) for name, samples in bodies.items()}
    for vehicle, body in vehicles.items():
        px4 = _curve(px4s.get(vehicle, deque()))
        yield BodyFinding(vehicle, *_judge_one(vehicle, body, curves, px4, latency_s))


def _judge_one(
    vehicle: str, body: str, curves: Mapping[str, Curve], px4: Curve, latency_s: float
) -> tuple[bool | None, str]:
    """Return ``is_ok`` and sentence of the finding."""
    fits = {
        name: fit
        for name, curve in curves.items()
        if (fit := latency.fit(*curve, *px4)) is not None
    }
    if not px4[0].size:
        return None, "its agent publishes no attitude. Start the agent, with its PX4."
    if not fits:
        tilting = (
            "Take the propellers off and tilt it by hand by 20° in all directions for some seconds."
        )
        return None, f"not tilted yet. {tilting}"
    best = max(fits, key=lambda name: fits[name].correlation)
    if best != body and fits[best].is_same:
        return False, (
            f"its PX4 tilts as body '{best}' does, not as '{body}'. Exchange the names in the mocap's software, or set "
            f'vehicles.{vehicle}.mocap_body = "{best}".'
        )
    own = fits.get(body)
    if own is None:
        return (
            False,
            f"body '{body}' was not tracked while the vehicle tilted. Check that the cameras see its markers.",
        )
    if not own.is_same:
        quarter = _turned(curves[body], px4)
        if quarter is not None:
            return False, (
                f"the axes of body '{body}' are turned by about {quarter}° against the vehicle. Point its nose along "
                "the mocap's x axis and reset the body's orientation in the mocap's software."
            )
        return False, (
            f"body '{body}' does not tilt as its PX4 does, nor does any other (correlation {own.correlation:.2f}). "
            "Check the body's z axis, mocap.up, and that the markers are fixed to the frame."
        )
    lag_ms = 1e3 * own.lag_s
    if abs(own.lag_s) > GOOD_LAG_S:
        return False, (
            f"body '{body}' is right, but its stamps are {lag_ms:+.0f} ms off the motion. Set mocap.latency_s = "
            f"{max(0.0, latency_s + own.lag_s):.3f} (now {latency_s:.3f})."
        )
    return (
        True,
        f"body '{body}' tilts as its PX4 does, and its stamps are right to {lag_ms:+.0f} ms.",
    )


def _turned(body: Curve, px4: Curve) -> int | None:
    """Return by how many degrees the body's axes are turned about up; None if that is not the only
    fault.
    """
    for degrees in _QUARTERS:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        fit = latency.fit(body[0], body[1] @ np.array([[c, s], [-s, c]]), *px4)
        if fit is not None and fit.is_same:
            return degrees
    return None


def _curve(samples: Samples) -> Curve:
    rows = sorted(samples)
    times = np.array([time_s for time_s, _ in rows], dtype=np.float64)
    keep = np.diff(times, prepend=-np.inf) > 0.0
    return times[keep], latency.gravity([quaternion for _, quaternion in rows])[keep]


class MocapCheck:
    """One run of the check on the bus of a fleet."""

    def __init__(self, fleet: FleetConfig, say: Callable[[str], None]) -> None:
        self.fleet, self.say = fleet, say
        self.statistics = MocapStatistics(bodies_of(fleet))
        endpoints = [
            *(fleet.vehicles[name].agent for name in fleet.enabled_names),
            *fleet.pose_endpoints,
        ]
        self._bus = BusSession(
            namespace=fleet.namespace,
            node=f"mocap-check-{os.getpid()}",
            connect=endpoints,
            credentials=credentials_of(fleet, NodeRole.MOCAP),
            routers=fleet.fleet.routers,
        )
        self._clock = ClockNode(self._bus)
        self._bodies: dict[str, Samples] = {}
        self._px4s: dict[str, Samples] = {}
        self._lock = threading.Lock()

    def run(self, *, seconds: float | None, every_s: float, stopped: threading.Event) -> int:
        """Listen until everything is right, ``stopped``, or for ``seconds``; return the exit
        status.
        """
        self._bus.start()
        status = EXIT_NO_ANSWER
        try:
            self._clock.start()
            self._bus.subscribe(Topic.MOCAP, "*", self._hear_pose)
            self._bus.subscribe(Topic.TICK, "*", self._hear_ticks)
            for _ in report_times(self._clock, seconds=seconds, every_s=every_s, stopped=stopped):
                status = self._print()
                if status == EXIT_OK:
                    break
        finally:
            self._bus.stop()
        return status

    def _print(self) -> int:
        with self._lock:
            self.statistics.close_window(time.monotonic_ns())
            bodies = {name: samples.copy() for name, samples in self._bodies.items()}
            px4s = {name: samples.copy() for name, samples in self._px4s.items()}
            wrong = list(self.statistics.findings())
        latency_s = (
            self.fleet.mocap.latency_s if self.fleet.mocap.source == "motioncapture" else 0.0
        )
        findings = list(judge(self.statistics.vehicles, bodies, px4s, latency_s=latency_s))
        self.say(time.strftime("%H:%M:%S"))
        for finding in findings:
            mark = {True: "ok", False: "WRONG", None: "..."}[finding.is_ok]
            self.say(f"  {mark:<5} {finding.vehicle}: {finding.sentence}")
        for sentence in wrong:
            self.say(f"  ! {sentence}")
        if not bodies:
            return EXIT_NO_ANSWER
        return EXIT_OK if all(finding.is_ok for finding in findings) and not wrong else EXIT_FAILED

    def _hear_pose(self, _topic: Topic, _name: str, message: Message | Malformed) -> None:
        if not isinstance(message, MocapPose):
            return
        own_s = self._own_s(message.source, message.stamp_ns)
        with self._lock:
            self.statistics.add(message)
            if message.is_tracked and own_s is not None:
                samples = self._bodies.setdefault(message.body, deque(maxlen=_MAX_SAMPLES))
                samples.append((own_s, message.quaternion_enu_flu_wxyz))

    def _hear_ticks(self, _topic: Topic, name: str, message: Message | Malformed) -> None:
        if not isinstance(message, TickBatch):
            return
        with self._lock:
            samples = self._px4s.setdefault(name, deque(maxlen=_MAX_SAMPLES))
            for tick in message.ticks:
                own_s = self._own_s(name, tick.stamp_ns)
                if own_s is not None:
                    samples.append(
                        (own_s - tick.attitude_age_s, tick.attitude_quaternion_enu_flu_wxyz)
                    )

    def _own_s(self, node: str, stamp_ns: int) -> float | None:
        """Return a stamp on our clock, in the middle of its bounds; None while they are not known."""
        if not node:
            return stamp_ns * 1e-9
        offset = self._clock.clocks.offset_s(node, time.monotonic_ns())
        return None if offset is None else stamp_ns * 1e-9 - offset[0]
