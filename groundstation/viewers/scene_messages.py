"""Makes messages of Foxglove's schemas about a flight: frames, scene, positions, log, fixes. Pure.

All positions are in one frame, ``fleet`` (east, north, up), the parent of a frame for each vehicle.
So the scene needs no transform. A viewer that follows a vehicle finds a transform at or before each
message, because the first transforms have the earliest stamp of the record.

A scene has an entity for each vehicle, and one for each person on a topic of its own. The next
entity with the same id replaces it; one whose position is no longer known is grey and marked. Fence
and obstacles are sent once and stay (a lifetime of 0).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.timestamp_pb2 import Timestamp

from groundstation.fleet.state import PERSON_STALE_NS, TELEMETRY_STALE_NS
from groundstation.recording.law_rows import RecordedLaw
from groundstation.recording.recorded_flight import Flight, VehicleFlight, at_times, between_times
from onboard.arrays import Array
from onboard.avoidance.half_planes import HalfPlane
from onboard.bus.schema import Event
from onboard.config.fleet_config import FleetConfig, Origin
from onboard.config.flight_space import flight_space_of
from onboard.plain_text import plain_line
from onboard.tuples import Xyz

PointEnu = tuple[float, float, float]  # metres
Quaternion = tuple[float, float, float, float]  # wxyz, from body to ENU

FRAME = "fleet"
TRAIL_S = 8.0
TRAIL_STEP_S = 0.2
MAX_GAP_S = 0.5
M_PER_M_S2 = 0.25  # length of an acceleration in the scene
PLANE_M = 0.45  # half the length of a half-plane's edge
HATCH_M = 0.09  # spacing and depth of the strokes on the side that the law forbids
_CAPSULE_CORNERS = 24
_EARTH_RADIUS_M = 6_371_000.0  # radius of the sphere in PX4's projection of its local frame
LEVEL: Quaternion = (1.0, 0.0, 0.0, 0.0)
# Colours of figures and report too; people with a common colour blindness can tell them apart.
_COLOURS = (
    (0.00, 0.45, 0.70),
    (0.84, 0.37, 0.00),
    (0.00, 0.62, 0.45),
    (0.80, 0.47, 0.65),
    (0.90, 0.62, 0.00),
    (0.34, 0.71, 0.91),
    (0.48, 0.32, 0.19),
    (0.55, 0.58, 0.61),
)
_GREY = (0.5, 0.55, 0.6)
_PERSON = (0.54, 0.35, 0.0)  # as on the pages
_PERSON_STALE_S = PERSON_STALE_NS * 1e-9
_VEHICLE_STALE_S = TELEMETRY_STALE_NS * 1e-9
# why the position of a vehicle is not known, in its label
SILENT = "silent"
NO_POSITION = "no position"
_MIN_PERSON_M = 0.1  # a person whose markers lie on the ground is drawn with this height
_LEVELS = {
    "debug": Log.DEBUG,
    "info": Log.INFO,
    "warning": Log.WARNING,
    "critical": Log.ERROR,
}


class FleetMotion:
    """Positions and attitudes of all vehicles at given times; NaN where they are not known.

    Args:
        flight: the flight.
        times_s: times (m,), rising.
    """

    def __init__(self, flight: Flight, times_s: Array) -> None:
        self.times_s = times_s
        self.positions_enu_m: dict[str, Array] = {}  # (m, 3)
        self.quaternions: dict[str, Array] = {}  # (m, 4), wxyz
        for name, vehicle in flight.vehicles.items():
            path_s, path_enu_m = vehicle.path
            self.positions_enu_m[name] = between_times(path_s, path_enu_m, times_s, MAX_GAP_S)
            self.quaternions[name] = _attitudes(vehicle, times_s)

    def position(self, name: str, index: int) -> tuple[float, float, float] | None:
        """Return a vehicle's position [m] ENU at one of the times; None if it is not known."""
        x, y, z = self.positions_enu_m[name][index]
        if math.isnan(x) or math.isnan(y) or math.isnan(z):
            return None
        return float(x), float(y), float(z)

    def quaternion(self, name: str, index: int) -> tuple[float, float, float, float]:
        """Return a vehicle's attitude at one of the times; level if it is not known."""
        w, x, y, z = self.quaternions[name][index]
        length = math.sqrt(w * w + x * x + y * y + z * z)
        if not length > 0.5:  # also true for NaN
            return LEVEL
        return float(w / length), float(x / length), float(y / length), float(z / length)


