"""Makes the server's messages to a page: fleet file once, state ten times a second. Pure.

All messages are JSON objects with a ``kind``. Unknown numbers are null. Times are seconds of the
ground's monotonic clock, positions metres east, north, up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from groundstation.alarms.alarm_table import without_implied
from groundstation.alarms.alarms import AlarmLine
from groundstation.fleet.operator_control import Control
from groundstation.fleet.satellite_words import satellite_words
from groundstation.fleet.state import (
    FleetState,
    LoggedEvent,
    PersonView,
    Separation,
    VehicleView,
)
from groundstation.orders.kill_latch import KillLatch
from groundstation.scene.ground_tiles import GroundTiles, ground_message
from onboard.bus.schema import Telemetry
from onboard.config.fleet import FleetConfig
from onboard.config.flight_space import outlines_of
from onboard.plain_text import plain_line

_PREDICTED_S = 10.0  # time for which the path of a vehicle is predicted
_MAX_TEXT = 300  # number of letters of a text at most
_STILL_M = 0.05  # no predicted path is shown to a goal that is nearer

PageMessage = dict[str, Any]


def fleet_message(
    fleet: FleetConfig, *, can_order: bool, ground: GroundTiles | None = None
) -> PageMessage:
    """Return the part of the fleet that does not change while a page is open.

    Args:
        fleet: the fleet file.
        can_order: whether this server takes orders from its pages.
        ground: the server's pictures of the ground.
    """
    section = fleet.fleet
    vehicles = [fleet.vehicles[name] for name in fleet.enabled_names]
    fence = section.geofence_m
    return {
        "kind": "fleet",
        "name": section.name,
        "can_order": can_order,
        "vehicles": [vehicle.name for vehicle in vehicles],
        "starts_enu_m": [vehicle.start_enu_m for vehicle in vehicles],
        "top_speeds_m_s": [vehicle.max_speed_m_s for vehicle in vehicles],
        "safety_distance_m": section.safety_distance_m,
        "height_share": section.height_share,
        "body_diameter_m": section.body_diameter_m,
        "battery_warning_frac": section.battery_warning_pct / 100.0,
        "battery_land_frac": section.battery_land_pct / 100.0,
        "fence_enu_m": [
            [fence.x[0], fence.y[0], fence.z[0]],
            [fence.x[1], fence.y[1], fence.z[1]],
        ],
        "areas": [{**area._asdict(), "name": area.name[:_MAX_TEXT]} for area in outlines_of(fleet)],
        "people": [
            {"name": name, "radius_m": person.radius_m} for name, person in fleet.people.items()
        ],
        "ground": ground_message(ground, is_inside_page=False),
        "formations": sorted({*fleet.formations, *fleet.shapes}),
    }


def state_message(
    state: FleetState,
    fleet: FleetConfig,
    *,
    alarms: Sequence[AlarmLine],
    control: Control | None,
    now_ns: int,
    mission: tuple[str, bool] = ("", False),
    latch: KillLatch | None = None,
) -> PageMessage:
    """Return the fleet's present state.

    Args:
        state: the state of the fleet as the ground knows it.
        fleet: the fleet file.
        alarms: the present alarms, the most severe first.
        control: the control over the fleet; None if pages only watch.
        now_ns: time on the ground's clock.
        mission: a few words on the mission that this server flies, and whether it counts down.
        latch: the vehicles that pages have killed; None if pages only watch.
    """
    if latch is None:
        latch = KillLatch()
    mission_line, counts_down = mission
    return {
        "kind": "state",
        "time_s": now_ns * 1e-9,
        "vehicles": [_vehicle(view, fleet, latch, now_ns) for view in state.vehicles.values()],
        "people": [_person(person, now_ns) for person in state.people],
        "closest": _separation(state.closest(now_ns)),
        "smallest": _separation(state.smallest_known),
        "alarms": [_alarm(line, now_ns) for line in alarms],
        "control": _control(control),
        "mission": {"line": plain_line(mission_line)[:_MAX_TEXT], "counts_down": counts_down},
    }


def event_message(logged: LoggedEvent) -> PageMessage:
    """Return the message of an event of the fleet or of the ground."""
    event = logged.event
    return {
        "kind": "event",
        "time_s": logged.received_ns * 1e-9,
        "vehicle": plain_line(event.vehicle),
        "severity": event.severity,
        "sentence": plain_line(event.sentence)[:_MAX_TEXT],
    }


def _vehicle(view: VehicleView, fleet: FleetConfig, latch: KillLatch, now_ns: int) -> PageMessage:
    """Return one vehicle's part of the state.

    Without telemetry it is the name, the age, the last known position, and why the vehicle gets no
    orders.
    """
    telemetry = view.telemetry
    latched = latch.refusal((view.name,))
    last_enu_m = None
    if view.sighting is not None:
        last_enu_m = view.sighting.position_enu_m
    message: PageMessage = {
        "name": view.name,
        "is_fresh": view.is_fresh(now_ns),
        "age_s": _known(view.age_s(now_ns)),
        "last_enu_m": last_enu_m,
        "latched": latched,
    }
    if telemetry is None:
        return message

    position_enu_m = view.position_enu_m(now_ns)
    quaternion = None
    if view.has_truth(now_ns) and view.truth is not None:
        quaternion = view.truth.quaternion_enu_flu_wxyz
    reasons = [latched, *telemetry.not_ready]
    message.update(
        state=telemetry.state,
        reason=plain_line(telemetry.reason)[:_MAX_TEXT],
        is_armed=view.is_armed,
        is_airborne=view.is_airborne,
        is_flown_by_hand=telemetry.is_flown_by_hand,
        mode=plain_line(telemetry.mode),
        position_enu_m=position_enu_m,
        velocity_enu_m_s=telemetry.velocity_enu_m_s,
        quaternion=quaternion,
        yaw_deg=_known(telemetry.yaw_deg),
        setpoint_enu_m=telemetry.setpoint_position_enu_m,
        goal_enu_m=telemetry.goal_position_enu_m,
        way_enu_m=_way(telemetry, position_enu_m, fleet),
        battery_frac=_known(telemetry.battery_frac),
        law_status=telemetry.law_status,
        intervention_m_s2=_known(telemetry.intervention_m_s2),
        avoids=plain_line(telemetry.avoids),
        nearest=plain_line(telemetry.nearest_vehicle),
        nearest_m=_known(telemetry.nearest_distance_m),
        order=telemetry.order_kind,
        phase=telemetry.order_phase,
        show=_show_words(telemetry),
        is_paused=telemetry.is_path_paused,
        satellites=satellite_words(telemetry),
        service=_service_words(telemetry),
        wind_m_s=[_known(part) for part in telemetry.wind_enu_m_s],
        conditions=without_implied(telemetry.conditions),
        action=telemetry.action,
        blocks=[plain_line(sentence)[:_MAX_TEXT] for sentence in reasons if sentence],
        loop_p99_ms=_known(telemetry.loop_period_p99_ms),
        neighbour_age_s=_known(telemetry.neighbour_age_s),
    )
    return message


def _person(person: PersonView, now_ns: int) -> PageMessage:
    """Return a person of the fleet file; without a position if the person was never seen."""
    position_enu_m = person.position_enu_m
    if position_enu_m is not None and not all(map(math.isfinite, position_enu_m)):
        position_enu_m = None
    return {
        "name": person.name,
        "position_enu_m": position_enu_m,
        "is_fresh": person.is_fresh(now_ns),
    }


def _show_words(telemetry: Telemetry) -> str:
    """Return words on a vehicle's time on its path or on its leader; else an empty text."""
    words = ""
    if telemetry.show_id and math.isfinite(telemetry.path_time_s):
        words = f"at {max(0.0, telemetry.path_time_s):.0f} s of its path"
    elif telemetry.follows:
        words = f"follows {plain_line(telemetry.follows)[:60]}"
    if words and telemetry.is_path_paused:
        words += ", paused"
    return words


