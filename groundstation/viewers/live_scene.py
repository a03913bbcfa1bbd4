"""Makes messages of Foxglove's schemas about a flying fleet, on the topics of a viewer record."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Container, Mapping
from typing import Any

from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from groundstation.fleet.state import FleetState, VehicleView
from groundstation.viewers.scene_messages import (
    LEVEL,
    NO_POSITION,
    SILENT,
    TRAIL_S,
    TRAIL_STEP_S,
    PersonLook,
    PointEnu,
    Quaternion,
    VehicleLook,
    cloud_of,
    location_fix,
    person_entity,
    transforms_of,
    vehicle_entity,
)
from onboard.config.fleet import FleetConfig

_NO_INTERVENTION = ("", "inactive")  # words of the law's status while it changes nothing


class LiveScene:
    """Makes the moving part of a flying fleet's scene; keeps the trails of vehicles and persons.

    Args:
        fleet: the fleet file.
    """

    def __init__(self, fleet: FleetConfig) -> None:
        self._fleet = fleet
        points = round(TRAIL_S / TRAIL_STEP_S)
        self._trails: dict[str, deque[PointEnu]] = {
            name: deque(maxlen=points) for name in (*fleet.vehicles, *fleet.people)
        }
        self._trailed_ns = 0  # time at which the trails were last extended

    def messages(self, state: FleetState, now_ns: int, stamp_ns: int) -> list[tuple[str, Any]]:
        """Return the fleet's present state as topics and messages of protobuf.

        Args:
            state: the state of the fleet as the ground knows it.
            now_ns: time on the ground's clock.
            stamp_ns: timestamp of the messages.
        """
        known: dict[str, PointEnu] = {}  # positions of the vehicles that have one now
        lost: dict[str, PointEnu] = {}  # last positions of the vehicles that have none now
        for name, view in state.vehicles.items():
            position = view.position_enu_m(now_ns)
            sighting = view.sighting
            if position is not None and all(map(math.isfinite, position)):
                known[name] = position
            elif sighting is not None and all(map(math.isfinite, sighting.position_enu_m)):
                lost[name] = sighting.position_enu_m
        people = _known_people(state)
        seen = {
            person.name: people[person.name]
            for person in state.people
            if person.name in people and person.is_fresh(now_ns)
        }
        self._extend_trails({**known, **seen}, now_ns)

        # the enabled vehicles come first, then the disabled ones that were heard
        numbers = {name: number for number, name in enumerate(state.vehicles)}
        poses = {
            name: (position, _attitude(state.vehicles[name], now_ns))
            for name, position in known.items()
        }

        scene = SceneUpdate()
        section = self._fleet.fleet
        positions = {**people, **known}
        for name, position in {**known, **lost}.items():
            view = state.vehicles[name]
            why_lost = ""
            if name in lost and view.is_fresh(now_ns):
                why_lost = NO_POSITION
            elif name in lost:
                why_lost = SILENT
            look = VehicleLook(
                number=numbers[name],
                name=name,
                position_enu_m=position,
                lost=why_lost,
                quaternion=_attitude(view, now_ns),
                trail_enu_m=list(self._trails[name]),
                goal_enu_m=_goal(view),
                avoided_enu_m=positions.get(_avoided(view)),
            )
            entity = vehicle_entity(
                look, section.safety_distance_m / 2.0, section.body_diameter_m, stamp_ns
            )
            scene.entities.append(entity)

        points = {numbers[name]: position for name, position in known.items()}
        messages: list[tuple[str, Any]] = [
            ("/tf", transforms_of(poses, stamp_ns)),
            ("/scene", scene),
            ("/positions", cloud_of(points, stamp_ns)),
        ]
        if self._fleet.people:
            messages.append(("/scene/people", self._people_scene(people, seen, stamp_ns)))
        if section.global_origin is not None:
            for name, position in known.items():
                fix = location_fix(position, section.global_origin, stamp_ns)
                messages.append((f"/fix/{name}", fix))
        return messages

    def _people_scene(
        self, people: Mapping[str, PointEnu], seen: Container[str], stamp_ns: int
    ) -> SceneUpdate:
        """Return the scene of the persons.

        Args:
            people: where each one was seen last, by name.
            seen: names of those who are seen now.
            stamp_ns: timestamp of the scene.
        """
        scene = SceneUpdate()
        for name, position in people.items():
            look = PersonLook(
                name=name,
                radius_m=self._fleet.people[name].radius_m,
                position_enu_m=position,
                is_seen=name in seen,
                trail_enu_m=list(self._trails[name]),
            )
            scene.entities.append(person_entity(look, stamp_ns))
        return scene

    def _extend_trails(self, known: dict[str, PointEnu], now_ns: int) -> None:
        if now_ns - self._trailed_ns < TRAIL_STEP_S * 1e9:
            return
        self._trailed_ns = now_ns
        for name, position in known.items():
            self._trails[name].append(position)


def _known_people(state: FleetState) -> dict[str, PointEnu]:
    """Return where each person was seen last, by name; without those who were never seen."""
    positions: dict[str, PointEnu] = {}
    for person in state.people:
        position = person.position_enu_m
        if position is not None and all(map(math.isfinite, position)):
            positions[person.name] = position
    return positions


def _attitude(view: VehicleView, now_ns: int) -> Quaternion:
    """Return a vehicle's attitude: the true one in simulation, else its heading."""
    if view.truth is not None and view.has_truth(now_ns):
        w, x, y, z = view.truth.quaternion_enu_flu_wxyz
        return w, x, y, z
    if view.telemetry is None or not math.isfinite(view.telemetry.yaw_deg):
        return LEVEL
    half_yaw_rad = math.radians(view.telemetry.yaw_deg) / 2.0
    return math.cos(half_yaw_rad), 0.0, 0.0, math.sin(half_yaw_rad)


def _goal(view: VehicleView) -> PointEnu | None:
    if view.telemetry is None or not view.is_airborne:
        return None
    x, y, z = view.telemetry.goal_position_enu_m
    if not all(map(math.isfinite, (x, y, z))):
        return None
    return x, y, z


def _avoided(view: VehicleView) -> str:
    """Return the name of the vehicle or person that the law avoids; empty if it avoids none.

    An obstacle, the fence or the tilt limit can be the reason for an intervention, too.
    """
    if view.telemetry is None or view.telemetry.law_status.lower() in _NO_INTERVENTION:
        return ""
    return view.telemetry.avoids
