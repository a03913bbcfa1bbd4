"""Packs the data of a report: a flight on one grid of times, in few bytes.

Format, before it is deflated: the length of the header (4 bytes, little-endian), the header (JSON),
then the columns as :mod:`groundstation.report.columns` packs them, in the header's order.
:func:`_header` makes the header; ``payload.js`` reads it.

All texts are cleaned of control characters and cut here. They still come from outside and may
contain HTML: the page shows them by ``textContent`` only.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import msgspec
import numpy as np

from groundstation.px4_logs.flight_logs import FoundLogs
from groundstation.recording.flight_report import TrueMotion, separations
from groundstation.recording.recorded_flight import (
    PATH_GAP_S,
    Flight,
    VehicleFlight,
    at_times,
    between_times,
    largest_in_cells,
    largest_indexes,
)
from groundstation.report.chosen_values import settings
from groundstation.report.columns import Column, packed
from groundstation.report.law_columns import law_columns
from groundstation.report.px4_columns import px4_columns, px4_header
from groundstation.scene.ground_tiles import GroundTiles, ground_message
from groundstation.verdict.verdict import fall_sentences
from onboard.arrays import Array
from onboard.bus.schema import Event
from onboard.config.flight_space import flight_space_of
from onboard.plain_text import plain_line, plain_lines

FORMAT = 1
MAX_SAMPLES = 150_000  # most samples of a curve, all vehicles together
STEPS_S = (0.02, 0.04, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
MAX_EVENTS = 5_000  # most events, and most orders; of more, the most severe events are shown
MAX_PAIRS = 4_950  # number of pairs of a hundred vehicles
MAX_TEXT = 400  # letters of a sentence
MAX_MISSION = 60_000  # letters of a mission file
_SEVERITIES = ("critical", "warning", "info", "debug")
_PERSON_GAP_S = 0.5
_TICK_GAP_S = 0.3
_TELEMETRY_GAP_S = 3.0
_HEAD = struct.Struct("<I")

# Resolutions of the columns.
_METRE = 0.001
_ANGLE = 1.0 / 32_000.0  # component of a quaternion
_ACCELERATION = 0.005
_SECOND = 0.001
_FRACTION = 0.0005

# Telemetry's words for a fix, as numbers of MAVLink's GPS_FIX_TYPE.
FIX_NUMBERS = {
    "no receiver": 0.0,
    "no fix": 1.0,
    "2D": 2.0,
    "3D": 3.0,
    "DGPS": 4.0,
    "RTK float": 5.0,
    "RTK fixed": 6.0,
    "static": 7.0,
    "PPP": 8.0,
}


def payload(
    flight: Flight,
    *,
    made_by: str,
    ghost: Flight | None = None,
    logs: FoundLogs = FoundLogs({}, ()),  # noqa: B008 - a frozen value
    ground: GroundTiles | None = None,
) -> bytes:
    """Return the data of a report, deflated.

    Args:
        flight: the flight to show.
        made_by: name and version of this program.
        ghost: another flight of the same vehicles, shown beside it from the same lift-off.
        logs: PX4's own logs on the record's clock.
        ground: pictures of the ground below the flight; shown only if its fleet file is known.
    """
    step_s = _step_s(flight)
    grid_s = np.arange(flight.begin_s, flight.length_s + step_s / 2.0, step_s)

    columns: list[Column] = []
    for number, vehicle in enumerate(flight.vehicles.values()):
        columns += _columns(number, vehicle, tuple(flight.vehicles), grid_s, step_s)
        if vehicle.name in logs.logs:
            columns += px4_columns(number, vehicle, logs.logs[vehicle.name], grid_s)
    columns += law_columns(flight, grid_s, _TICK_GAP_S)
    columns += _people_columns(flight, grid_s)
    if ghost is not None:
        columns += _ghost_columns(flight, ghost, grid_s)

    header = _header(flight, made_by, grid_s, step_s, columns)
    if header["fleet"] is not None:
        header["fleet"]["ground"] = ground_message(ground, is_inside_page=True)
    header["px4"] = px4_header(logs, tuple(flight.vehicles))
    header["notes"] += [_text(note) for note in logs.notes]
    if ghost is not None:
        header["ghost"] = _text(ghost.title)

    head = msgspec.json.encode(header)
    parts = [_HEAD.pack(len(head)), head, *(column.data for column in columns)]
    return zlib.compress(b"".join(parts), level=6)


def _step_s(flight: Flight) -> float:
    """Return the finest step with which a curve of all vehicles has at most MAX_SAMPLES."""
    for step_s in STEPS_S:
        if len(flight.vehicles) * flight.length_s / step_s <= MAX_SAMPLES:
            return step_s
    return STEPS_S[-1]


# -- curves ----------------------------------------------------------------------------------------


def _columns(
    number: int, vehicle: VehicleFlight, names: tuple[str, ...], grid_s: Array, step_s: float
) -> Iterator[Column]:
    """Yield the curves of one vehicle that the record contains."""
    yield from _path_columns(number, vehicle, grid_s)
    if vehicle.ticks.size:
        yield from _tick_columns(number, vehicle, names, grid_s, step_s)
    if vehicle.telemetry.time_s.size:
        yield from _telemetry_columns(number, vehicle, grid_s, step_s)


def _path_columns(number: int, vehicle: VehicleFlight, grid_s: Array) -> Iterator[Column]:
    """Yield one vehicle's path, when it is up, and its attitude: the true ones if recorded."""
    times_s, positions_enu_m = vehicle.path
    path_enu_m = between_times(times_s, positions_enu_m, grid_s, PATH_GAP_S)
    yield from _axes(number, "", path_enu_m, _METRE)
    is_up = at_times(times_s, vehicle.is_up.astype(np.float64), grid_s, PATH_GAP_S)
    yield packed(f"{number}/is_up", is_up, 1.0)

    truth = vehicle.truth
    ticks = vehicle.ticks
    if vehicle.has_truth:
        attitude = at_times(truth.time_s, truth.quaternion_enu_flu_wxyz, grid_s, _TICK_GAP_S)
    elif ticks.size:
        attitude = at_times(
            ticks.time_s, ticks.attitude_quaternion_enu_flu_wxyz, grid_s, _TICK_GAP_S
        )
    else:
        return
    for part, name in enumerate("wxyz"):
        yield packed(f"{number}/q{name}", attitude[:, part], _ANGLE)


