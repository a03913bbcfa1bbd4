"""Faults of the emulator as a table (`catalogue.toml`): names, parameters, bounds, contradictions.

A fault is one line, for instance ``mav1 motor_weak at=20 duration=5 motor=2 effectiveness=0.6``.
The line is parsed and checked against the table. The fault then waits in a plan until its time.

The effects of faults are in `sitl/emulator/fault_effects.py`. Faults of poses are computed in
`pose_faults.py`, and faults of links in `lossy_channel.py`.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from typing import Any

Value = float | str


class FaultError(ValueError):
    """A fault cannot be injected; the message is a sentence with the reason."""


@dataclass(frozen=True, slots=True)
class FaultParameter:
    """One parameter of a kind of fault: a number within bounds, or a word."""

    name: str
    default: Value | None = None  # None: the parameter is required
    low: float = -math.inf
    high: float = math.inf
    # Accepted words. None: the value is a number. Empty: it is the name of another vehicle.
    words: Sequence[str] | None = None
    is_whole: bool = False  # whether the number has to be whole


@dataclass(frozen=True, slots=True)
class FaultKind:
    """One kind of fault."""

    sentence: str  # description of the effect, with {parameters}
    # The part that the fault acts on. Two faults that act on the same part of a vehicle at the same
    # time contradict each other.
    acts_on: str
    parameters: tuple[FaultParameter, ...] = ()
    is_instant: bool = False  # whether the fault happens once and has no duration
    # Whether the fault acts outside the emulator, on a simulated bus or on simulated agents.
    is_outside: bool = False


def _kind(*, parameters: Mapping[str, dict[str, Any]] = {}, **values: Any) -> FaultKind:
    """Return one row of the table: its parameters with their bounds, and its other values."""
    return FaultKind(
        parameters=tuple(FaultParameter(name, **bounds) for name, bounds in parameters.items()),
        **values,
    )


_TABLE = tomllib.loads(files(__package__).joinpath("catalogue.toml").read_text())
FAULT_KINDS: dict[str, FaultKind] = {name: _kind(**row) for name, row in _TABLE.items()}

_LONGEST_S = 1e6  # limit of times and durations
_TIME_TOLERANCE_S = 1e-9  # times that differ by less count as equal

# Links and directions of a fault of links, besides "both".
_LINKS = ("companion", "ground")
_DIRECTIONS = ("in", "out")


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of one vehicle, in simulated time."""

    name: str  # key of FAULT_KINDS
    vehicle: str  # name of the vehicle that has the fault
    at_s: float = 0.0  # simulated time at which the fault begins
    duration_s: float = 0.0  # 0: the fault does not end
    # Values by name. Parameters that are left out have their defaults.
    parameters: Mapping[str, Value] = field(default_factory=dict)

    @property
    def end_s(self) -> float:
        """End of the fault, or its beginning for a fault that happens once."""
        if FAULT_KINDS[self.name].is_instant:
            return self.at_s
        if self.duration_s > 0.0:
            return self.at_s + self.duration_s
        return math.inf

    @property
    def sentence(self) -> str:
        """A sentence that names the effect and the vehicle."""
        values: dict[str, str] = {}
        for key, value in self.parameters.items():
            if isinstance(value, float):
                values[key] = f"{value:g}"
            else:
                values[key] = value
        return f"{self.vehicle}: {FAULT_KINDS[self.name].sentence.format(**values)}"

    def number(self, name: str) -> float:
        """Return a numeric parameter of a checked fault."""
        return float(self.parameters[name])

    def word(self, name: str) -> str:
        """Return a parameter of a checked fault that is a word."""
        return str(self.parameters[name])


