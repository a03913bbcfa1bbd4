"""Converts goals in latitude and longitude to metres, before the steps are read. Pure.

A mission file may write ``position_deg`` instead of ``position_enu_m``, and ``goals_deg`` instead
of ``goals``. Both are replaced here, so that all other code reads metres only.
"""

from __future__ import annotations

from typing import Any

from groundstation.orders.degrees import goal_enu_m
from onboard.config.fleet import ConfigError, FleetConfig

# key of goals in degrees -> key of the same goals in metres
_METRES_KEYS = {"position_deg": "position_enu_m", "goals_deg": "goals"}


def in_metres(value: Any, fleet: FleetConfig, path: str) -> Any:
    """Return steps of a mission file with their goals in metres.

    Args:
        value: a list of steps, a step, or a value within one.
        fleet: fleet of the mission, whose origin is that of the metres.
        path: path of the mission file, for the sentences.

    Raises:
        ConfigError: a goal in degrees is not valid.
    """
    if isinstance(value, list):
        return [in_metres(item, fleet, path) for item in value]
    if not isinstance(value, dict):
        return value

    replaced: dict[str, Any] = {}
    for key, inner in value.items():
        metres_key = _METRES_KEYS.get(key)
        if metres_key is None:
            replaced[key] = in_metres(inner, fleet, path)
            continue
        if metres_key in value:
            raise ConfigError(
                f"{path}: a step has both '{key}' and '{metres_key}'. Remove one of them."
            )
        if key == "goals_deg" and isinstance(inner, dict):
            replaced[metres_key] = {
                name: _goal(goal, f"{key}.{name}", fleet, path) for name, goal in inner.items()
            }
        else:
            replaced[metres_key] = _goal(inner, key, fleet, path)
    return replaced


def _goal(value: Any, key: str, fleet: FleetConfig, path: str) -> list[float]:
    if not _is_three_numbers(value):
        raise ConfigError(f"{path}: '{key}' needs [latitude, longitude, height].")
    latitude_deg, longitude_deg, height_m = (float(number) for number in value)
    try:
        return list(goal_enu_m(fleet, latitude_deg, longitude_deg, height_m))
    except ConfigError as error:
        raise ConfigError(f"{path}: '{key}': {error}") from None


def _is_three_numbers(value: Any) -> bool:
    """Whether a value is a list of three numbers; in Python, True and False are integers, too."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        return False
    return all(isinstance(item, int | float) and not isinstance(item, bool) for item in value)
