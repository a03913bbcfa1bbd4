"""Writes the files of an imported show: a fleet, a mission, and path and lights of each vehicle.

Each file begins with comments that say what was changed.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from json import dumps
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np

from groundstation.paths.checks import (
    height_share_of,
    limits_of,
    path_spacing_m,
    sample,
    yaw_finding,
)
from groundstation.paths.lights import TimedColour
from groundstation.paths.path_files import write_path
from groundstation.processes.free_ports import in_another_folder, toml_text
from groundstation.shows.conversion import Converted, converted
from groundstation.shows.show import Show, from_origin
from groundstation.starter.starter_files import Answers, endpoint_lines, law_lines, type_lines
from onboard.config.fleet import (
    ConfigError,
    FleetConfig,
    Origin,
    fleet_from_mapping,
)
from onboard.control.path import sampled
from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility.fleet_checks import error_class
from onboard.plain_text import plain_line

DEFAULT_PROMISE_M = 0.8
_FENCE_MARGIN_M = 2.0  # horizontal distance from the show to the fence
_FENCE_ABOVE_M = 1.5  # height of the fence above the show
_FENCE_SAMPLE_COUNT = 500  # points of each path around which the fence is put
# bounds of the top speed of a fleet made for the show; faster vehicles would brake too late
_SLOWEST_TOP_SPEED_M_S = 1.0
_FASTEST_TOP_SPEED_M_S = 1.5
# homes are this much further apart than paths, because vehicles hover above their homes
_EXTRA_HOME_SPACING_M = 0.10
# origin of a show without one: that of PX4's simulator
_DEFAULT_ORIGIN = Origin(47.397742, 8.545594, 489.4)


class _Promise(NamedTuple):
    """The separation that a fleet promises; None: that of the fleet file, or the default."""

    distance_m: float | None  # safety distance
    vertical_m: float | None  # vertical separation


def write_show(
    show: Show,
    folder: FilePath,
    source: str,
    fleet: FleetConfig | None,
    promise_m: float | None,
    *,
    vertical_m: float | None = None,
) -> tuple[Converted, FleetConfig]:
    """Make a show flyable and write it.

    Args:
        show: the show as it was read.
        folder: folder for the files.
        source: name of the show's file, for the comments.
        fleet: fleet file whose types, endpoints and safety distance are taken; None makes one.
        promise_m: safety distance [m]; None: that of the fleet file, or the default.
        vertical_m: vertical separation [m]; None: that of the fleet file, or none.

    Returns:
        The show and the fleet as they are written.

    Raises:
        ConfigError: the show cannot be flown.
    """
    count = len(show.drones)
    if fleet is not None and len(fleet.enabled_names) < count:
        raise ConfigError(
            f"The show has {count} drones, {fleet.path} only {len(fleet.enabled_names)} vehicles."
        )
    if fleet is None:
        vehicles = [f"mav{index}" for index in range(count)]
    else:
        vehicles = list(fleet.enabled_names[:count])
        show = from_origin(show, fleet.fleet.global_origin)
    names = {drone.name: vehicle for drone, vehicle in zip(show.drones, vehicles, strict=True)}
    if len(names) < count:
        raise ConfigError("Two drones of the show have one name. Give each its own.")

    promise = _Promise(promise_m, vertical_m)

    # convert the show for the limits of a draft of the fleet, without its homes and its fence
    path = str(folder / "fleet.toml")
    draft_text = _fleet_text(show, fleet, vehicles, None, promise)
    draft = fleet_from_mapping(tomllib.loads(draft_text), path=path)
    accuracy = ACCURACIES[error_class(draft)]
    flyable = converted(
        show,
        names,
        limits_of(draft, vehicles),
        spacing_m=path_spacing_m(draft, accuracy),
        home_spacing_m=path_spacing_m(draft, accuracy) + _EXTRA_HOME_SPACING_M,
        accuracy=accuracy,
        height_share=height_share_of(draft, accuracy),
    )

    text = _fleet_text(show, fleet, vehicles, flyable, promise)
    written_fleet = fleet_from_mapping(tomllib.loads(text), path=path, text=text)
    flyable.notes.append(_battery_words(flyable, written_fleet, vehicles))
    yaw = yaw_finding(flyable.paths, "the paths")
    if yaw.status == "warning":
        flyable.notes.append(yaw.sentence)
    comments_of_all = [f"Made by covey import from {source}.", *flyable.notes]
    (folder / "paths").mkdir(parents=True, exist_ok=True)
    _write(folder / "fleet.toml", _commented(comments_of_all, text))
    _write(
        folder / "mission.toml", _commented(comments_of_all, _mission_text(flyable, written_fleet))
    )

    for name, vehicle_path in flyable.paths.items():
        comments = [*flyable.own_notes[name], *flyable.notes]
        write_path(folder / "paths" / f"{name}.csv", vehicle_path, comments)
        if flyable.lights[name]:
            (folder / "lights").mkdir(exist_ok=True)
            _write(folder / "lights" / f"{name}.csv", _lights_text(flyable.lights[name]))
    return flyable, written_fleet


def _battery_words(flyable: Converted, fleet: FleetConfig, vehicles: Sequence[str]) -> str:
    """Return words that compare the duration of the show with the vehicles' batteries."""
    show_s = max(path.duration_s for path in flyable.paths.values())
    words = f"the paths take {show_s / 60.0:.1f} min, take-off and landing come on top"
    land_pct = fleet.fleet.battery_land_pct

    hover_times_s = [fleet.vehicles[name].hover_time_s for name in vehicles]
    known_s = [hover_s for hover_s in hover_times_s if hover_s is not None]
    if len(known_s) < len(hover_times_s):
        return (
            f"{words}; each battery has to last that long and keep {land_pct:g} %, at which its "
            "vehicle lands: write hover_time_s in [types], and covey check judges it"
        )
    weakest_s = min(known_s)
    left_pct = 100.0 * (1.0 - show_s / weakest_s)
    return (
        f"{words}; the weakest battery, of {weakest_s / 60.0:.1f} min, has {left_pct:.0f} % left "
        f"then, and lands its vehicle at {land_pct:g} %"
    )