def _people_columns(flight: Flight, grid_s: Array) -> Iterator[Column]:
    """Yield the paths of all persons."""
    for index, track in enumerate(flight.people.values()):
        path_enu_m = between_times(track.time_s, track.position_enu_m, grid_s, _PERSON_GAP_S)
        yield from _axes(f"person{index}", "", path_enu_m, _METRE)


def _tick_columns(
    number: int, vehicle: VehicleFlight, names: tuple[str, ...], grid_s: Array, step_s: float
) -> Iterator[Column]:
    """Yield the curves from the agent's ticks: position, law, throttle, timing."""
    ticks = vehicle.ticks

    def shown(values: Array) -> Array:
        """Return values at the times of the grid."""
        return at_times(ticks.time_s, values, grid_s, _TICK_GAP_S)

    edges_s = np.append(grid_s - step_s / 2.0, grid_s[-1] + step_s / 2.0)

    def largest(values: Array) -> Array:
        """Return the largest value in each step, for quantities that peak for a few ticks only.

        A step without a tick has the last value: ticks jitter from one step into the next.
        """
        largest_values = largest_in_cells(ticks.time_s, values, edges_s)
        return np.where(np.isfinite(largest_values), largest_values, shown(values))

    # whom it avoids at the largest intervention of each step
    strongest = largest_indexes(ticks.time_s, ticks.intervention_m_s2, edges_s)
    avoided = np.where(strongest >= 0, ticks.avoided[strongest], shown(ticks.avoided))

    if vehicle.has_truth:
        yield from _axes(number, "estimate_", shown(ticks.position_enu_m), _METRE)
    yield from _axes(number, "setpoint_", shown(ticks.setpoint_position_enu_m), _METRE)
    yield from _axes(number, "before_", shown(ticks.thrust_baseline_enu_m_s2), _ACCELERATION)
    yield from _axes(number, "after_", shown(ticks.thrust_safe_enu_m_s2), _ACCELERATION)
    yield packed(f"{number}/intervention", largest(ticks.intervention_m_s2), _ACCELERATION)
    yield packed(f"{number}/slack", largest(ticks.slack_m_s2), _ACCELERATION)
    yield packed(f"{number}/avoided", avoided, 1.0)
    yield packed(f"{number}/throttle", shown(ticks.setpoint_thrust_frac), _FRACTION)
    yield packed(f"{number}/period", largest(ticks.period_s), _SECOND / 10.0)
    yield packed(f"{number}/attitude_age", largest(ticks.attitude_age_s), _SECOND)
    for other, age_s in ticks.ages_s.items():
        if other in names:
            key = f"{number}/age/{names.index(other)}"
            yield packed(key, largest(age_s), _SECOND)


