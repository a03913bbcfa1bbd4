"""PX4's own failsafes that may act in OFFBOARD, and how the fleet treats each of them.

The table is the file ``own_failsafes.toml``. The preflight check requires its values, and
docs/px4.md prints it.
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
    """How the fleet treats one of PX4's failsafes."""

    DEMANDED = "demanded"  # PX4's parameters must be set so that it does not interfere
    NET = "net"  # it stays active, as a safety net
    ROW = "row"  # it has no parameter; the agent's failsafe table reacts to its action


@dataclass(frozen=True, slots=True)
class OwnParameter:
    """One parameter of a failsafe. Without ``demand``, it may have any value."""

    name: str  # PX4's name of the parameter
    since: Version = FIRST  # first version of PX4 that has it
    before: Version = LAST  # first version of PX4 that no longer has it
    demand: Value | None = None  # value that replaces a wrong value
    reason: str = ""  # effect of the demanded value

    # other values that are accepted instead
    accepts: tuple[Value, ...] = ()  # each of these values
    least: Value | None = None  # every value between least and most
    most: Value | None = None
    without_bits: int = 0  # every value that has none of these bits
    bound: str = ""  # name of the vehicle's limit that determines least or most

    # range of values that a fleet file may require instead
    file_least: Value | None = None
    file_most: Value | None = None
    is_optional: bool = False  # whether a PX4 of these versions may lack it


@dataclass(frozen=True, slots=True)
class OwnFailsafe:
    """One failsafe of PX4 that acts, or could act, in OFFBOARD."""

    flags: tuple[str, ...]  # names that PX4's versions have for it
    holds: str  # condition under which it acts
    acts: str  # reaction of PX4 in OFFBOARD
    treated: Treatment
    rows: tuple[Condition, ...]  # resulting conditions of the agent's failsafe table
    parameters: tuple[OwnParameter, ...]
    why: str = ""  # why it is left as a safety net
    since: Version = FIRST
    before: Version = LAST


def _version(text: str | None, otherwise: Version) -> Version:
    """Return the version in a text like "1.16"; without a text, return ``otherwise``."""
    if text is None:
        return otherwise
    major, _, minor = text.partition(".")
    return int(major), int(minor)


def _parameter(
    name: str, entry: Mapping[str, Any], since: Version, before: Version
) -> OwnParameter:
    """Return a parameter of the file. Without its own versions, it has those of its failsafe."""
    fields = dict(entry)
    since = _version(fields.pop("since", None), since)
    before = _version(fields.pop("before", None), before)
    accepts = tuple(fields.pop("accepts", ()))
    return OwnParameter(name=name, since=since, before=before, accepts=accepts, **fields)


def _failsafe(entry: Mapping[str, Any]) -> OwnFailsafe:
    """Return a failsafe of the file."""
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

# related parameters and flags that never take a vehicle out of OFFBOARD
WITHOUT_ACTION: frozenset[str] = frozenset(_TABLE["no_action"]["names"])
FLAGS_WITHOUT_ACTION: frozenset[str] = frozenset(_TABLE["no_action"]["flags"])


def demanded_parameters() -> Iterator[OwnParameter]:
    """Yield every parameter for which certain values are required."""
    for failsafe in OWN_FAILSAFES:
        for parameter in failsafe.parameters:
            if parameter.demand is not None:
                yield parameter
