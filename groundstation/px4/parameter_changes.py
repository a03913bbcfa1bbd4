"""Parameters written to one PX4, each with what became of it, also when the link dies on the way."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from groundstation.client.autopilot_link import LinkSilentError
from onboard.px4.required_params import RequiredParam, Value

_STORE_S, _SECOND_WRITE_S = 5.0, 0.5
_ACCEPTED = 0


class Outcome(Enum):
    """What became of one parameter that was to be set."""

    SET = "set"  # and read back
    REFUSED = "refused"  # PX4 keeps another value
    UNKNOWN = "unknown"  # this PX4 has no such parameter
    LOST = "not confirmed"  # sent, and PX4 fell silent
    UNTOUCHED = "not set"  # PX4 had fallen silent before


@dataclass(frozen=True, slots=True)
class Change:
    """One parameter that was to be set."""

    name: str
    before: Value | None  # None: PX4 did not send it
    required: Value
    after: Value | None
    outcome: Outcome


class ParameterLink(Protocol):
    """The part of a link that writes parameters."""

    def write(self, name: str, value: Value) -> Value | None: ...
    def request_storage(self, timeout_s: float) -> int | None: ...


def write_all(
    link: ParameterLink, required: Iterable[RequiredParam], before: Mapping[str, Value | None]
) -> tuple[list[Change], str]:
    """Set parameters one after the other, and have PX4 store them.

    Args:
        link: to PX4.
        required: parameters to set.
        before: parameter -> value that PX4 has.

    Returns:
        A change for each, and a sentence on what went wrong; empty when nothing did.
    """
    changes: list[Change] = []
    is_silent = False
    for demand in required:
        name, value = demand.name, demand.value
        after, outcome = before.get(name), Outcome.UNTOUCHED
        if not is_silent:
            try:
                after = link.write(name, value)
                outcome = (
                    Outcome.UNKNOWN
                    if after is None
                    else Outcome.SET
                    if demand.is_met(after)
                    else Outcome.REFUSED
                )
            except LinkSilentError:
                is_silent, after, outcome = True, None, Outcome.LOST
        changes.append(Change(name, before.get(name), value, after, outcome))
    has_set = any(change.outcome is Outcome.SET for change in changes)
    is_stored = not is_silent and has_set and store(link.request_storage, _STORE_S)
    return changes, _trouble(changes, is_silent=is_silent, is_stored=is_stored or not has_set)


def _trouble(changes: Sequence[Change], *, is_silent: bool, is_stored: bool) -> str:
    names = {
        outcome: ", ".join(change.name for change in changes if change.outcome is outcome) or "none"
        for outcome in Outcome
    }
    sentences = []
    if is_silent:
        sentences.append(
            f"PX4 fell silent in the middle. Set and read back: {names[Outcome.SET]}. Sent and not confirmed: "
            f"{names[Outcome.LOST]}. Not sent: {names[Outcome.UNTOUCHED]}. PX4 has stored nothing for sure. Run "
            "this once more when it is heard again."
        )
    if names[Outcome.REFUSED] != "none":
        sentences.append(
            f"PX4 did not take {names[Outcome.REFUSED]}: read-only, or out of its range."
        )
    if names[Outcome.UNKNOWN] != "none":
        sentences.append(f"This PX4 does not know {names[Outcome.UNKNOWN]}.")
    if not is_stored and not is_silent:
        sentences.append(
            "PX4 did not confirm that it stored them: a restart may lose them. Run this once more before a restart."
        )
    return " ".join(sentences)


def store(
    request: Callable[[float], int | None],
    timeout_s: float,
    sleep: Callable[[float], None] = time.sleep,
) -> bool:
    """Have PX4 write its parameters, and wait until it has; False when that was not confirmed in
    time.

    PX4 writes changed parameters by itself up to 3.5 s later, and a restart before that loses them.
    PREFLIGHT_STORAGE writes at once, but is accepted before the writing. While PX4 writes it
    rejects another one: so the next acceptance shows that the first writing has ended. The second
    has nothing new to write.
    """
    end_s = time.monotonic() + timeout_s
    accepted = 0
    while accepted < 2 and time.monotonic() < end_s:
        accepted += request(0.5) == _ACCEPTED
        sleep(0.1)
    if accepted == 2:
        sleep(_SECOND_WRITE_S)
    return accepted == 2