def parse(line: str) -> Fault:
    """Return the fault of a line, not yet checked.

    A line is ``VEHICLE NAME [at=S] [duration=S] [parameter=value ...]``.

    Raises:
        FaultError: the line does not have this form.
    """
    words = line.split()
    if len(words) < 2 or "=" in words[0] or "=" in words[1]:
        raise FaultError(
            f"'{line}' is no fault. Write VEHICLE NAME [at=SECONDS] [duration=SECONDS] "
            "[parameter=value ...], for instance 'mav1 motor_dead at=20 motor=2'."
        )
    vehicle, name = words[:2]

    values: dict[str, Value] = {}
    for word in words[2:]:
        key, sign, text = word.partition("=")
        if not sign or not key or not text or key in values:
            raise FaultError(
                f"'{line}': '{word}' is not understood. Write each parameter once, as name=value."
            )
        try:
            values[key] = float(text)
        except ValueError:
            values[key] = text

    at_s = _seconds(line, values, "at")
    duration_s = _seconds(line, values, "duration")
    return Fault(name=name, vehicle=vehicle, at_s=at_s, duration_s=duration_s, parameters=values)


def _seconds(line: str, values: dict[str, Value], key: str) -> float:
    """Remove a time from the values of a line and return it; without it return 0."""
    value = values.pop(key, 0.0)
    if isinstance(value, str):
        raise FaultError(f"'{line}': {key} is '{value}'; give a number of seconds.")
    return value


def check(fault: Fault, vehicles: Sequence[str]) -> Fault:
    """Return the fault with its defaults filled in.

    Raises:
        FaultError: a name, vehicle or parameter is unknown, or a value is out of its bounds.
    """
    kind = FAULT_KINDS.get(fault.name)
    if kind is None:
        raise FaultError(f"there is no fault '{fault.name}'. Known: {', '.join(FAULT_KINDS)}.")
    if fault.vehicle not in vehicles:
        emulated = ", ".join(vehicles)
        raise FaultError(
            f"{fault.name}: '{fault.vehicle}' is not emulated here; there are {emulated}."
        )

    has_times = 0.0 <= fault.at_s <= _LONGEST_S and 0.0 <= fault.duration_s <= _LONGEST_S
    if not has_times:
        raise FaultError(
            f"{fault.name}: at is {fault.at_s:g} s and duration {fault.duration_s:g} s; "
            f"give 0 to {_LONGEST_S:.0f} seconds for both (a duration of 0 means until the end)."
        )
    if kind.is_instant and fault.duration_s > 0.0:
        raise FaultError(f"{fault.name} happens once and has no duration. Leave it out.")

    known = {parameter.name: parameter for parameter in kind.parameters}
    for key in fault.parameters:
        if key not in known:
            names = ", ".join(known) or "none"
            raise FaultError(f"{fault.name} has no parameter '{key}'; it has {names}.")

    values: dict[str, Value] = {}
    for key, parameter in known.items():
        value = fault.parameters.get(key, parameter.default)
        if value is None:
            raise FaultError(f"{fault.name} needs the parameter '{key}'. Give it a value.")
        values[key] = _checked(fault, parameter, value, vehicles)
    return Fault(
        name=fault.name,
        vehicle=fault.vehicle,
        at_s=float(fault.at_s),
        duration_s=float(fault.duration_s),
        parameters=values,
    )


def _checked(
    fault: Fault, parameter: FaultParameter, value: Value, vehicles: Sequence[str]
) -> Value:
    """Return the value of a parameter, or raise FaultError for a value out of its bounds."""
    assignment = f"{fault.name}: {parameter.name} is {value!r}"
    if parameter.words is not None:
        words = parameter.words
        if not words:
            words = [name for name in vehicles if name != fault.vehicle]
        if value not in words:
            allowed = ", ".join(words) or "other vehicles, and there is none"
            raise FaultError(f"{assignment}; it must be one of {allowed}.")
        return value

    if isinstance(value, (str, bool)) or not parameter.low <= value <= parameter.high:
        bounds = f"between {parameter.low:g} and {parameter.high:g}"
        raise FaultError(f"{assignment}; it must lie {bounds}.")
    if parameter.is_whole and value != int(value):
        raise FaultError(f"{assignment}; it must be a whole number.")
    return float(value)