def _service_words(telemetry: Telemetry) -> str:
    """Return words on a vehicle that is disabled or stands in for another one; else empty."""
    if telemetry.disabled_by:
        return f"disabled by {plain_line(telemetry.disabled_by)[:60]}"
    if telemetry.stands_in_for:
        return f"stands in for {plain_line(telemetry.stands_in_for)[:60]}"
    return ""


def _way(
    telemetry: Telemetry, position_enu_m: Sequence[float] | None, fleet: FleetConfig
) -> list[Sequence[float]]:
    """Return both ends of the predicted path.

    It is straight to the goal, as far as the vehicle gets in ``_PREDICTED_S``. A vehicle that is
    slow now is assumed to fly with at least half its top speed.

    Returns:
        Present position and end; empty on the ground, close to the goal, or if either is unknown.
    """
    goal_enu_m = telemetry.goal_position_enu_m
    is_known = all(math.isfinite(axis_m) for axis_m in goal_enu_m)
    if position_enu_m is None or not telemetry.is_airborne or not is_known:
        return []

    distance_m = math.dist(position_enu_m, goal_enu_m)
    speed_m_s = math.hypot(*telemetry.velocity_enu_m_s)
    vehicle = fleet.vehicles.get(telemetry.vehicle)
    if vehicle is not None and distance_m > 0.1:
        speed_m_s = max(speed_m_s, 0.5 * vehicle.max_speed_m_s)
    if distance_m < _STILL_M:
        return []

    flown_share = min(1.0, _PREDICTED_S * speed_m_s / distance_m)
    end = [
        begin_m + flown_share * (goal_m - begin_m)
        for begin_m, goal_m in zip(position_enu_m, goal_enu_m, strict=True)
    ]
    return [position_enu_m, end]


def _separation(separation: Separation | None) -> PageMessage | None:
    if separation is None:
        return None
    return {
        "first": separation.first,
        "second": separation.second,
        "distance_m": _known(separation.distance_m),
        "is_truth": separation.is_truth,
        "is_flying": separation.is_flying,
    }


def _alarm(line: AlarmLine, now_ns: int) -> PageMessage:
    alarm = line.alarm
    return {
        "kind": alarm.kind.value,
        "subject": plain_line(alarm.subject),
        "severity": alarm.severity.name.lower(),
        "sentence": plain_line(alarm.sentence)[:_MAX_TEXT],
        "advice": plain_line(alarm.advice)[:_MAX_TEXT],
        "for_s": line.duration_s(now_ns),
        "count": line.count,
    }


def _control(control: Control | None) -> Mapping[str, Any] | None:
    if control is None:
        return None
    requester_label = None  # no ground requests control
    if control.requester is not None:
        requester_label = plain_line(control.requester.label)
    return {
        "text": plain_line(control.text),
        "refusal": control.refusal("move"),
        "requester": requester_label,
    }


def _known(value: float) -> float | None:
    """Return a number, or None if it is not known."""
    if not math.isfinite(value):
        return None
    return value
