"""Steps with goals in latitude and longitude, as steps in metres. Pure.

``position_deg`` stands for ``position_enu_m``, and ``goals_deg`` for ``goals``. They are replaced
before a step is read, so that all that knows steps knows metres only.
"""

from __future__ import annotations

from typing import Any

from groundstation.orders.degrees import goal_enu_m
from onboard.config.fleet import ConfigError, FleetConfig

_METRES = {"position_deg": "position_enu_m", "goals_deg": "goals"}


def in_metres(value: Any, fleet: FleetConfig, path: str) -> Any:
    """Return steps of a mission file with their degrees replaced.

    Args:
        value: a list of steps, a step, or a value within one.
        fleet: fleet of the mission; its origin counts.
        path: path of the mission file, for the sentences.

    Raises:
        ConfigError: a goal in degrees is none.
    """
    if isinstance(value, list):
        return [in_metres(one, fleet, path) for one in value]
    if not isinstance(value, dict):
        return value

    replaced: dict[str, Any] = {}
    for key, inner in value.items():
        metres_key = _METRES.get(key)
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
    is_three_numbers = (
        isinstance(value, list | tuple)
        and len(value) == 3
        and all(isinstance(one, int | float) and not isinstance(one, bool) for one in value)
    )
    if not is_three_numbers:
        raise ConfigError(f"{path}: '{key}' needs [latitude, longitude, height].")
    latitude_deg, longitude_deg, height_m = (float(one) for one in value)
    try:
        return list(goal_enu_m(fleet, latitude_deg, longitude_deg, height_m))
    except ConfigError as error:
        raise ConfigError(f"{path}: '{key}': {error}") from None