def _fix_numbers(fixes: Sequence[str]) -> Array:
    """Return fixes as numbers (n,) of MAVLink's GPS_FIX_TYPE; NaN for unknown ones."""
    return np.array([FIX_NUMBERS.get(fix, math.nan) for fix in fixes])


def _telemetry_columns(
    number: int, vehicle: VehicleFlight, grid_s: Array, step_s: float
) -> Iterator[Column]:
    """Yield the curves from the telemetry: battery, wind, satellites, ages, failures, goal."""
    telemetry = vehicle.telemetry
    gap_s = max(_TELEMETRY_GAP_S, 2.0 * step_s)

    def shown(values: Array) -> Array:
        """Return values at the times of the grid."""
        return at_times(telemetry.time_s, values, grid_s, gap_s)

    # Battery and wind.
    wind_enu_m_s = telemetry.wind_enu_m_s
    yield packed(f"{number}/battery", shown(telemetry.battery_frac), _FRACTION)
    yield packed(f"{number}/voltage", shown(telemetry.battery_voltage_v), 0.01)
    yield packed(f"{number}/wind_x", shown(wind_enu_m_s[:, 0]), 0.01)
    yield packed(f"{number}/wind_y", shown(wind_enu_m_s[:, 1]), 0.01)
    yield packed(f"{number}/gust", shown(telemetry.gust_m_s), 0.01)
    yield packed(f"{number}/max_wind", shown(telemetry.max_wind_m_s), 0.01)

    # Satellites.
    if any(telemetry.fixes):
        yield packed(f"{number}/fix", shown(_fix_numbers(telemetry.fixes)), 1.0)
        yield packed(f"{number}/corrections_age", shown(telemetry.corrections_age_s), 0.01)

    # Ages and lateness.
    yield packed(f"{number}/state_age", shown(telemetry.state_age_s), _SECOND)
    yield packed(f"{number}/autopilot_age", shown(telemetry.autopilot_age_s), _SECOND)
    yield packed(f"{number}/neighbour_age", shown(telemetry.neighbour_age_s), _SECOND)
    yield packed(f"{number}/lateness", shown(telemetry.loop_lateness_p99_ms), 0.05)
    yield packed(f"{number}/mocap_delay", shown(telemetry.mocap_delay_s), _SECOND)
    yield packed(f"{number}/hover", shown(telemetry.hover_thrust_frac), _FRACTION)

    # Counts of failures since the agent's start.
    for name in ("late_ticks", "missed_ticks"):
        yield packed(f"{number}/{name}", shown(getattr(telemetry, name)), 1.0)
    lost = np.nansum(
        [
            telemetry.malformed_messages,
            telemetry.refused_messages,
            telemetry.dropped_messages,
            telemetry.late_messages,
        ],
        axis=0,
    )
    yield packed(f"{number}/lost_messages", shown(lost), 1.0)

    for axis, name in enumerate("xyz"):
        goal_m = shown(telemetry.goal_position_enu_m[:, axis])
        yield packed(f"{number}/goal_{name}", goal_m, _METRE)


def _axes(owner: int | str, prefix: str, values: Array, resolution: float) -> Iterator[Column]:
    """Yield a curve for each axis x, y, z of some vectors (n, 3)."""
    for axis, name in enumerate("xyz"):
        yield packed(f"{owner}/{prefix}{name}", values[:, axis], resolution)