def refuse_contradiction(fault: Fault, others: Sequence[Fault]) -> None:
    """Check that no other fault acts on the same part of a vehicle at the same time.

    Raises:
        FaultError: another fault does so.
    """
    for other in others:
        common_targets = _targets(fault) & _targets(other)
        begins_together = fault.at_s == other.at_s
        overlaps = fault.at_s < other.end_s and other.at_s < fault.end_s
        if common_targets and (begins_together or overlaps):
            vehicle, part = min(common_targets)
            raise FaultError(
                f"{fault.name} at {fault.at_s:g} s and {other.name} at {other.at_s:g} s contradict "
                f"each other: both act on the {part} of {vehicle} at the same time. "
                "Let one end (duration=...) before the other begins."
            )


def _targets(fault: Fault) -> set[tuple[str, str]]:
    """Return the targets of a fault: pairs of a vehicle and a part of it."""
    acts_on = FAULT_KINDS[fault.name].acts_on
    values = dict(fault.parameters)

    if "link" in values:
        links: tuple[str, ...] = _LINKS
        if values["link"] != "both":
            links = (str(values["link"]),)

        directions: tuple[str, ...] = _DIRECTIONS
        if values["direction"] != "both":
            directions = (str(values["direction"]),)

        link_targets: set[tuple[str, str]] = set()
        for link in links:
            for direction in directions:
                part = f"{acts_on.format(link=link)} ({direction})"
                link_targets.add((fault.vehicle, part))
        return link_targets

    if "motor" in values:
        values["motor"] = int(fault.number("motor"))
    part = acts_on.format(**values)
    targets = {(fault.vehicle, part)}
    if "other" in values:
        targets.add((fault.word("other"), part))
    return targets


class FaultPlan:
    """Faults that wait for their time, and active faults.

    Args:
        vehicles: names of the emulated vehicles.

    Attributes:
        next_s: time at which the next fault begins or ends.
    """

    def __init__(self, vehicles: Sequence[str]) -> None:
        self._vehicles = list(vehicles)
        self._waiting: list[Fault] = []
        self._acting: list[Fault] = []
        self.next_s = math.inf

    def add(self, fault: Fault, now_s: float) -> Fault:
        """Plan a fault; return it with its defaults.

        A fault whose time has passed begins now.

        Raises:
            FaultError: see :func:`check` and :func:`refuse_contradiction`.
        """
        checked = check(fault, self._vehicles)
        if checked.at_s < now_s:
            checked = replace(checked, at_s=now_s)
        refuse_contradiction(checked, [*self._waiting, *self._acting])

        self._waiting.append(checked)
        self._waiting.sort(key=lambda other: other.at_s)
        self._set_next()
        return checked

    def advance(self, now_s: float) -> tuple[list[Fault], list[Fault]]:
        """Return the faults that begin and the faults that end up to the present time."""
        begins = [fault for fault in self._waiting if fault.at_s <= now_s + _TIME_TOLERANCE_S]
        ends = [fault for fault in self._acting if fault.end_s <= now_s + _TIME_TOLERANCE_S]
        lasting = [fault for fault in begins if not FAULT_KINDS[fault.name].is_instant]

        self._waiting = [fault for fault in self._waiting if fault not in begins]
        self._acting = [fault for fault in self._acting if fault not in ends] + lasting
        self._set_next()
        return begins, ends

    def _set_next(self) -> None:
        times = [fault.at_s for fault in self._waiting] + [fault.end_s for fault in self._acting]
        self.next_s = min(times, default=math.inf)


def listing() -> str:
    """Return the table as text: one line per kind."""
    lines: list[str] = []
    for name, kind in FAULT_KINDS.items():
        words = [name]
        for parameter in kind.parameters:
            if parameter.default is None:
                words.append(f"{parameter.name}=...")
            else:
                words.append(f"{parameter.name}={parameter.default}")
        lines.append(f"  {' '.join(words):<58} {kind.sentence}")
    return "\n".join(lines)
