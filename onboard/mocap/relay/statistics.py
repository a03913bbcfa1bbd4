"""Statistics of the bodies that pass through a relay, as numbers and sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from onboard.bus.schema import MocapPose, Vec3, Vec4

_JUMP_M_S, _NOISE_M = 10.0, 0.05
_FLIP_RAD_S, _FLIP_RAD = 12.0, 0.5
_STILL_S = 1.0
_GONE_S = 1.0


@dataclass(slots=True)
class BodyStatistics:
    """Statistics of one body; counts are since the start."""

    name: str
    position_enu_m: Vec3 = (math.nan, math.nan, math.nan)
    heading_deg: float = math.nan
    rate_hz: float = 0.0  # in the last finished window
    samples: int = 0
    jumps: int = 0
    # turns faster than a vehicle's, caused by markers that look alike from several sides
    flips: int = 0
    losses: int = 0
    longest_gap_s: float = 0.0
    age_s: float = 0.0
    # for so long the same numbers have come; a body that is measured always has noise
    still_s: float = 0.0
    is_tracked: bool = False
    _quaternion: Vec4 = (0.0, 0.0, 0.0, 0.0)
    _stamp_ns: int = 0
    _changed_ns: int = 0
    _in_window: int = 0

    def add(self, pose: MocapPose) -> None:
        """Count a pose."""
        if not pose.is_tracked:
            self.losses += int(self.is_tracked)
            self.is_tracked = False
            return
        gap_s = (pose.stamp_ns - self._stamp_ns) * 1e-9 if self.samples else 0.0
        step_m = math.dist(pose.position_enu_m, self.position_enu_m) if self.samples else 0.0
        # a value that is not finite is a jump as well
        self.jumps += int(not step_m <= _NOISE_M + _JUMP_M_S * gap_s)
        cosine = abs(
            sum(a * b for a, b in zip(pose.quaternion_enu_flu_wxyz, self._quaternion, strict=True))
        )
        turn_rad = 2.0 * math.acos(min(1.0, cosine)) if self.samples else 0.0
        self.flips += int(turn_rad > min(_FLIP_RAD + _FLIP_RAD_S * gap_s, math.pi))
        self.longest_gap_s = max(self.longest_gap_s, gap_s)
        if pose.position_enu_m != self.position_enu_m:
            self._changed_ns = pose.stamp_ns
        self.still_s = (pose.stamp_ns - self._changed_ns) * 1e-9
        w, x, y, z = pose.quaternion_enu_flu_wxyz
        self.heading_deg = math.degrees(
            math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        )
        self.position_enu_m, self._quaternion = pose.position_enu_m, pose.quaternion_enu_flu_wxyz
        self._stamp_ns, self.is_tracked = pose.stamp_ns, True
        self.samples += 1
        self._in_window += 1

    def close_window(self, now_ns: int, window_s: float) -> None:
        """Finish a window of counting."""
        self.rate_hz, self._in_window = self._in_window / window_s, 0
        self.age_s = (now_ns - self._stamp_ns) * 1e-9 if self._stamp_ns else math.inf


@dataclass(slots=True)
class MocapStatistics:
    """Statistics of all bodies of a source."""

    vehicles: Mapping[str, str]  # vehicle -> its body, for those that require a mocap
    bodies: dict[str, BodyStatistics] = field(default_factory=dict)
    _window_ns: int = 0

    def add(self, pose: MocapPose) -> None:
        """Count a pose of any body."""
        body = self.bodies.get(pose.body)
        if body is None:
            body = self.bodies[pose.body] = BodyStatistics(pose.body)
        body.add(pose)

    def close_window(self, now_ns: int) -> None:
        """Finish a window of counting."""
        window_s = max(1e-3, (now_ns - self._window_ns) * 1e-9)
        for body in self.bodies.values():
            body.close_window(now_ns, window_s)
        self._window_ns = now_ns

    @property
    def is_complete(self) -> bool:
        """Whether every vehicle's body is tracked now."""
        bodies = [self.bodies.get(body) for body in self.vehicles.values()]
        return all(body is not None and body.is_tracked and body.age_s < _GONE_S for body in bodies)

    def rows(self) -> Iterator[str]:
        """Yield a line for each body, vehicles first, and one for each finding."""
        owner = {body: vehicle for vehicle, body in self.vehicles.items()}
        for name in sorted(self.bodies, key=lambda name: (name not in owner, name)):
            body = self.bodies[name]
            x, y, z = body.position_enu_m
            label = f"{name} ({owner[name]})" if name in owner and owner[name] != name else name
            yield (
                f"  {label:<18} {body.rate_hz:5.1f} Hz  at ({x:+.2f}, {y:+.2f}, {z:+.2f}) m, heading "
                f"{body.heading_deg:+.0f}°  jumps {body.jumps}, flips {body.flips}, lost {body.losses}, longest gap "
                f"{1e3 * body.longest_gap_s:.0f} ms{'' if name in owner else ' – no vehicle of the fleet'}"
            )
        yield from (f"  ! {sentence}" for sentence in self.findings())

    def findings(self) -> Iterator[str]:
        """Yield a sentence for each fault."""
        for flipped in self.bodies.values():
            if flipped.flips:
                yield (
                    f"body '{flipped.name}' turned {flipped.flips} times faster than a vehicle can: its markers look "
                    "alike from several sides. Move one marker, so that all distances between markers differ."
                )
        others = sorted(set(self.bodies) - set(self.vehicles.values()))
        for vehicle, name in self.vehicles.items():
            body = self.bodies.get(name)
            if body is None:
                known = f" Bodies that are no vehicle here: {', '.join(others)}." if others else ""
                yield (
                    f"{vehicle}: the mocap has sent no body '{name}' yet.{known} Switch it on in the mocap's "
                    f"software, rename it, or set vehicles.{vehicle}.mocap_body."
                )
            elif not body.is_tracked or body.age_s > _GONE_S:
                yield f"{vehicle}: body '{name}' is not tracked now. Check that the cameras see its markers."
            elif body.still_s > _STILL_S:
                yield (
                    f"{vehicle}: body '{name}' has sent the same numbers for {body.still_s:.0f} s. A measured body "
                    "has noise, so agents will reject it."
                )
