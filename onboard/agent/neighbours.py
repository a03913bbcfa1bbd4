"""What this agent knows of the others: newest state message and telemetry of each, on our own clock."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from onboard.bus.codec import is_finite
from onboard.bus.schema import StateMessage, Telemetry
from onboard.config import FleetConfig
from onboard.types import Neighbours

SILENT_S = 0.3
_FORGET_NODE_S = 2.0
_SAME_CLOCK_NS = 500_000_000
_OTHER_CLOCK_DELAY_NS = 20_000_000


@dataclass(slots=True)
class _Entry:
    state: StateMessage | None = None  # the newest valid one
    stamp_ns: int = 0  # of the state, on our clock
    newest: tuple[int, int] = (0, -1)  # boot id and sequence of the newest message
    telemetry: Telemetry | None = None


@dataclass(slots=True)
class NeighbourTable:
    """Fixed order: the fleet file's enabled vehicles without our own; so that array places never change."""

    fleet: FleetConfig
    own_name: str
    names: tuple[str, ...] = field(init=False)
    ignored_messages: int = 0
    last_heard_ns: int = 0
    _entries: dict[str, _Entry] = field(init=False)
    _successor: str = field(init=False)

    def __post_init__(self) -> None:
        order = self.fleet.enabled_names
        self.names = tuple(name for name in order if name != self.own_name)
        self._entries = {name: _Entry() for name in self.names}
        place = order.index(self.own_name) if self.own_name in order else 0
        self._successor = order[(place + 1) % len(order)] if order else ""

    def hear(self, message: StateMessage | Telemetry, received_ns: int) -> bool:
        """Take a message; False when it is from nobody we know, repeated, out of order or not finite."""
        entry = self._entries.get(message.vehicle)
        if entry is None:
            return False
        self.last_heard_ns = max(self.last_heard_ns, received_ns)
        if isinstance(message, Telemetry):
            entry.telemetry = message
            return True
        repeated = entry.newest[0] == message.boot_id and message.sequence <= entry.newest[1]
        if repeated or not _is_usable(message):
            self.ignored_messages += 1
            return False
        entry.newest = (message.boot_id, message.sequence)
        if not message.is_valid:
            return True  # it knows no position: the last valid one ages, and is avoided like a silent vehicle's
        delay_ns = received_ns - message.stamp_ns
        # Agents of one host share the clock. A stamp of another clock says nothing: then the arrival counts.
        shared = 0 <= delay_ns < _SAME_CLOCK_NS
        entry.stamp_ns = message.stamp_ns if shared else received_ns - _OTHER_CLOCK_DELAY_NS
        entry.state = message
        return True

    def age_s(self, name: str, now_ns: int) -> float:
        """Age of the newest state; inf when never heard."""
        entry = self._entries[name]
        return math.inf if entry.state is None else max(0.0, (now_ns - entry.stamp_ns) * 1e-9)

    def oldest_age_s(self, now_ns: int) -> float:
        """Largest age of all that were ever heard; 0 without neighbours."""
        ages = [self.age_s(name, now_ns) for name, entry in self._entries.items() if entry.state is not None]
        return max(ages, default=0.0)

    def missing(self, now_ns: int) -> tuple[str, ...]:
        """Vehicles that must be there (enabled = true) and are not heard."""
        return tuple(
            name
            for name in self.names
            if self.fleet.vehicles[name].enabled is True and self.age_s(name, now_ns) > _FORGET_NODE_S
        )

    def silent(self, now_ns: int) -> tuple[str, ...]:
        """Vehicles that were in the air when last heard and have been silent too long."""
        return tuple(
            name
            for name, entry in self._entries.items()
            if entry.state is not None and entry.state.is_airborne and self.age_s(name, now_ns) > SILENT_S
        )

    def other_hashes(self, own_hash: str) -> dict[str, str]:
        """Configuration hashes that differ from ours."""
        return {
            name: entry.telemetry.config_hash
            for name, entry in self._entries.items()
            if entry.telemetry is not None and entry.telemetry.config_hash != own_hash
        }

    def telemetries(self) -> dict[str, Telemetry]:
        """Newest telemetry of all that sent one."""
        return {name: entry.telemetry for name, entry in self._entries.items() if entry.telemetry is not None}

    def distances_m(self, position_enu_m: tuple[float, float, float], now_ns: int) -> dict[str, float]:
        """Horizontal distance to each neighbour ever heard, extrapolated over at most the silence limit."""
        found = {}
        for name, entry in self._entries.items():
            if entry.state is None:
                continue
            ahead = min(self.age_s(name, now_ns), SILENT_S)
            p, v = entry.state.position_enu_m, entry.state.velocity_enu_m_s
            found[name] = math.hypot(p[0] + ahead * v[0] - position_enu_m[0], p[1] + ahead * v[1] - position_enu_m[1])
        return found

    def snapshot(self, now_ns: int) -> Neighbours:
        """The frozen picture for one tick, (K, 3); a silent or grounded neighbour does not cooperate."""
        count = max(1, len(self.names))
        vectors = np.zeros((6, count, 3))
        scalars = np.zeros((5, count))
        present, cooperative, successor = (np.zeros(count, dtype=bool) for _ in range(3))
        for place, name in enumerate(self.names):
            state = self._entries[name].state
            if state is None:
                continue
            vectors[0, place] = state.position_enu_m
            vectors[1, place] = state.velocity_enu_m_s
            vectors[2, place] = state.acceleration_enu_m_s2
            vectors[3, place] = state.predicted_position_enu_m
            vectors[4, place] = state.predicted_velocity_enu_m_s
            vectors[5, place] = state.commanded_acceleration_enu_m_s2
            age_s = self.age_s(name, now_ns)
            scalars[:3, place] = age_s, state.position_std_m, state.crowd_count
            scalars[3:, place] = state.lead_time_s, state.velocity_std_m_s
            present[place] = True
            cooperative[place] = state.is_cooperative and age_s <= SILENT_S
            successor[place] = name == self._successor
        return Neighbours(
            position_enu_m=vectors[0],
            velocity_enu_m_s=vectors[1],
            acceleration_enu_m_s2=vectors[2],
            predicted_position_enu_m=vectors[3],
            predicted_velocity_enu_m_s=vectors[4],
            commanded_acceleration_enu_m_s2=vectors[5],
            age_s=scalars[0],
            position_std_m=scalars[1],
            crowd_count=scalars[2],
            is_present=present,
            is_cooperative=cooperative,
            is_paper_obstacle=successor,
            lead_time_s=scalars[3],
            velocity_std_m_s=scalars[4],
        )


def _is_usable(message: StateMessage) -> bool:
    return is_finite(
        message.position_enu_m,
        message.velocity_enu_m_s,
        message.acceleration_enu_m_s2,
        message.predicted_position_enu_m,
        message.predicted_velocity_enu_m_s,
        message.commanded_acceleration_enu_m_s2,
        (message.position_std_m, message.velocity_std_m_s, message.crowd_count, message.lead_time_s),
    )
