"""Readiness of the fleet before a mission's first step. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from groundstation.fleet.fleet_files import other_file_words, unlisted_words, with_other_file
from groundstation.fleet.state import FleetState, VehicleView
from onboard.config.fleet import FleetConfig

READY_STATES = ("ready", "landed", "armed", "flying", "holding")


class NotReady(RuntimeError):
    """The fleet did not get ready in time.

    Args:
        sentence: what is missing.
        is_anybody_heard: whether any vehicle answered at all.
    """

    def __init__(self, sentence: str, *, is_anybody_heard: bool) -> None:
        self.is_anybody_heard = is_anybody_heard
        super().__init__(sentence)


def is_ready(state: FleetState, name: str, now_ns: int) -> bool:
    """Whether a vehicle reports that it may fly."""
    view = state.vehicles[name]
    telemetry = view.telemetry
    if telemetry is None or not view.is_fresh(now_ns):
        return False
    return telemetry.state in READY_STATES and not telemetry.not_ready


def not_ready(state: FleetState, names: Sequence[str], now_ns: int, timeout_s: float) -> NotReady:
    """Return the exception that names each vehicle that is not ready, with its reason.

    Args:
        state: the fleet as known now.
        names: vehicles to name.
        now_ns: the ground's monotonic clock [ns].
        timeout_s: time that was waited [s].

    Returns:
        The exception, which the caller raises.
    """
    reasons = []
    is_anybody_heard = False
    for name in names:
        view = state.vehicles[name]
        if view.is_fresh(now_ns):
            is_anybody_heard = True
        if not is_ready(state, name, now_ns):
            reasons.append(_reason(view, now_ns))

    if not is_anybody_heard:
        reasons.append(
            "Start the agents (covey agent), or fly emulated vehicles with --sitl or --lockstep."
        )

    sentence = f"Not ready within {timeout_s:g} s. {' '.join(reasons)}"
    return NotReady(sentence, is_anybody_heard=is_anybody_heard)


def fleet_refusal(state: FleetState, names: Sequence[str], fleet: FleetConfig, now_ns: int) -> str:
    """Return why no flight begins with this ground's fleet file; empty if one may.

    Args:
        state: the fleet as known now.
        names: vehicles that take part.
        fleet: this ground's fleet file.
        now_ns: the ground's monotonic clock [ns].
    """
    others = with_other_file(state, names, fleet, now_ns)
    if others:
        return other_file_words(others, fleet)
    if state.unlisted_up:
        return unlisted_words(state, fleet, now_ns)
    return ""


def _reason(view: VehicleView, now_ns: int) -> str:
    """Return why a vehicle is not ready."""
    telemetry = view.telemetry
    if telemetry is None or not view.is_fresh(now_ns):
        return f"{view.name} does not answer."

    reason = " ".join(telemetry.not_ready)
    if not reason:
        reason = telemetry.reason
    if not reason:
        reason = "it gives no reason"
    return f"{view.name} is {telemetry.state}: {reason.rstrip('.')}."