def _attitudes(vehicle: VehicleFlight, times_s: Array) -> Array:
    if vehicle.has_truth:
        truth = vehicle.truth
        return at_times(truth.time_s, truth.quaternion_enu_flu_wxyz, times_s, _VEHICLE_STALE_S)
    ticks = vehicle.ticks
    attitudes = ticks.attitude_quaternion_enu_flu_wxyz
    return at_times(ticks.time_s, attitudes, times_s, _VEHICLE_STALE_S)


# -- frames ----------------------------------------------------------------------------------------


def frame_transforms(motion: FleetMotion, index: int, stamp_ns: int) -> FrameTransforms:
    """Return the transform of every vehicle's frame at one time of a flight."""
    poses = {}
    for name in motion.positions_enu_m:
        position = motion.position(name, index)
        if position is not None:
            poses[name] = (position, motion.quaternion(name, index))
    return transforms_of(poses, stamp_ns)


def transforms_of(
    poses: Mapping[str, tuple[PointEnu, Quaternion]], stamp_ns: int
) -> FrameTransforms:
    """Return the transform of each vehicle's frame.

    Args:
        poses: position [m] ENU and attitude of each vehicle whose position is known.
        stamp_ns: timestamp of the poses.
    """
    message = FrameTransforms()
    for name, (position, quaternion) in poses.items():
        message.transforms.append(_transform(name, position, quaternion, stamp_ns))
    return message


def first_transforms(flight: Flight, stamp_ns: int) -> FrameTransforms:
    """Return a transform of every vehicle's frame at its first known position.

    Args:
        flight: the flight.
        stamp_ns: the earliest stamp of the record.
    """
    message = FrameTransforms()
    for name, vehicle in flight.vehicles.items():
        _, path_enu_m = vehicle.path
        known_enu_m = path_enu_m[np.isfinite(path_enu_m).all(-1)]
        position = (0.0, 0.0, 0.0)
        if len(known_enu_m):
            x, y, z = known_enu_m[0]
            position = (float(x), float(y), float(z))
        message.transforms.append(_transform(name, position, LEVEL, stamp_ns))
    return message


def _transform(
    name: str,
    position: tuple[float, float, float],
    quaternion: tuple[float, float, float, float],
    stamp_ns: int,
) -> FrameTransform:
    transform = FrameTransform(parent_frame_id=FRAME, child_frame_id=name)
    transform.timestamp.CopyFrom(timestamp(stamp_ns))
    translation = transform.translation
    translation.x, translation.y, translation.z = position
    rotation = transform.rotation
    rotation.w, rotation.x, rotation.y, rotation.z = quaternion
    return transform


# -- the scene -------------------------------------------------------------------------------------


def static_scene(fleet: FleetConfig, stamp_ns: int) -> SceneUpdate:
    """Return the part of the scene that never moves: fence, areas and obstacles."""
    update = SceneUpdate()
    fence = fleet.fleet.geofence_m
    entity = _entity("fence", stamp_ns)
    edges = entity.lines.add(type=LinePrimitive.LINE_LIST, thickness=1.5, scale_invariant=True)
    edges.color.CopyFrom(_colour(_GREY, 0.7))
    for ends in _box_edges((fence.x, fence.y, fence.z)):
        for x, y, z in ends:
            edges.points.add(x=x, y=y, z=z)
    update.entities.append(entity)

    for number, area in enumerate(flight_space_of(fleet).outlines()):
        opacity = 1.0
        if area.keeps_in:
            opacity = 0.7
        entity = _entity(f"area {number} {plain_line(area.name)}", stamp_ns)
        for height_m in (area.low_m, area.high_m):
            outline = entity.lines.add(
                type=LinePrimitive.LINE_LOOP, thickness=1.5, scale_invariant=True
            )
            outline.color.CopyFrom(_colour(_GREY, opacity))
            for x, y in area.corners_enu_m:
                outline.points.add(x=x, y=y, z=height_m)
        update.entities.append(entity)

    for number, obstacle in enumerate(fleet.obstacles):
        entity = _entity(f"obstacle {number} {plain_line(obstacle.name)}", stamp_ns)
        for capsule in obstacle.capsules_enu_m:
            for height_m in fence.z:
                outline = entity.lines.add(
                    type=LinePrimitive.LINE_LOOP, thickness=2.0, scale_invariant=True
                )
                outline.color.CopyFrom(_colour(_GREY, 1.0))
                outline.points.extend(_capsule(capsule, height_m))
        update.entities.append(entity)
    return update


