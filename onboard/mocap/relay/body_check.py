"""``covey mocap --check``: whether each vehicle has the right body, axes and time stamps.

A person removes the propellers and tilts a vehicle by hand, while its PX4 and the mocap both
measure the tilt. The check finds the body with the same tilt as PX4. It only listens on the bus, so
the agents and the source of the mocap's poses must be running.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from onboard.arrays import Array
from onboard.bus.clock_sync import ClockNode
from onboard.bus.codec import Malformed
from onboard.bus.schema import Message, MocapPose, TickBatch
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from onboard.exit_status import EXIT_FAILED, EXIT_NO_ANSWER, EXIT_OK
from onboard.mocap.relay import latency
from onboard.mocap.relay.mocap_relay import bodies_of, report_times
from onboard.mocap.relay.statistics import MocapStatistics
from onboard.security.credentials import credentials_of
from onboard.security.node_roles import NodeRole
from onboard.tuples import Wxyz

GOOD_LAG_S = 0.015  # stamps with a lag of at most this need no correction
_MAX_SAMPLES = 6000  # number of samples kept for each body and each vehicle
_QUARTERS_DEG = (90, 180, 270)  # rotations of a body's axes to try

Samples = deque[tuple[float, Wxyz]]  # time [s] on this host's clock, attitude
Curve = tuple[Array, Array]  # times (n,) [s], and latency.gravity (n, 2) at these times


@dataclass(frozen=True, slots=True)
class BodyFinding:
    """Result for one vehicle's body."""

    vehicle: str
    is_ok: bool | None  # None: unknown, for instance before the vehicle has been tilted enough
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
        latency_s: latency that is already subtracted from the stamps.
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
    """Return ``is_ok`` and ``sentence`` of the finding about one vehicle."""
    px4_times_s, _ = px4
    if px4_times_s.size == 0:
        return None, "its agent publishes no attitude. Start the agent, with its PX4."

    fits: dict[str, latency.TiltFit] = {}
    for name, curve in curves.items():
        fit = latency.fit(*curve, *px4)
        if fit is not None:
            fits[name] = fit
    if not fits:
        return None, (
            "not tilted yet. Take the propellers off and tilt it by hand by 20° in all directions "
            "for some seconds."
        )

    best = max(fits, key=lambda name: fits[name].correlation)
    if best != body and fits[best].is_same:
        return False, (
            f"its PX4 tilts as body '{best}' does, not as '{body}'. Exchange the names in the "
            f'mocap\'s software, or set vehicles.{vehicle}.mocap_body = "{best}".'
        )

    own = fits.get(body)
    if own is None:
        return False, (
            f"body '{body}' was not tracked while the vehicle tilted. Check that the cameras see "
            "its markers."
        )
    if not own.is_same:
        return False, _sentence_of_axes(body, curves[body], px4, own)

    lag_ms = 1e3 * own.lag_s
    if abs(own.lag_s) > GOOD_LAG_S:
        return False, (
            f"body '{body}' is right, but its stamps are {lag_ms:+.0f} ms off the motion. Set "
            f"mocap.latency_s = {max(0.0, latency_s + own.lag_s):.3f} (now {latency_s:.3f})."
        )
    return True, (
        f"body '{body}' tilts as its PX4 does, and its stamps are right to {lag_ms:+.0f} ms."
    )


def _sentence_of_axes(body: str, curve: Curve, px4: Curve, own: latency.TiltFit) -> str:
    """Return the sentence about a body that does not tilt like its vehicle's PX4."""
    quarter_deg = _turned_deg(curve, px4)
    if quarter_deg is not None:
        return (
            f"the axes of body '{body}' are turned by about {quarter_deg}° against the vehicle. "
            "Point its nose along the mocap's x axis and reset the body's orientation in the "
            "mocap's software."
        )
    return (
        f"body '{body}' does not tilt as its PX4 does, nor does any other (correlation "
        f"{own.correlation:.2f}). Check the body's z axis, mocap.up, and that the markers are "
        "fixed to the frame."
    )


def _turned_deg(body: Curve, px4: Curve) -> int | None:
    """Return the rotation in degrees about up of the body's axes relative to the vehicle's.

    The result is None if no multiple of 90 degrees explains the difference.
    """
    times_s, gravity = body
    for degrees in _QUARTERS_DEG:
        c = np.cos(np.radians(degrees))
        s = np.sin(np.radians(degrees))
        turned = gravity @ np.array([[c, s], [-s, c]])
        fit = latency.fit(times_s, turned, *px4)
        if fit is not None and fit.is_same:
            return degrees
    return None


