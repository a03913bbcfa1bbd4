"""The files of an imported show: a fleet, a mission, a path and the lights of each vehicle, with
what was changed.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from json import dumps
from pathlib import Path as FilePath

import numpy as np

from groundstation.paths.checks import bound_m, limits_of, sample
from groundstation.paths.files import write_path
from groundstation.processes.free_ports import in_another_folder, toml_text
from groundstation.shows.conversion import Converted, converted
from groundstation.shows.show import Show
from groundstation.starter.files import Answers, endpoint_lines, law_lines, type_lines
from onboard.config.fleet import (
    ConfigError,
    FleetConfig,
    Origin,
    fleet_from_mapping,
    parking_height_share,
)
from onboard.control.path import sampled

DEFAULT_PROMISE_M = 0.8
_ROOM_M, _ABOVE_M = 2.0, 1.5  # of the fence around the show
_SPEEDS_M_S = 1.0, 1.5  # of a fleet made for the show; faster ones brake too late for each other
_HOME_M = 0.10  # more than between paths: vehicles hover above their homes
_NOWHERE = Origin(47.397742, 8.545594, 489.4)


def write_show(
    show: Show, folder: FilePath, source: str, fleet: FleetConfig | None, promise_m: float | None
) -> tuple[Converted, FleetConfig]:
    """Make a show flyable and write it.

    Args:
        show: as it was read.
        folder: for the files.
        source: where the show was read from, for the comments.
        fleet: whose types, endpoints and promise are taken; None makes one.
        promise_m: distance that the fleet promises [m]; None: the fleet's, or the default.

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
    vehicles = (
        [f"mav{k}" for k in range(count)] if fleet is None else list(fleet.enabled_names[:count])
    )
    names = {drone.name: vehicle for drone, vehicle in zip(show.drones, vehicles, strict=True)}
    if len(names) < count:
        raise ConfigError("Two drones of the show have one name. Give each its own.")
    draft_text = _fleet_text(show, fleet, vehicles, None, promise_m)
    draft = fleet_from_mapping(tomllib.loads(draft_text), path=str(folder / "fleet.toml"))
    made = converted(
        show,
        names,
        limits_of(draft, vehicles),
        bound_m(draft),
        bound_m(draft) + _HOME_M,
        parking_height_share(draft),
    )
    text = _fleet_text(show, fleet, vehicles, made, promise_m)
    final = fleet_from_mapping(tomllib.loads(text), path=str(folder / "fleet.toml"), text=text)
    head = [f"Made by covey import from {source}.", *made.notes]
    (folder / "paths").mkdir(parents=True, exist_ok=True)
    (folder / "fleet.toml").write_text(_commented(head, text), encoding="utf-8")
    (folder / "mission.toml").write_text(
        _commented(head, _mission_text(made, final)), encoding="utf-8"
    )
    for name, path in made.paths.items():
        write_path(folder / "paths" / f"{name}.csv", path, [*made.own_notes[name], *made.notes])
        if made.lights[name]:
            (folder / "lights").mkdir(exist_ok=True)
            lines = [
                "t,red,green,blue",
                *(f"{t:.2f},{r},{g},{b}" for t, r, g, b in made.lights[name]),
            ]
            (folder / "lights" / f"{name}.csv").write_text(
                "\n".join(lines) + "\n", encoding="utf-8"
            )
    return made, final