def _box_edges(
    sides: tuple[tuple[float, float], tuple[float, float], tuple[float, float]],
) -> Iterator[tuple[list[float], list[float]]]:
    """Yield the twelve edges of a box, each as its two ends.

    Bit ``axis`` of a corner's number says whether the corner is at the upper end of that axis.
    """
    for corner in range(8):
        begin = [sides[axis][(corner >> axis) & 1] for axis in range(3)]
        for axis in range(3):
            is_at_lower_end = not (corner >> axis) & 1
            if is_at_lower_end:
                _, upper_m = sides[axis]
                end = list(begin)
                end[axis] = upper_m
                yield begin, end


def _capsule(capsule: tuple[float, ...], height_m: float) -> list[Point3]:
    """Return the outline of a capsule x1, y1, x2, y2, radius [m]; a circle if it has no length."""
    x1, y1, x2, y2, radius_m = capsule
    heading_rad = math.atan2(y2 - y1, x2 - x1)
    points = []
    for corner in range(_CAPSULE_CORNERS):
        angle_rad = heading_rad + math.pi / 2.0 + 2.0 * math.pi * corner / _CAPSULE_CORNERS
        # the first half of the corners is around the start, the second half around the end
        x, y = x1, y1
        if corner > _CAPSULE_CORNERS // 2:
            x, y = x2, y2
        points.append(
            Point3(
                x=x + radius_m * math.cos(angle_rad),
                y=y + radius_m * math.sin(angle_rad),
                z=height_m,
            )
        )
    return points


class VehicleLook(NamedTuple):
    """Everything that is drawn of a vehicle at one time."""

    number: int  # number in the fleet, which determines the colour
    name: str
    position_enu_m: PointEnu  # the last known one
    lost: str  # SILENT or NO_POSITION if its position now is not known; else empty
    quaternion: Quaternion
    trail_enu_m: Sequence[PointEnu]
    goal_enu_m: PointEnu | None  # None if it is not known
    avoided_enu_m: PointEnu | None  # position of the vehicle or person that the law avoids


def vehicle_entity(look: VehicleLook, ring_m: float, body_m: float, stamp_ns: int) -> SceneEntity:
    """Return a vehicle of the scene; of one that is lost only its body and its name, in grey.

    Args:
        look: everything that is drawn of the vehicle.
        ring_m: radius of its safety circle; 0 draws none.
        body_m: diameter of its body.
        stamp_ns: timestamp of the entity.
    """
    colour = _COLOURS[look.number % len(_COLOURS)]
    words = plain_line(look.name)
    if look.lost:
        colour = _GREY
        words += f", {look.lost}"
    x, y, z = look.position_enu_m
    entity = _entity(look.name, stamp_ns)
    _add_label(entity, words, (x, y, z), colour)

    # The body is a flat cylinder, with an arrow for its nose.
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = x, y, z
    rotation = pose.orientation
    rotation.w, rotation.x, rotation.y, rotation.z = look.quaternion
    body = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
    body.pose.CopyFrom(pose)
    body.size.x = body.size.y = body_m
    body.size.z = 0.08
    body.color.CopyFrom(_colour(colour, 0.8))
    if look.lost:
        return entity

    nose = entity.arrows.add(
        shaft_length=0.5 * body_m,
        shaft_diameter=0.03,
        head_length=0.1,
        head_diameter=0.08,
    )
    nose.pose.CopyFrom(pose)
    nose.color.CopyFrom(_colour(colour, 1.0))

    if ring_m > 0.0:
        ring = entity.lines.add(type=LinePrimitive.LINE_LOOP, thickness=2.0, scale_invariant=True)
        ring.color.CopyFrom(_colour(colour, 0.7))
        ring.points.extend(_capsule((x, y, x, y, ring_m), z))

    _add_trail(entity, look.trail_enu_m, colour)

    if look.goal_enu_m is not None:
        goal = entity.spheres.add()
        goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = look.goal_enu_m
        goal.pose.orientation.w = 1.0
        goal.size.x = goal.size.y = goal.size.z = 0.12
        goal.color.CopyFrom(_colour(colour, 0.5))

    if look.avoided_enu_m is not None:
        line = entity.lines.add(type=LinePrimitive.LINE_STRIP, thickness=4.0, scale_invariant=True)
        line.color.CopyFrom(_colour(colour, 1.0))
        for east_m, north_m, up_m in (look.position_enu_m, look.avoided_enu_m):
            line.points.add(x=east_m, y=north_m, z=up_m)
    return entity