def _write(file: FilePath, text: str) -> None:
    file.write_text(text, encoding="utf-8")


def _lights_text(lights: Sequence[TimedColour]) -> str:
    lines = ["t,red,green,blue"]
    for time_s, red, green, blue in lights:
        lines.append(f"{time_s:.2f},{red},{green},{blue}")
    return "\n".join(lines) + "\n"


def _fleet_text(
    show: Show,
    fleet: FleetConfig | None,
    vehicles: Sequence[str],
    flyable: Converted | None,
    promise: _Promise,
) -> str:
    """Return the text of the fleet file.

    Before the show is converted (``flyable`` is None), the vehicles start far from each other, so
    that the file is valid.
    """
    if flyable is None:
        homes = {name: (10.0 * index, 0.0, 0.0) for index, name in enumerate(vehicles)}
    else:
        homes = flyable.homes
    starts_enu_m = {
        name: [round(x, 3), round(y, 3), round(z, 3)] for name, (x, y, z) in homes.items()
    }

    if fleet is not None:
        return _changed_fleet_text(
            fleet, starts_enu_m, has_show=flyable is not None, promise=promise
        )
    return _new_fleet_text(show, starts_enu_m, flyable, promise)


def _changed_fleet_text(
    fleet: FleetConfig,
    starts_enu_m: Mapping[str, list[float]],
    *,
    has_show: bool,
    promise: _Promise,
) -> str:
    """Return the user's fleet file with the homes of the show."""
    data = in_another_folder(tomllib.loads(fleet.text), fleet)
    for name, table in data["vehicles"].items():
        table["start_enu_m"] = starts_enu_m.get(name, table.get("start_enu_m"))
        if name not in starts_enu_m:
            table["enabled"] = False

    data.pop("formations", None)  # they belong to the former starts of the vehicles
    if not has_show:
        data["fleet"]["geofence_m"] = {"x": [-1e4, 1e4], "y": [-1e4, 1e4], "z": [-1.0, 1e4]}
    if promise.distance_m is not None:
        data["fleet"]["safety_distance_m"] = promise.distance_m
    if promise.vertical_m is not None:
        data["fleet"]["vertical_separation_m"] = promise.vertical_m
    return toml_text(data, f"types, endpoints and promise of {fleet.path}")


def _new_fleet_text(
    show: Show,
    starts_enu_m: Mapping[str, list[float]],
    flyable: Converted | None,
    promise: _Promise,
) -> str:
    """Return a new fleet file for the show, with emulated vehicles."""
    promise_m = promise.distance_m
    if promise_m is None:
        promise_m = DEFAULT_PROMISE_M
    vertical = []
    if promise.vertical_m is not None:
        vertical = [f"vertical_separation_m = {promise.vertical_m:g}  # or so far apart in height"]
    answers = Answers(type="sih", position="gps" if show.is_outdoors else "bus")

    lines = [
        "schema = 1",
        "",
        "[fleet]",
        'name = "show"',
        *_origin(show),
        f"safety_distance_m = {promise_m:g}",
        *vertical,
        "body_diameter_m = 0.50",
        *_fence(show, flyable),
        "battery_warning_pct = 30",
        "battery_land_pct = 20",
        "",
        "[law]",
        'name = "covey"',
        *law_lines(answers),
        "",
    ]
    for line in type_lines(answers):
        if line.startswith("max_speed_m_s"):
            line = f"max_speed_m_s = {_top_speed_m_s(flyable):g}  # of the show"
        lines.append(line)
    lines += [
        "",
        "[defaults]",
        'type = "sih"  # emulated: give --fleet for vehicles of your own',
    ]

    for index, (name, start_enu_m) in enumerate(starts_enu_m.items()):
        lines += [
            "",
            f"[vehicles.{name}]  # {show.drones[index].name!r} of the show",
            f"system_id = {index + 1}",
            f"start_enu_m = {start_enu_m}  # its home",
            *endpoint_lines(index),
        ]
    return "\n".join(lines) + "\n"


