"""Whether a mission can begin with the fleet as it is. Pure.

A mission that begins with a take-off cannot begin over a flying fleet: it is refused before it
orders anything, as an order would be.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from groundstation.fleet.state import FleetState
from groundstation.mission_files.expected_course import resolved
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.steps import (
    MissionStep,
    ParallelStep,
    ReactStep,
    RepeatStep,
)
from groundstation.orders.intents import Intent


def begin_refusal(mission: Mission, state: FleetState) -> str:
    """Return why a mission cannot begin now; empty when it can.

    Only the first order of each vehicle is judged. The steps of a Python mission are not known
    before it flies.

    Args:
        mission: loaded and checked.
        state: the fleet as known now.
    """
    seen: set[str] = set()
    for step in _in_order(mission.steps):
        if not isinstance(step, Intent):
            continue
        names = [name for name in resolved(step, mission.fleet).names if name not in seen]
        seen.update(names)

        up = [name for name in names if state.vehicles[name].is_airborne]
        if step.begins == "on ground" and up:
            fly = "flies" if len(up) == 1 else "fly"
            return (
                f"{mission.path} was not begun: its first order to {', '.join(up)}, {step.do}, "
                f"begins on the ground, and {', '.join(up)} {fly}. Land first, or start a mission "
                "that begins in the air."
            )
    return ""


def _in_order(steps: Sequence[MissionStep]) -> Iterator[MissionStep]:
    """Yield steps, and those that they hold, in the order in which they may come."""
    for step in steps:
        yield step
        if isinstance(step, ParallelStep):
            for branch in step.branches:
                yield from _in_order(branch)
        elif isinstance(step, RepeatStep | ReactStep):
            yield from _in_order(step.steps)
