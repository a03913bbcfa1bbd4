"""What PX4 does of its own accord with a vehicle in OFFBOARD, and how this fleet treats each case.

The table stands in ``own_failsafes.toml``. Preflight demands its values, docs/px4.md prints it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from importlib.resources import files
from typing import Any

from onboard.autopilot import Version
from onboard.safety.failsafe_table import Condition

Value = float | int

FIRST: Version = (0, 0)  # older than every PX4
LAST: Version = (99, 0)  # newer than every PX4


class Treatment(Enum):
    """Treatment of one of PX4's failsafes by the fleet."""

    DEMANDED = "demanded"  # PX4 has to have values by which it does not interfere
    NET = "net"  # PX4's own net, which stays
    ROW = "row"  # PX4 asks no parameter; the agent answers what it does


@dataclass(frozen=True, slots=True)
class OwnParameter:
    """One parameter of a failsafe; without ``demand`` it may have any value."""

    name: str  # as PX4 has it
    since: Version = FIRST  # PX4 knows it from this version on,
    before: Version = LAST  # and only before this one
    demand: Value | None = None  # what it is set to when it is wrong
    reason: str = ""  # what follows from the demanded value
    accepts: tuple[Value, ...] = ()  # as good,
    least: Value | None = None  # as every value from here on
    most: Value | None = None  # to here
    without_bits: int = 0  # as every value that has none of these bits
    bound: str = ""  # name of what gives least or most for one vehicle
    file_least: Value | None = None  # a fleet file may demand another value instead, from here
    file_most: Value | None = None  # to here
    is_optional: bool = False  # some PX4s of a version have it, and some do not


@dataclass(frozen=True, slots=True)
class OwnFailsafe:
    """One failsafe of PX4 that acts, or could act, in OFFBOARD."""

    flags: tuple[str, ...]  # PX4's own names of it in its versions
    holds: str  # when it acts
    acts: str  # what PX4 then does in OFFBOARD
    treated: Treatment
    rows: tuple[Condition, ...]  # of the failsafe table, that follow from it
    parameters: tuple[OwnParameter, ...]
    why: str = ""  # it is left as PX4's own net
    since: Version = FIRST
    before: Version = LAST


def _version(text: str | None, otherwise: Version) -> Version:
    if text is None:
        return otherwise
    major, _, minor = text.partition(".")
    return int(major), int(minor)


def _parameter(
    name: str, entry: Mapping[str, Any], since: Version, before: Version
) -> OwnParameter:
    fields = dict(entry)
    since = _version(fields.pop("since", None), since)
    before = _version(fields.pop("before", None), before)
    accepts = tuple(fields.pop("accepts", ()))
    return OwnParameter(name=name, since=since, before=before, accepts=accepts, **fields)


def _failsafe(entry: Mapping[str, Any]) -> OwnFailsafe:
    since = _version(entry.get("since"), FIRST)
    before = _version(entry.get("before"), LAST)
    parameters = []
    for name, fields in entry.get("parameters", {}).items():
        parameters.append(_parameter(name, fields, since, before))
    return OwnFailsafe(
        flags=tuple(entry.get("flags", ())),
        holds=entry["holds"],
        acts=entry["acts"],
        treated=Treatment(entry["treated"]),
        rows=tuple(Condition[name] for name in entry["rows"]),
        parameters=tuple(parameters),
        why=entry.get("why", ""),
        since=since,
        before=before,
    )


_TABLE = tomllib.loads(
    files(__package__).joinpath("own_failsafes.toml").read_text(encoding="utf-8")
)

OWN_FAILSAFES: tuple[OwnFailsafe, ...] = tuple(_failsafe(entry) for entry in _TABLE["failsafe"])

# Parameters of the same families, and flags, that take no vehicle out of OFFBOARD.
WITHOUT_ACTION: frozenset[str] = frozenset(_TABLE["no_action"]["names"])
FLAGS_WITHOUT_ACTION: frozenset[str] = frozenset(_TABLE["no_action"]["flags"])


def demanded_parameters() -> Iterator[OwnParameter]:
    """Yield every parameter that has to have certain values."""
    for failsafe in OWN_FAILSAFES:
        for parameter in failsafe.parameters:
            if parameter.demand is not None:
                yield parameter