def _top_speed_m_s(flyable: Converted | None) -> float:
    """Return the top speed of a fleet made for the show: that of the show, within bounds."""
    if flyable is None:
        return _FASTEST_TOP_SPEED_M_S
    velocity = sample(flyable.paths).values[1, :, :, :3]  # first derivative of x, y, z
    top_m_s = float(np.sqrt((velocity**2).sum(-1)).max())
    rounded_m_s = math.ceil(100.0 * top_m_s) / 100.0
    return min(max(_SLOWEST_TOP_SPEED_M_S, rounded_m_s), _FASTEST_TOP_SPEED_M_S)


def _origin(show: Show) -> list[str]:
    if not show.is_outdoors:
        return ['origin = "mocap"  # an indoor show']

    if show.origin is not None:
        origin = show.origin
        owner_words = "the show's own"
    else:
        origin = _DEFAULT_ORIGIN
        owner_words = "PX4's simulator's"
    return [
        f"origin = {{ latitude_deg = {origin.latitude_deg}, "
        f"longitude_deg = {origin.longitude_deg}, "
        f"altitude_m = {origin.altitude_m} }}  # {owner_words} place; x is east, y is north"
    ]


def _fence(show: Show, flyable: Converted | None) -> list[str]:
    """Return the fence's line of the fleet file, around all homes and paths of a show."""
    if flyable is None:  # before the show is converted: a fence that excludes nothing
        return ["geofence_m = { x = [-1e4, 1e4], y = [-1e4, 1e4], z = [-1.0, 1e4] }"]

    parts = [np.array(list(flyable.homes.values()))]
    for path in flyable.paths.values():
        times_s = np.linspace(0.0, path.duration_s, _FENCE_SAMPLE_COUNT)
        values, _, _ = sampled(path, times_s)
        parts.append(values[:, :3])
    points = np.concatenate(parts)

    low_x, low_y, _ = np.floor(points.min(0) - _FENCE_MARGIN_M)
    high_x, high_y, _ = np.ceil(points.max(0) + _FENCE_MARGIN_M)
    x = [float(low_x), float(high_x)]
    y = [float(low_y), float(high_y)]
    lowest_home_m = min(home_m for _, _, home_m in flyable.homes.values())
    floor = min(0.0, float(np.floor(lowest_home_m)))
    if show.is_outdoors:
        floor -= 1.0
    top = float(np.ceil(points[:, 2].max() + _FENCE_ABOVE_M))
    return [
        f"geofence_m = {{ x = {x}, y = {y}, z = [{floor}, {top}] }}  "
        f"# the show, and {_FENCE_MARGIN_M:g} m around it"
    ]


def _mission_text(flyable: Converted, fleet: FleetConfig) -> str:
    is_gps = not next(iter(fleet.vehicles.values())).mocap_required
    paths = "\n".join(f'{name} = "paths/{name}.csv"' for name in flyable.paths)

    lights = ""
    lit = [name for name, program in flyable.lights.items() if program]
    if lit:
        files = [f'{name} = "lights/{name}.csv"' for name in lit]
        lights = "\n".join(["", "[step.lights]", *files])

    return f"""\
schema = 1
fleet = "fleet.toml"

[[step]]
do = "takeoff"
height_m = {flyable.takeoff_m:g}
vehicles = {dumps(list(flyable.paths))}
timeout_s = 60

[[step]]
do = "follow_path"
on_lag = "land"  # who falls behind for too long; the others go on
[step.paths]
{paths}
{lights}
[[step]]
do = "land"
vehicles = {dumps(list(flyable.paths))}
timeout_s = 90

[expect]
min_separation_m = {fleet.fleet.safety_distance_m:g}
arrived_within_m = {1.5 if is_gps else 0.3}
all_landed = true

[on_failure]
do = "land"
"""


def _commented(comments_of_all: Sequence[str], text: str) -> str:
    return "\n".join(f"# {plain_line(line)}" for line in comments_of_all) + "\n" + text
