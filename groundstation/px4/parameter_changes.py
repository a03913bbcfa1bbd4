"""Writes parameters to one PX4, with an outcome for each, even if the link is lost meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from groundstation.client.autopilot_link import LinkSilentError
from onboard.px4.required_params import RequiredParam, Value

_STORE_S = 5.0  # longest wait for the confirmation that parameters are stored
_STORE_ANSWER_S = 0.5  # longest wait for the answer to one request
_STORE_PAUSE_S = 0.1  # pause between two requests
_SECOND_WRITE_S = 0.5  # time that PX4 gets for the writing that follows the second request
_ACCEPTED = 0  # MAV_RESULT_ACCEPTED


class Outcome(Enum):
    """The outcome for one parameter."""

    SET = "set"  # it was set and read back
    REFUSED = "refused"  # PX4 keeps another value
    UNKNOWN = "unknown"  # this PX4 has no such parameter
    LOST = "not confirmed"  # it was sent, but PX4 fell silent
    UNTOUCHED = "not set"  # it was not sent, because PX4 had fallen silent before


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """One parameter: its values before and after, and the outcome."""

    name: str
    before: Value | None  # None: PX4 did not send it
    required: Value  # the value to set
    after: Value | None
    outcome: Outcome


class ParameterLink(Protocol):
    """The part of a link that writes parameters."""

    def write(self, name: str, value: Value) -> Value | None:
        """Write a parameter; return the value in PX4's answer, or None without an answer."""
        ...

    def request_storage(self, timeout_s: float) -> int | None:
        """Ask PX4 to store its parameters; return its MAV_RESULT, or None without an answer."""
        ...


def write_all(
    link: ParameterLink, required: Iterable[RequiredParam], before: Mapping[str, Value | None]
) -> tuple[list[ParameterChange], str]:
    """Set parameters one after the other, and let PX4 store them.

    Args:
        link: link to PX4.
        required: parameters to set.
        before: parameter -> value that PX4 has now.

    Returns:
        A change for each parameter, and sentences about what went wrong; empty if nothing did.
    """
    changes: list[ParameterChange] = []
    is_silent = False
    for demand in required:
        old_value = before.get(demand.name)
        if is_silent:
            after = old_value
            outcome = Outcome.UNTOUCHED
        else:
            after, outcome = _write(link, demand)
            is_silent = outcome is Outcome.LOST
        changes.append(
            ParameterChange(
                name=demand.name,
                before=old_value,
                required=demand.value,
                after=after,
                outcome=outcome,
            )
        )

    has_set = any(change.outcome is Outcome.SET for change in changes)
    is_stored = not has_set  # without a change there is nothing to store
    if has_set and not is_silent:
        is_stored = store(link.request_storage, _STORE_S)
    return changes, _trouble(changes, is_silent=is_silent, is_stored=is_stored)


def _write(link: ParameterLink, demand: RequiredParam) -> tuple[Value | None, Outcome]:
    """Set one parameter; return the value that PX4 has then, and the outcome."""
    try:
        after = link.write(demand.name, demand.value)
    except LinkSilentError:
        return None, Outcome.LOST

    if after is None:
        return None, Outcome.UNKNOWN
    if demand.is_met(after):
        return after, Outcome.SET
    return after, Outcome.REFUSED


def _trouble(changes: Sequence[ParameterChange], *, is_silent: bool, is_stored: bool) -> str:
    """Return what went wrong, in sentences."""
    names: dict[Outcome, list[str]] = {outcome: [] for outcome in Outcome}
    for change in changes:
        names[change.outcome].append(change.name)

    sentences = []
    if is_silent:
        sentences.append(
            f"PX4 fell silent in the middle. Set and read back: {_listed(names[Outcome.SET])}."
            f" Sent and not confirmed: {_listed(names[Outcome.LOST])}."
            f" Not sent: {_listed(names[Outcome.UNTOUCHED])}."
            " It is not certain that PX4 has stored any of them."
            " Run this once more when it is heard again."
        )
    if names[Outcome.REFUSED]:
        refused = _listed(names[Outcome.REFUSED])
        sentences.append(f"PX4 did not take {refused}: read-only, or out of its range.")
    if names[Outcome.UNKNOWN]:
        sentences.append(f"This PX4 does not know {_listed(names[Outcome.UNKNOWN])}.")
    if not is_stored and not is_silent:
        sentences.append(
            "PX4 did not confirm that it stored them: a restart may lose them."
            " Run this once more before a restart."
        )
    return " ".join(sentences)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"


def store(
    request: Callable[[float], int | None],
    timeout_s: float,
    sleep: Callable[[float], None] = time.sleep,
) -> bool:
    """Let PX4 store its parameters, and wait until it has; return whether it confirmed in time.

    PX4 stores changed parameters by itself up to 3.5 s later, and a restart before that loses them.
    PREFLIGHT_STORAGE stores them at once, but PX4 accepts it before it writes. While PX4 writes, it
    rejects a further PREFLIGHT_STORAGE. So when it accepts a second one, the first writing has
    ended. The second writing has nothing new to write.

    Args:
        request: sends PREFLIGHT_STORAGE and returns the answer; its argument is the timeout.
        timeout_s: longest time for all requests.
        sleep: waits between two requests.
    """
    end_s = time.monotonic() + timeout_s
    accepted = 0
    while accepted < 2 and time.monotonic() < end_s:
        if request(_STORE_ANSWER_S) == _ACCEPTED:
            accepted += 1
        sleep(_STORE_PAUSE_S)

    if accepted < 2:
        return False
    sleep(_SECOND_WRITE_S)
    return True