def _ghost_columns(flight: Flight, ghost: Flight, grid_s: Array) -> Iterator[Column]:
    """Yield the paths of another flight, shifted in time so that both lift off together."""
    shift_s = _lift_off_s(flight) - _lift_off_s(ghost)
    for number, name in enumerate(flight.vehicles):
        ghost_vehicle = ghost.vehicles.get(name)
        if ghost_vehicle is None:
            continue
        times_s, positions_enu_m = ghost_vehicle.path
        path_enu_m = between_times(times_s + shift_s, positions_enu_m, grid_s, PATH_GAP_S)
        yield from _axes(number, "ghost_", path_enu_m, _METRE)


def _lift_off_s(flight: Flight) -> float:
    """Return the time at which the first vehicle leaves the ground; the start if none does."""
    lifted_s = []
    for vehicle in flight.vehicles.values():
        lift_off_s = vehicle.lift_off_s
        if lift_off_s is not None:
            lifted_s.append(lift_off_s)
    return min(lifted_s, default=flight.begin_s)


# -- header ----------------------------------------------------------------------------------------


def _header(
    flight: Flight, made_by: str, grid_s: Array, step_s: float, columns: Iterable[Column]
) -> dict[str, Any]:
    """Return the header: all of the report but the samples of its curves."""
    shown_settings: list[list[Any]] = []
    if flight.fleet is not None:
        shown_settings = [list(row) for row in settings(flight.fleet)]

    notes = [_text(note) for note in flight.notes]
    events = _most_severe(flight.events)
    if len(events) < len(flight.events):
        notes.append(
            f"Only the {len(events)} most severe of {len(flight.events)} events are shown."
        )
    orders = flight.orders[:MAX_EVENTS]
    if len(orders) < len(flight.orders):
        notes.append(f"Only the first {len(orders)} of {len(flight.orders)} orders are shown.")

    return {
        "format": FORMAT,
        "made_by": made_by,
        "title": _text(flight.title),
        "begin_s": float(grid_s[0]),
        "step_s": step_s,
        "count": int(grid_s.size),
        "notes": notes,
        "has_truth": flight.has_truth,
        "fleet": _fleet(flight),
        "verdict": _cleaned(flight.verdict),
        "falls": [_text(sentence) for sentence in fall_sentences(flight.verdict)],
        "vehicles": [_vehicle(vehicle) for vehicle in flight.vehicles.values()],
        "events": [
            [
                round(time_s, 3),
                _text(event.vehicle),
                event.severity,
                _text(event.code),
                _text(event.sentence),
            ]
            for time_s, event in events
        ],
        "orders": [
            {
                "at_s": round(order.at_s, 3),
                "vehicle": _text(order.vehicle),
                "text": _text(order.text),
                "answer": _text(order.answer),
                "end": _text(order.end),
                "end_s": _number(order.end_s),
            }
            for order in orders
        ],
        "pairs": _pairs(flight),
        "settings": shown_settings,
        "versions": _versions(flight),
        "mission": plain_lines(flight.mission)[:MAX_MISSION],
        "columns": [[column.key, column.scale, column.offset] for column in columns],
    }


def _most_severe(events: list[tuple[float, Event]]) -> list[tuple[float, Event]]:
    """Return at most MAX_EVENTS events with their times: the most severe ones, by time."""
    by_severity = sorted(
        range(len(events)), key=lambda index: _SEVERITIES.index(events[index][1].severity)
    )
    return [events[index] for index in sorted(by_severity[:MAX_EVENTS])]


def _fleet(flight: Flight) -> dict[str, Any] | None:
    """Return the values of the fleet file that the page draws; None without a fleet file."""
    if flight.fleet is None:
        return None
    fleet = flight.fleet.fleet
    fence = fleet.geofence_m
    return {
        "name": _text(fleet.name),
        "law": _text(flight.fleet.law.name),
        "safety_distance_m": fleet.safety_distance_m,
        "vertical_separation_m": fleet.vertical_separation_m,
        "height_share": fleet.height_share,
        "body_diameter_m": fleet.body_diameter_m,
        "battery_warning_frac": fleet.battery_warning_pct / 100.0,
        "battery_land_frac": fleet.battery_land_pct / 100.0,
        "fence": [[fence.x[0], fence.y[0], fence.z[0]], [fence.x[1], fence.y[1], fence.z[1]]],
        "obstacles": [
            {"name": _text(obstacle.name), "capsules_enu_m": obstacle.capsules_enu_m}
            for obstacle in flight.fleet.obstacles
        ],
        "people": [
            {"name": _text(name), "radius_m": flight.fleet.people[name].radius_m}
            for name in flight.people
        ],
        "areas": [
            {**area._asdict(), "name": _text(area.name)}
            for area in flight_space_of(flight.fleet).outlines()
        ],
    }