def _fleet_text(
    show: Show,
    fleet: FleetConfig | None,
    vehicles: Sequence[str],
    made: Converted | None,
    promise_m: float | None,
) -> str:
    """Return the fleet file; before the show is converted and its homes are checked, with spots far
    from each other.
    """
    homes = (
        made.homes
        if made is not None
        else {name: (10.0 * k, 0.0, 0.0) for k, name in enumerate(vehicles)}
    )
    spots = {name: [round(x, 3), round(y, 3), 0.0] for name, (x, y, _) in homes.items()}
    if fleet is not None:
        data = in_another_folder(tomllib.loads(fleet.text), fleet)
        for name in data["vehicles"]:
            data["vehicles"][name]["start_enu_m"] = spots.get(
                name, data["vehicles"][name].get("start_enu_m")
            )
            if name not in spots:
                data["vehicles"][name]["enabled"] = False
        data.pop("formations", None)  # of the vehicles' former spots
        if made is None:
            data["fleet"]["geofence_m"] = {"x": [-1e4, 1e4], "y": [-1e4, 1e4], "z": [-1.0, 1e4]}
        if promise_m is not None:
            data["fleet"]["safety_distance_m"] = promise_m
        return toml_text(data, f"types, endpoints and promise of {fleet.path}")
    answers = Answers(type="sih", position="gps" if show.is_outdoors else "bus")
    speed = f"max_speed_m_s = {_top_speed_m_s(made):g}  # of the show"
    lines = [
        "schema = 1",
        "",
        "[fleet]",
        'name = "show"',
        *_origin(show),
        f"safety_distance_m = {DEFAULT_PROMISE_M if promise_m is None else promise_m:g}",
        "body_diameter_m = 0.50",
        *_fence(show, made),
        "battery_warning_pct = 30",
        "battery_land_pct = 20",
        "",
        "[law]",
        'name = "covey"',
        *law_lines(answers),
        "",
        *(speed if line.startswith("max_speed_m_s") else line for line in type_lines(answers)),
        "",
        "[defaults]",
        'type = "sih"  # emulated: give --fleet for vehicles of your own',
    ]
    for k, (name, spot) in enumerate(spots.items()):
        lines += [
            "",
            f"[vehicles.{name}]  # {show.drones[k].name!r} of the show",
            f"system_id = {k + 1}",
            f"start_enu_m = {spot}  # its home",
            *endpoint_lines(k),
        ]
    return "\n".join(lines) + "\n"


def _top_speed_m_s(made: Converted | None) -> float:
    """Return the top speed that a fleet made for the show gets: the show's, within what its law can
    brake.
    """
    slowest, fastest = _SPEEDS_M_S
    if made is None:
        return fastest
    rates = sample(made.paths).values[1, :, :, :3]
    return min(
        max(slowest, math.ceil(100.0 * float(np.sqrt((rates**2).sum(-1)).max())) / 100.0), fastest
    )


def _origin(show: Show) -> list[str]:
    if not show.is_outdoors:
        return ['origin = "mocap"  # an indoor show']
    origin, words = (
        (show.origin, "the show's own")
        if show.origin is not None
        else (_NOWHERE, "PX4's simulator's")
    )
    return [
        f"origin = {{ latitude_deg = {origin.latitude_deg}, longitude_deg = {origin.longitude_deg}, "
        f"altitude_m = {origin.altitude_m} }}  # {words} place; x is flown to the east"
    ]


def _fence(show: Show, made: Converted | None) -> list[str]:
    if made is None:
        return ["geofence_m = { x = [-1e4, 1e4], y = [-1e4, 1e4], z = [-1.0, 1e4] }"]
    points = [
        sampled(path, np.linspace(0.0, path.duration_s, 500))[0][:, :3]
        for path in made.paths.values()
    ]
    corners = np.concatenate([*points, np.array(list(made.homes.values()))])
    low, high = corners.min(0) - _ROOM_M, corners.max(0) + _ROOM_M
    floor = -1.0 if show.is_outdoors else 0.0
    x, y = ([float(np.floor(low[k])), float(np.ceil(high[k]))] for k in (0, 1))
    top = float(np.ceil(corners[:, 2].max() + _ABOVE_M))
    return [
        f"geofence_m = {{ x = {x}, y = {y}, z = [{floor}, {top}] }}  # the show, and {_ROOM_M:g} m around it"
    ]


def _mission_text(made: Converted, fleet: FleetConfig) -> str:
    is_gps = not next(iter(fleet.vehicles.values())).mocap_required
    paths = "\n".join(f'{name} = "paths/{name}.csv"' for name in made.paths)
    lit = [name for name, lights in made.lights.items() if lights]
    lights = (
        "\n".join(["", "[step.lights]", *(f'{name} = "lights/{name}.csv"' for name in lit)])
        if lit
        else ""
    )
    return f"""\
schema = 1
fleet = "fleet.toml"

[[step]]
do = "takeoff"
height_m = {made.takeoff_m:g}
vehicles = {dumps(list(made.paths))}
timeout_s = 60

[[step]]
do = "follow_path"
on_lag = "land"  # who falls behind for too long; the others go on
[step.paths]
{paths}
{lights}
[[step]]
do = "land"
vehicles = {dumps(list(made.paths))}
timeout_s = 90

[expect]
min_separation_m = {fleet.fleet.safety_distance_m:g}
arrived_within_m = {1.5 if is_gps else 0.3}
all_landed = true

[on_failure]
do = "land"
"""


def _commented(head: Sequence[str], text: str) -> str:
    return "\n".join(f"# {line}" for line in head) + "\n" + text