class VehicleScenes:
    """Makes the moving part of a recorded flight's scene.

    Args:
        flight: the flight.
        motion: the vehicles' motion at the times of the scenes.
    """

    def __init__(self, flight: Flight, motion: FleetMotion) -> None:
        self._motion = motion
        self._names = tuple(flight.vehicles)
        self._ring_m = 0.0
        self._body_m = 0.5
        if flight.fleet is not None:
            self._ring_m = flight.fleet.fleet.safety_distance_m / 2.0
            self._body_m = flight.fleet.fleet.body_diameter_m

        times_s = motion.times_s
        self._goals_enu_m = {}
        self._avoided = {}
        self._tracks: dict[str, _KnownTrack] = {}
        self._heard_s: dict[str, Array] = {}  # time of each last message (m,); NaN while silent
        for name, vehicle in flight.vehicles.items():
            path_s, path_enu_m = vehicle.path
            self._tracks[name] = _KnownTrack(path_s, path_enu_m, times_s, _VEHICLE_STALE_S)
            self._heard_s[name] = at_times(path_s, path_s, times_s, _VEHICLE_STALE_S)
            telemetry = vehicle.telemetry
            self._goals_enu_m[name] = at_times(
                telemetry.time_s, telemetry.goal_position_enu_m, times_s, max_gap_s=3.0
            )
            ticks = vehicle.ticks
            avoided = np.where(ticks.intervention_m_s2 > 0.0, ticks.avoided, -1.0)
            self._avoided[name] = at_times(ticks.time_s, avoided, times_s, MAX_GAP_S)

    def at(self, index: int, stamp_ns: int) -> SceneUpdate:
        """Return the scene at one of the times."""
        update = SceneUpdate()
        for number, name in enumerate(self._names):
            track = self._tracks[name]
            position = track.last_position(index)
            if position is None:
                continue
            look = VehicleLook(
                number=number,
                name=name,
                position_enu_m=position,
                lost=self._lost(name, index),
                quaternion=self._motion.quaternion(name, index),
                trail_enu_m=_trail(track.known_enu_m, self._motion.times_s, index),
                goal_enu_m=self._goal(name, index),
                avoided_enu_m=self._avoided_position(name, index),
            )
            update.entities.append(vehicle_entity(look, self._ring_m, self._body_m, stamp_ns))
        return update

    def _lost(self, name: str, index: int) -> str:
        """Return why a vehicle's position is not known; empty if it is."""
        if self._tracks[name].is_known(index):
            return ""
        if math.isnan(self._heard_s[name][index]):
            return SILENT
        return NO_POSITION

    def _goal(self, name: str, index: int) -> PointEnu | None:
        x, y, z = self._goals_enu_m[name][index]
        if math.isnan(x) or math.isnan(y) or math.isnan(z):
            return None
        return float(x), float(y), float(z)

    def _avoided_position(self, name: str, index: int) -> PointEnu | None:
        """Return the position of the vehicle that the law avoids; None if it avoids none."""
        number = self._avoided[name][index]
        if not number >= 0.0:  # also true for NaN
            return None
        return self._motion.position(self._names[int(number)], index)


class _KnownTrack:
    """Where a vehicle or a person of a recorded flight was, and was last, at the scenes' times.

    Args:
        times_s: times (n,) of the record's positions, rising.
        positions_enu_m: the record's positions (n, 3).
        scenes_s: times (m,) of the scenes, evenly spaced.
        stale_s: age from which on a position is no longer that of now.
    """

    def __init__(
        self, times_s: Array, positions_enu_m: Array, scenes_s: Array, stale_s: float
    ) -> None:
        is_finite = np.isfinite(positions_enu_m).all(-1)
        path = (times_s[is_finite], positions_enu_m[is_finite], scenes_s)
        known_enu_m = at_times(*path, max_gap_s=stale_s)
        between_enu_m = between_times(*path, max_gap_s=stale_s)
        # positions (m, 3): NaN while they are not known
        self.known_enu_m = np.where(np.isfinite(between_enu_m), between_enu_m, known_enu_m)
        # the same, but while they are not known the last one; NaN before the first
        last_enu_m = at_times(*path, max_gap_s=math.inf)
        self._last_enu_m = np.where(np.isfinite(self.known_enu_m), self.known_enu_m, last_enu_m)

    def is_known(self, index: int) -> bool:
        """Return whether the position at one of the times is known."""
        return bool(np.isfinite(self.known_enu_m[index]).all())

    def last_position(self, index: int) -> PointEnu | None:
        """Return the last position known at one of the times [m] ENU; None before the first."""
        x, y, z = self._last_enu_m[index]
        if math.isnan(x):
            return None
        return float(x), float(y), float(z)