def _curve(samples: Samples) -> Curve:
    """Return samples as a curve of tilt with increasing times. Of equal times, only one is kept."""
    rows = sorted(samples)
    times_s = np.array([time_s for time_s, _ in rows], dtype=np.float64)
    gravity = latency.gravity([quaternion for _, quaternion in rows])
    is_later = np.diff(times_s, prepend=-np.inf) > 0.0
    return times_s[is_later], gravity[is_later]


class MocapCheck:
    """One run of the check on the bus of a fleet."""

    def __init__(self, fleet: FleetConfig, say: Callable[[str], None]) -> None:
        self.fleet = fleet
        self.say = say
        self.statistics = MocapStatistics(vehicles=bodies_of(fleet), people=fleet.people_bodies)

        agents = [fleet.vehicles[name].agent for name in fleet.enabled_names]
        self._bus = BusSession(
            namespace=fleet.namespace,
            node=f"mocap-check-{os.getpid()}",
            connect=[*agents, *fleet.pose_endpoints],
            credentials=credentials_of(fleet, NodeRole.MOCAP),
            routers=fleet.fleet.routers,
        )
        self._clock = ClockNode(self._bus)

        self._lock = threading.Lock()  # for statistics and samples, which the bus's threads fill
        self._bodies: dict[str, Samples] = {}  # body -> its attitudes
        self._px4s: dict[str, Samples] = {}  # vehicle -> its attitudes

    def run(self, *, seconds: float | None, every_s: float, stopped: threading.Event) -> int:
        """Listen until everything is right, ``stopped`` is set, or ``seconds`` have passed.

        Returns:
            the exit status.
        """
        self._bus.start()
        status = EXIT_NO_ANSWER
        try:
            self._clock.start()
            self._bus.subscribe(Topic.MOCAP, "*", self._add_pose)
            self._bus.subscribe(Topic.TICK, "*", self._add_ticks)
            for _ in report_times(self._clock, seconds=seconds, every_s=every_s, stopped=stopped):
                status = self._print()
                if status == EXIT_OK:
                    break
        finally:
            self._bus.stop()
        return status

    def _print(self) -> int:
        """Print the findings, and return their exit status."""
        with self._lock:
            self.statistics.close_window(time.monotonic_ns())
            bodies = {name: samples.copy() for name, samples in self._bodies.items()}
            px4s = {name: samples.copy() for name, samples in self._px4s.items()}
            faults = list(self.statistics.findings())

        latency_s = 0.0
        if self.fleet.mocap.source == "motioncapture":
            latency_s = self.fleet.mocap.latency_s
        findings = list(judge(self.statistics.vehicles, bodies, px4s, latency_s=latency_s))

        self.say(time.strftime("%H:%M:%S"))
        for finding in findings:
            mark = "..."
            if finding.is_ok is not None:
                mark = "ok" if finding.is_ok else "WRONG"
            self.say(f"  {mark:<5} {finding.vehicle}: {finding.sentence}")
        for sentence in faults:
            self.say(f"  ! {sentence}")

        if not bodies:
            return EXIT_NO_ANSWER
        if faults or not all(finding.is_ok for finding in findings):
            return EXIT_FAILED
        return EXIT_OK

    def _add_pose(self, _topic: Topic, _name: str, message: Message | Malformed) -> None:
        if not isinstance(message, MocapPose):
            return

        received_ns = time.monotonic_ns()
        pose = self._clock.pose(message, received_ns)  # with its stamp on this host's clock
        if pose is None:  # the clock of the pose's source is not known
            pose = replace(message, stamp_ns=received_ns)

        stamp_s = self._on_host_clock_s(message.source, message.stamp_ns)
        with self._lock:
            self.statistics.add(pose)
            if message.is_tracked and stamp_s is not None:
                samples = self._bodies.setdefault(message.body, deque(maxlen=_MAX_SAMPLES))
                samples.append((stamp_s, message.quaternion_enu_flu_wxyz))

    def _add_ticks(self, _topic: Topic, name: str, message: Message | Malformed) -> None:
        if not isinstance(message, TickBatch):
            return
        with self._lock:
            samples = self._px4s.setdefault(name, deque(maxlen=_MAX_SAMPLES))
            for tick in message.ticks:
                stamp_s = self._on_host_clock_s(name, tick.stamp_ns)
                if stamp_s is not None:
                    measured_s = stamp_s - tick.attitude_age_s
                    samples.append((measured_s, tick.attitude_quaternion_enu_flu_wxyz))

    def _on_host_clock_s(self, node: str, stamp_ns: int) -> float | None:
        """Convert a stamp [ns] of a node to this host's clock [s].

        The result is None until the offset of the node's clock is measured.
        """
        if not node:  # the stamp is by this host's clock
            return stamp_ns * 1e-9
        offset = self._clock.clocks.offset_s(node, time.monotonic_ns())
        if offset is None:
            return None
        ahead_s, _ = offset  # the estimate, and its uncertainty
        return stamp_ns * 1e-9 - ahead_s