def _vehicle(vehicle: VehicleFlight) -> dict[str, Any]:
    telemetry = vehicle.telemetry
    return {
        "name": _text(vehicle.name),
        "has_truth": vehicle.has_truth,
        "law": _text(telemetry.law),
        "states": _changes(telemetry.time_s, telemetry.states),
        "modes": _changes(telemetry.time_s, telemetry.modes),
        "is_collided": bool(np.nanmax(vehicle.truth.is_collided, initial=0.0)),
    }


def _changes(times_s: Array, texts: list[str]) -> list[tuple[float, str]]:
    """Return the times [s] at which a text changed, each with the new text."""
    changes: list[tuple[float, str]] = []
    last_text: str | None = None
    for time_s, text in zip(times_s, texts, strict=True):
        if text == last_text:
            continue
        last_text = text
        changes.append((round(float(time_s), 2), _text(text)))
        if len(changes) >= MAX_EVENTS:
            break
    return changes


def _pairs(flight: Flight) -> list[list[Any]]:
    """Return the smallest distance of each pair while one of the two flew, the nearest first.

    The distances come from all samples of the record, so they are more exact than the curves.
    """
    tracks = {}
    for name, vehicle in flight.vehicles.items():
        times_s, positions_enu_m = vehicle.path
        is_known = np.isfinite(positions_enu_m).all(-1)
        if is_known.sum() < 2:
            continue

        tracks[name] = TrueMotion(
            stamp_ns=np.rint(times_s[is_known] * 1e9).astype(np.int64),
            position_enu_m=positions_enu_m[is_known],
            is_on_ground=~vehicle.is_up[is_known],
            is_collided=False,
        )

    height_share = 0.0  # heights do not count
    if flight.fleet is not None:
        height_share = flight.fleet.fleet.height_share
    numbers = {name: number for number, name in enumerate(flight.vehicles)}
    rows = [
        [
            numbers[pair.first],
            numbers[pair.second],
            pair.distance_m,  # the page rounds it as the verdict does, to what it shows
            round(pair.stamp_ns * 1e-9, 3),
        ]
        for pair in separations(tracks, height_share).values()
    ]
    rows.sort(key=lambda row: row[2])  # by distance
    return rows[:MAX_PAIRS]


def _versions(flight: Flight) -> list[list[str]]:
    """Return the versions of what flew as rows [component, version] for people."""
    rows: list[list[str]] = [[_text(part), _text(version)] for part, version in flight.made.items()]

    px4: dict[str, list[str]] = {}  # vehicles by version
    hashes: dict[str, list[str]] = {}  # vehicles by hash
    for name, vehicle in flight.vehicles.items():
        if vehicle.preflight is not None and vehicle.preflight.px4_version is not None:
            major, minor = vehicle.preflight.px4_version
            px4.setdefault(f"{major}.{minor}", []).append(name)
        if vehicle.telemetry.config_hash:
            hashes.setdefault(vehicle.telemetry.config_hash, []).append(name)

    for part, versions in (("PX4", px4), ("hash of fleet file and law", hashes)):
        for version, names in versions.items():
            vehicles = ""
            if len(names) < len(flight.vehicles):
                vehicles = f" ({', '.join(names)})"
            rows.append([part, _text(version + vehicles)])
    return rows


def _cleaned(value: Any) -> Any:
    """Return a value of a JSON file with its texts cleaned and its numbers finite."""
    if isinstance(value, str):
        return _text(value, 4 * MAX_TEXT)
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, dict):
        return {_text(key): _cleaned(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_cleaned(part) for part in value[:MAX_EVENTS]]
    return value


def _text(text: str, most_letters: int = MAX_TEXT) -> str:
    """Return a text as one line without control characters, cut to some letters."""
    line = plain_line(text)
    if len(line) <= most_letters:
        return line
    return f"{line[: most_letters - 1]}…"


def _number(value: float) -> float | None:
    """Return a value rounded for JSON; None if it is not finite."""
    if math.isfinite(value):
        return round(value, 4)
    return None