def _trail(path_enu_m: Array, times_s: Array, index: int) -> list[PointEnu]:
    """Return the points of the last TRAIL_S of a path, up to one of its times.

    Args:
        path_enu_m: positions (m, 3); NaN where they are not known.
        times_s: times (m,), evenly spaced.
        index: number of the trail's last time.
    """
    step_s = TRAIL_STEP_S  # at the first time the trail is one point, whatever the step is
    if index:
        step_s = times_s[1] - times_s[0]
    stride = max(1, round(TRAIL_STEP_S / step_s))
    begin = max(0, index - round(TRAIL_S / step_s))
    points_enu_m = path_enu_m[begin : index + 1 : stride]
    points_enu_m = points_enu_m[np.isfinite(points_enu_m).all(-1)]
    return [(float(x), float(y), float(z)) for x, y, z in points_enu_m]


class PersonLook(NamedTuple):
    """Everything that is drawn of a person at one time."""

    name: str
    radius_m: float  # of the circle that the vehicles keep clear of
    position_enu_m: PointEnu  # where the motion capture saw the markers last
    is_seen: bool  # whether it sees them now
    trail_enu_m: Sequence[PointEnu]


def person_entity(look: PersonLook, stamp_ns: int) -> SceneEntity:
    """Return a person of the scene: a cylinder from the ground to the markers, and the path.

    Args:
        look: everything that is drawn of the person.
        stamp_ns: timestamp of the entity.
    """
    colour = _PERSON
    words = plain_line(look.name)
    if not look.is_seen:
        colour = _GREY
        words += ", not seen"
    x, y, z = look.position_enu_m
    height_m = max(z, _MIN_PERSON_M)
    entity = _entity(look.name, stamp_ns)

    body = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
    body.pose.position.x, body.pose.position.y, body.pose.position.z = x, y, height_m / 2.0
    body.pose.orientation.w = 1.0
    body.size.x = body.size.y = 2.0 * look.radius_m
    body.size.z = height_m
    body.color.CopyFrom(_colour(colour, 0.4))

    on_ground = [(east_m, north_m, 0.0) for east_m, north_m, _ in look.trail_enu_m]
    _add_trail(entity, on_ground, colour)
    _add_label(entity, words, (x, y, height_m), colour)
    return entity


class PeopleScenes:
    """Draws the persons of a recorded flight: an entity for each one who was seen.

    Args:
        flight: the flight.
        times_s: times (m,) of the scenes, evenly spaced.
    """

    def __init__(self, flight: Flight, times_s: Array) -> None:
        self._times_s = times_s
        self._radii_m: dict[str, float] = {}
        self._tracks: dict[str, _KnownTrack] = {}
        if flight.fleet is None:
            return

        for name, person in flight.people.items():
            self._radii_m[name] = flight.fleet.people[name].radius_m
            self._tracks[name] = _KnownTrack(
                person.time_s, person.position_enu_m, times_s, _PERSON_STALE_S
            )

    @property
    def has_people(self) -> bool:
        """Whether somebody was seen in the flight."""
        return bool(self._radii_m)

    def at(self, index: int, stamp_ns: int) -> SceneUpdate:
        """Return the scene at one of the times."""
        update = SceneUpdate()
        for name, radius_m in self._radii_m.items():
            track = self._tracks[name]
            position = track.last_position(index)
            if position is None:
                continue
            look = PersonLook(
                name=name,
                radius_m=radius_m,
                position_enu_m=position,
                is_seen=track.is_known(index),
                trail_enu_m=_trail(track.known_enu_m, self._times_s, index),
            )
            update.entities.append(person_entity(look, stamp_ns))
        return update


