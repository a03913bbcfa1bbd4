"""One tick of a whole fleet, batched over flights and vehicles: what they tell each other, and everybody's pipeline.

The rollout and the simulated campaigns fly the drone's own ``pipeline.step`` through here; vehicles with equal
parameters are computed together. Arrays are (F, N, ...): F flights of N vehicles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from onboard.control import pipeline
from onboard.types import Array, BoolArray, Goal, IntArray, LawOutput, Neighbours, State, Tick

_Tree = TypeVar("_Tree")
# a message, field by field, as one row of numbers; the names are those of Neighbours
_LAYOUT = (
    ("position_enu_m", 3),
    ("velocity_enu_m_s", 3),
    ("acceleration_enu_m_s2", 3),
    ("predicted_position_enu_m", 3),
    ("predicted_velocity_enu_m_s", 3),
    ("commanded_acceleration_enu_m_s2", 3),
    ("position_std_m", 1),
    ("crowd_count", 1),
    ("lead_time_s", 1),
    ("velocity_std_m_s", 1),
    ("intent_enu_m_s", 3),
)


class Controller(Protocol):
    """What flies a batch: estimates, goals and neighbours in, every vehicle's attitude setpoint out."""

    def step(self, state: State, goal: Goal, neighbours: Neighbours, *, dt_s: float) -> Tick:
        """One tick; state and goal (F, N, ...), neighbours (F, N, K, ...), the result (F, N, ...)."""

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""


class FleetPipeline:
    """Everybody's pipeline: a :class:`Controller`."""

    def __init__(self, params: Sequence[pipeline.PipelineParams], start_enu_m: Array) -> None:
        self.groups = _equal(params)
        self.params = [params[group[0]] for group in self.groups]
        self.memories = [
            pipeline.initial(own, start_enu_m[:, group]) for own, group in zip(self.params, self.groups, strict=True)
        ]
        self._order = np.argsort([index for group in self.groups for index in group])

    def step(self, state: State, goal: Goal, neighbours: Neighbours, *, dt_s: float) -> Tick:
        """One tick of everybody."""
        ticks = []
        for k, group in enumerate(self.groups):
            self.memories[k], tick = pipeline.step(
                self.memories[k],
                self._members(state, group),
                self._members(goal, group),
                self._members(neighbours, group),
                params=self.params[k],
                dt_s=dt_s,
            )
            ticks.append(tick)
        if len(ticks) == 1:
            return ticks[0]
        return _mapped(lambda *parts: np.concatenate(parts, axis=1)[:, self._order], *ticks)

    def _members(self, values: _Tree, group: list[int]) -> _Tree:
        return values if len(self.groups) == 1 else _mapped(lambda array: array[:, group], values)

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self.memories = [keep_flights(memory, flights) for memory in self.memories]


def keep_flights(values: _Tree, flights: IntArray) -> _Tree:
    """The (possibly nested) dataclass with only these flights; arrays of one axis are common to all and stay."""
    return _mapped(lambda array: array[flights] if array.ndim > 1 else array, values)


def _mapped(function: Callable[..., NDArray[np.generic]], *trees: _Tree) -> _Tree:
    """A dataclass of arrays made by ``function`` of the corresponding arrays of all ``trees``."""
    changed = {}
    for field in fields(trees[0]):  # type: ignore[arg-type]
        parts = [getattr(tree, field.name) for tree in trees]
        if parts[0] is None:
            continue
        changed[field.name] = _mapped(function, *parts) if is_dataclass(parts[0]) else function(*parts)
    return replace(trees[0], **changed)  # type: ignore[type-var]


def _equal(params: Sequence[pipeline.PipelineParams]) -> list[list[int]]:
    """Places of the vehicles that have equal parameters."""
    groups: list[list[int]] = []
    for index, own in enumerate(params):
        for group in groups:
            if params[group[0]] == own:
                group.append(index)
                break
        else:
            groups.append([index])
    return groups


def message(state: State, law: LawOutput | None) -> Array:
    """What each vehicle publishes, (F, N, fields); before the first tick it commands nothing and stays."""
    position = state.position_enu_m
    still = np.zeros_like(position)
    parts = [position, state.velocity_enu_m_s, state.acceleration_enu_m_s2]
    if law is None:
        parts += [position, still, still, state.position_std_m[..., None], still[..., :2]]
    else:
        parts += [law.predicted_position_enu_m, law.predicted_velocity_enu_m_s, law.commanded_acceleration_enu_m_s2]
        parts += [state.position_std_m[..., None], law.crowd_count[..., None], law.lead_time_s[..., None]]
    parts += [state.velocity_std_m_s[..., None], still if law is None else law.intent_enu_m_s]
    return np.concatenate(parts, axis=-1)


def all_others(count: int) -> IntArray:
    """Senders (N, N - 1): everybody hears everybody else."""
    return np.array([[j for j in range(count) if j != i] for i in range(count)], dtype=np.int64).reshape(count, -1)


def heard(inbox: Array, age_s: Array, senders: IntArray, is_cooperative: BoolArray) -> Neighbours:
    """Neighbours (F, N, K) from the newest messages (F, receiver, sender, fields) of ``senders`` (N, K) or (F, N, K).

    Args:
        age_s, is_cooperative: (F, receiver, sender).
    """
    flights, count = inbox.shape[:2]
    receiver = np.arange(count)[:, None]
    index = (np.arange(flights)[:, None, None], receiver, np.broadcast_to(senders, (flights, *senders.shape[-2:])))
    rows = inbox[index]
    places = np.cumsum([0] + [width for _, width in _LAYOUT])
    named = {
        name: rows[..., place : place + width] if width > 1 else rows[..., place]
        for (name, width), place in zip(_LAYOUT, places, strict=False)
    }
    return Neighbours(
        **named,
        age_s=age_s[index],
        is_present=np.ones(rows.shape[:-1], bool),
        is_cooperative=is_cooperative[index],
        is_paper_obstacle=np.asarray(index[2] == (receiver + 1) % count),
    )
