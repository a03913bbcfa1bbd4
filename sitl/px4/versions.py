"""The versions of PX4 that can be emulated, from one table.

In `versions.toml` the first version has all values. Each later version has only its differences.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any


@dataclass(frozen=True, slots=True)
class Version:
    """Behaviour of one version of PX4; `versions.toml` explains each field."""

    name: str
    flight_sw_version: int
    mode_acks: int
    counts_ignored_thrust: bool
    survives_no_rotation: bool
    flies_manual_modes_without_sticks: bool
    takes_off_sideways: bool
    shows_termination: bool
    has_one_throttle_text: bool
    takes_heading_noise_as_variance: bool
    landed_offboard_s: float
    unsupported_commands: frozenset[int]
    silent_streams: frozenset[str]
    no_current_ca: int
    covariance_off_diagonal: float
    warns_of_attitude_failure: bool
    parameters: Mapping[str, int | float]
    parameters_gone: frozenset[str]
    parameters_least: Mapping[str, float]
    severities: Mapping[str, int]
    knows_signing: bool
    answers_unknown_parameters: bool

    @property
    def number(self) -> tuple[int, int]:
        """Major and minor number, as AUTOPILOT_VERSION reports them."""
        major = self.flight_sw_version >> 24
        minor = self.flight_sw_version >> 16 & 0xFF
        return major, minor


# Tables of which a version lists only the entries that it adds or changes. In all other fields the
# value of a version replaces that of the version before.
_TABLES = ("parameters", "severities")
# fields that are lists in the file, and sets in Version
_SETS = ("unsupported_commands", "silent_streams", "parameters_gone")


def _versions(table: Mapping[str, Mapping[str, Any]]) -> dict[str, Version]:
    """Return the versions by name, each from the values of the one before and its own changes."""
    versions: dict[str, Version] = {}
    values: dict[str, Any] = {}  # values of the version before

    for name, changes in table.items():
        tables = {}
        for key in _TABLES:
            tables[key] = {**values.get(key, {}), **changes.get(key, {})}
        values = {**values, **changes, **tables}

        sets = {key: frozenset(values[key]) for key in _SETS}
        versions[name] = Version(name=name, **{**values, **sets})
    return versions


VERSIONS: dict[str, Version] = _versions(
    tomllib.loads(files(__package__).joinpath("versions.toml").read_text())
)
DEFAULT = VERSIONS["1.17"]