class LawScenes:
    """Draws the half-planes of the law in a recorded flight: an entity for each vehicle.

    Args:
        flight: the flight.
        motion: the vehicles' motion at the times of the scenes.
    """

    def __init__(self, flight: Flight, motion: FleetMotion) -> None:
        self._motion = motion
        self._vehicles = flight.vehicles
        self._law = RecordedLaw(flight)

    def at(self, index: int, stamp_ns: int) -> SceneUpdate:
        """Return the scene at one of the times.

        The entity of a vehicle for which the law does not intervene is empty, which removes its
        last half-plane.
        """
        update = SceneUpdate()
        for number, name in enumerate(self._vehicles):
            update.entities.append(self._entity(number, name, index, stamp_ns))
        return update

    def _entity(self, number: int, name: str, index: int, stamp_ns: int) -> SceneEntity:
        entity = _entity(name, stamp_ns)
        ticks = self._vehicles[name].ticks
        time_s = float(self._motion.times_s[index])
        tick = int(np.searchsorted(ticks.time_s, time_s, side="right")) - 1
        position = self._motion.position(name, index)
        if tick < 0 or time_s - ticks.time_s[tick] > MAX_GAP_S or position is None:
            return entity
        row = self._law.row(name, tick)
        if row is None:
            return entity

        colour = _COLOURS[number % len(_COLOURS)]
        _add_half_plane(entity, position, row, colour)
        thrust_before = ticks.thrust_baseline_enu_m_s2[tick]
        thrust_after = ticks.thrust_safe_enu_m_s2[tick]
        for thrust_enu_m_s2, opacity in ((thrust_before, 0.4), (thrust_after, 1.0)):
            east_m_s2, north_m_s2, _ = thrust_enu_m_s2
            horizontal_m_s2 = (float(east_m_s2), float(north_m_s2))
            _add_thrust(entity, position, horizontal_m_s2, _colour(colour, opacity))
        return entity


def _add_half_plane(
    entity: SceneEntity, position: PointEnu, row: HalfPlane, colour: tuple[float, float, float]
) -> None:
    """Add the edge of a half-plane of accelerations, hatched on the side that the law forbids.

    Args:
        entity: the vehicle's entity.
        position: the vehicle's position, which stands for no acceleration.
        row: the half-plane; its normal has unit length.
        colour: the vehicle's colour.
    """
    lines = entity.lines.add(type=LinePrimitive.LINE_LIST, thickness=2.0, scale_invariant=True)
    lines.color.CopyFrom(_colour(colour, 0.9))
    edge_m = M_PER_M_S2 * row.bound_m_s2  # distance of the edge along the normal
    x, y, z = position

    def add(along_m: float, depth_m: float) -> None:
        """Add a point by its distance along the edge and its depth in the forbidden side."""
        lines.points.add(
            x=x + (edge_m - depth_m) * row.normal.x - along_m * row.normal.y,
            y=y + (edge_m - depth_m) * row.normal.y + along_m * row.normal.x,
            z=z,
        )

    add(-PLANE_M, 0.0)
    add(PLANE_M, 0.0)
    for stroke in range(round(2.0 * PLANE_M / HATCH_M)):
        along_m = stroke * HATCH_M - PLANE_M
        add(along_m, 0.0)
        add(along_m + HATCH_M, HATCH_M)


def _add_thrust(
    entity: SceneEntity,
    position: PointEnu,
    thrust_m_s2: tuple[float, float],
    colour: Color,
) -> None:
    """Add a horizontal thrust as a line from the vehicle."""
    line = entity.lines.add(type=LinePrimitive.LINE_STRIP, thickness=3.0, scale_invariant=True)
    line.color.CopyFrom(colour)
    x, y, z = position
    east_m_s2, north_m_s2 = thrust_m_s2
    line.points.add(x=x, y=y, z=z)
    line.points.add(x=x + M_PER_M_S2 * east_m_s2, y=y + M_PER_M_S2 * north_m_s2, z=z)


def _add_trail(
    entity: SceneEntity, trail_enu_m: Sequence[Xyz], colour: tuple[float, float, float]
) -> None:
    """Add the line of a trail, if it has two points."""
    if len(trail_enu_m) < 2:
        return
    trail = entity.lines.add(type=LinePrimitive.LINE_STRIP, thickness=2.5, scale_invariant=True)
    trail.color.CopyFrom(_colour(colour, 0.8))
    for east_m, north_m, up_m in trail_enu_m:
        # Finer digits than millimetres are noise, and do not compress.
        trail.points.add(x=round(east_m, 3), y=round(north_m, 3), z=round(up_m, 3))


