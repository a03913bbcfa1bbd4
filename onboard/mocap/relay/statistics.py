"""Statistics of the bodies whose poses pass through a relay, as numbers and sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from onboard.bus.schema import MocapPose
from onboard.tuples import Wxyz, Xyz

# Between two samples, a vehicle moves by at most _STEP_M plus _STEP_M_S times the time between
# them. A body that moves more has jumped.
_STEP_M = 0.05
_STEP_M_S = 10.0

# Between two samples, a vehicle rotates by at most _TURN_RAD plus _TURN_RAD_S times the time
# between them. A body that rotates more has flipped, because its markers look alike from several
# sides.
_TURN_RAD = 0.5
_TURN_RAD_S = 12.0

_STILL_S = 1.0  # a body that sends the same numbers for longer is reported
_GONE_S = 1.0  # a body without a pose for this time counts as not tracked


@dataclass(slots=True)
class BodyStatistics:
    """Statistics of one body; counts are since the start."""

    name: str
    position_enu_m: Xyz = (math.nan, math.nan, math.nan)
    heading_deg: float = math.nan
    rate_hz: float = 0.0  # in the last finished window
    samples: int = 0
    jumps: int = 0
    flips: int = 0
    losses: int = 0  # how often the body was lost
    longest_gap_s: float = 0.0  # longest time between two samples
    age_s: float = 0.0  # age of the newest sample at the end of the last window
    still_s: float = 0.0  # time with exactly the same position; a measured body has noise
    is_tracked: bool = False
    _quaternion: Wxyz = (0.0, 0.0, 0.0, 0.0)
    _stamp_ns: int = 0  # stamp of the newest sample
    _changed_ns: int = 0  # stamp of the first sample with the present position
    _in_window: int = 0  # number of samples in the open window

    def add(self, pose: MocapPose) -> None:
        """Count a pose."""
        if not pose.is_tracked:
            if self.is_tracked:
                self.losses += 1
            self.is_tracked = False
            return

        if self.samples > 0:
            self._compare_with_last(pose)

        if pose.position_enu_m != self.position_enu_m:
            self._changed_ns = pose.stamp_ns
        self.still_s = (pose.stamp_ns - self._changed_ns) * 1e-9

        w, x, y, z = pose.quaternion_enu_flu_wxyz
        heading_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        self.heading_deg = math.degrees(heading_rad)

        self.position_enu_m = pose.position_enu_m
        self._quaternion = pose.quaternion_enu_flu_wxyz
        self._stamp_ns = pose.stamp_ns
        self.is_tracked = True
        self.samples += 1
        self._in_window += 1

    def _compare_with_last(self, pose: MocapPose) -> None:
        """Count a jump or a flip since the last sample, and update the longest gap."""
        gap_s = (pose.stamp_ns - self._stamp_ns) * 1e-9
        self.longest_gap_s = max(self.longest_gap_s, gap_s)

        step_m = math.dist(pose.position_enu_m, self.position_enu_m)
        is_possible = step_m <= _STEP_M + _STEP_M_S * gap_s
        if not is_possible:  # also if the step is NaN
            self.jumps += 1

        # the scalar product of two unit quaternions is the cosine of half the angle between them
        pairs = zip(pose.quaternion_enu_flu_wxyz, self._quaternion, strict=True)
        half_turn_cosine = abs(sum(a * b for a, b in pairs))
        turn_rad = 2.0 * math.acos(min(1.0, half_turn_cosine))
        if turn_rad > _TURN_RAD + _TURN_RAD_S * gap_s:
            self.flips += 1

    def close_window(self, now_ns: int, window_s: float) -> None:
        """Finish the window in which samples are counted for the rate.

        Args:
            now_ns: end of the window.
            window_s: length of the window.
        """
        self.rate_hz = self._in_window / window_s
        self._in_window = 0

        self.age_s = math.inf
        if self._stamp_ns != 0:
            self.age_s = (now_ns - self._stamp_ns) * 1e-9


@dataclass(slots=True)
class MocapStatistics:
    """Statistics of all bodies of a source."""

    vehicles: Mapping[str, str]  # vehicle that requires a mocap -> its body
    people: Mapping[str, str] = field(default_factory=dict)  # person of the fleet file -> body
    bodies: dict[str, BodyStatistics] = field(default_factory=dict)  # body -> its statistics
    _window_ns: int = 0  # time at which the open window began

    def add(self, pose: MocapPose) -> None:
        """Count a pose of any body."""
        body = self.bodies.get(pose.body)
        if body is None:
            body = BodyStatistics(pose.body)
            self.bodies[pose.body] = body
        body.add(pose)

    def close_window(self, now_ns: int) -> None:
        """Finish the window in which samples are counted for the rates, and open the next one."""
        window_s = max(1e-3, (now_ns - self._window_ns) * 1e-9)
        for body in self.bodies.values():
            body.close_window(now_ns, window_s)
        self._window_ns = now_ns

    @property
    def is_complete(self) -> bool:
        """Whether every vehicle's body is tracked now, and does not repeat the same numbers."""
        for name in self.vehicles.values():
            body = self.bodies.get(name)
            if body is None or not body.is_tracked or body.age_s >= _GONE_S:
                return False
            if body.still_s > _STILL_S:
                return False
        return True

    def rows(self) -> Iterator[str]:
        """Yield a line for each body, with vehicles first, and a line for each fault."""
        vehicle_of = {body: vehicle for vehicle, body in self.vehicles.items()}
        person_of = {body: person for person, body in self.people.items()}
        of_vehicles = sorted(name for name in self.bodies if name in vehicle_of)
        of_others = sorted(name for name in self.bodies if name not in vehicle_of)
        for name in (*of_vehicles, *of_others):
            label = name
            if name in vehicle_of and vehicle_of[name] != name:
                label = f"{name} ({vehicle_of[name]})"
            remark = ""
            if name in person_of:
                remark = f" – a person, {person_of[name]}, whom the vehicles avoid"
            elif name not in vehicle_of:
                remark = " – no vehicle of the fleet, nobody avoids it"

            body = self.bodies[name]
            x, y, z = body.position_enu_m
            yield (
                f"  {label:<18} {body.rate_hz:5.1f} Hz  at ({x:+.2f}, {y:+.2f}, {z:+.2f}) m, "
                f"heading {body.heading_deg:+.0f}°  jumps {body.jumps}, flips {body.flips}, "
                f"lost {body.losses}, longest gap {1e3 * body.longest_gap_s:.0f} ms{remark}"
            )

        for sentence in self.findings():
            yield f"  ! {sentence}"

    def findings(self) -> Iterator[str]:
        """Yield a sentence for each fault."""
        for statistics in self.bodies.values():
            is_person = statistics.name in self.people.values()
            if statistics.flips and not is_person:  # a person's heading is not used
                yield (
                    f"body '{statistics.name}' has turned faster than a vehicle can, "
                    f"{statistics.flips} times: its markers look alike from several sides. Move "
                    "one marker, so that all distances between markers differ."
                )

        others = sorted(set(self.bodies) - {*self.vehicles.values(), *self.people.values()})
        for vehicle, name in self.vehicles.items():
            body = self.bodies.get(name)
            if body is None:
                known = ""
                if others:
                    known = f" Bodies that are no vehicle here: {', '.join(others)}."
                yield (
                    f"{vehicle}: the mocap has sent no body '{name}' yet.{known} Switch it on in "
                    f"the mocap's software, rename it, or set vehicles.{vehicle}.mocap_body."
                )
            elif not body.is_tracked or body.age_s > _GONE_S:
                yield (
                    f"{vehicle}: body '{name}' is not tracked now. Check that the cameras see its "
                    "markers."
                )
            elif body.still_s > _STILL_S:
                yield (
                    f"{vehicle}: body '{name}' has sent the same numbers for {body.still_s:.0f} s. "
                    "A measured body has noise, so agents will reject it."
                )