def _add_label(
    entity: SceneEntity, text: str, top_enu_m: Xyz, colour: tuple[float, float, float]
) -> None:
    """Add a text that faces the viewer, a little above a point."""
    x, y, z = top_enu_m
    label = entity.texts.add(billboard=True, font_size=14.0, scale_invariant=True, text=text)
    label.pose.position.x, label.pose.position.y, label.pose.position.z = x, y, z + 0.25
    label.color.CopyFrom(_colour(colour, 1.0))


def _entity(name: str, stamp_ns: int) -> SceneEntity:
    """Return an empty entity, which stays until another entity with its name replaces it."""
    entity = SceneEntity(frame_id=FRAME, id=plain_line(name))
    entity.timestamp.CopyFrom(timestamp(stamp_ns))
    return entity


# -- positions, log, fixes -------------------------------------------------------------------------


def positions(motion: FleetMotion, index: int, stamp_ns: int) -> PointCloud:
    """Return all vehicles of a flight as points at one time."""
    known = [
        (number, motion.position(name, index)) for number, name in enumerate(motion.positions_enu_m)
    ]
    points = {number: position for number, position in known if position is not None}
    return cloud_of(points, stamp_ns)


def cloud_of(points: Mapping[int, PointEnu], stamp_ns: int) -> PointCloud:
    """Return vehicles as points, which viewers without scenes can show too.

    Args:
        points: known positions [m] ENU by the vehicles' numbers.
        stamp_ns: timestamp of the positions.
    """
    cloud = PointCloud(frame_id=FRAME, point_stride=16)
    cloud.timestamp.CopyFrom(timestamp(stamp_ns))
    cloud.pose.orientation.w = 1.0
    for number, name in enumerate(("x", "y", "z")):
        cloud.fields.add(name=name, offset=4 * number, type=PackedElementField.FLOAT32)
    for number, name in enumerate(("red", "green", "blue", "alpha")):
        # after the three floats
        cloud.fields.add(name=name, offset=12 + number, type=PackedElementField.UINT8)

    data = bytearray()
    for number, position in points.items():
        red, green, blue = (round(255 * part) for part in _COLOURS[number % len(_COLOURS)])
        data += struct.pack("<fff4B", *position, red, green, blue, 255)
    cloud.data = bytes(data)
    return cloud


def log_lines(flight: Flight) -> Iterator[tuple[float, Log]]:
    """Yield events and orders as lines of a log, with their times [s]."""
    for time_s, event in flight.events:
        yield time_s, event_line(event)
    for order in flight.orders:
        line = Log(level=Log.INFO, name=plain_line(order.vehicle))
        line.message = plain_line(f"order: {order.text}; {order.answer}; {order.end}")
        yield order.at_s, line


def event_line(event: Event) -> Log:
    """Return an event as a line of a log, without its time."""
    line = Log(level=_LEVELS.get(event.severity, Log.INFO), name=plain_line(event.vehicle))
    line.message = plain_line(f"{event.code}: {event.sentence}")
    return line


def location_fix(
    position: tuple[float, float, float], origin: Origin, stamp_ns: int
) -> LocationFix:
    """Return a vehicle's position on Earth, taken as a sphere as in PX4's local frame.

    Args:
        position: position in the fleet's frame [m], ENU.
        origin: the frame's origin.
        stamp_ns: timestamp of the position.
    """
    fix = LocationFix(frame_id=FRAME)
    fix.timestamp.CopyFrom(timestamp(stamp_ns))
    east_m, north_m, up_m = position
    fix.latitude = origin.latitude_deg + math.degrees(north_m / _EARTH_RADIUS_M)
    shrink = math.cos(math.radians(origin.latitude_deg))  # of circles of latitude
    fix.longitude = origin.longitude_deg + math.degrees(east_m / _EARTH_RADIUS_M / shrink)
    fix.altitude = origin.altitude_m + up_m
    fix.position_covariance_type = LocationFix.UNKNOWN
    return fix


def timestamp(stamp_ns: int) -> Timestamp:
    """Return a stamp as a message of protobuf."""
    return Timestamp(seconds=stamp_ns // 1_000_000_000, nanos=stamp_ns % 1_000_000_000)


def _colour(rgb: tuple[float, float, float], opacity: float) -> Color:
    red, green, blue = rgb
    return Color(r=red, g=green, b=blue, a=opacity)
