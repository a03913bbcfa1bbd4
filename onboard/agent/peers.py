"""The other nodes of the bus: grounds and their roles, and the neighbours that are followed at full
rate.
"""

from __future__ import annotations

from onboard.agent.lost_ends import LostEnds
from onboard.agent_commands import Follow
from onboard.autopilot import Vec3
from onboard.bus.control_token import CONTROL_CLAIMS, GROUND, ControlTokens
from onboard.config.fleet import FleetConfig
from onboard.neighbours.subscription import SELECT_TICKS
from onboard.neighbours.table import NeighbourTable
from onboard.preflight.preflight_inputs import EMULATOR, RECORDER

# first words of all names that an agent has an interest in
CONCERNS_AGENTS = (GROUND, RECORDER, EMULATOR, *CONTROL_CLAIMS)


class BusNodes:
    """Nodes that are on the bus now."""

    def __init__(self, fleet: FleetConfig, vehicle_name: str) -> None:
        self.roles = ControlTokens()
        self.lost_ends = LostEnds()
        self._has_peers = (
            len(fleet.enabled_names) > 1 or fleet.vehicles[vehicle_name].mocap_required
        )
        self._grounds: set[str] = set()

    @property
    def has_ground(self) -> bool:
        """Whether a ground is on the bus."""
        return bool(self._grounds)

    def update(self, node: str, is_alive: bool, now_ns: int) -> None:
        """Take a node's appearance or end."""
        # whoever may order, operator or not; who only watches has another name
        if node.startswith(GROUND):
            # its link broke and is back: the end in between was not noticed
            if is_alive and node in self._grounds:
                self.lost_ends.see(node, False, now_ns)
            self.lost_ends.see(node, is_alive, now_ns)
            (self._grounds.add if is_alive else self._grounds.discard)(node)
        else:
            self.roles.see(node, is_alive)

    def silence_s(self, last_heard_ns: int, now_ns: int) -> float:
        """Return the time [s] since anything was heard on the bus; 0 while that says nothing about
        it.
        """
        is_meaningful = last_heard_ns and self._has_peers and not self.has_ground
        return (now_ns - last_heard_ns) * 1e-9 if is_meaningful else 0.0


class NeighbourFollower:
    """Chooses from time to time the neighbours that are heard at full rate; in a large fleet nobody
    at first.
    """

    def __init__(self, table: NeighbourTable) -> None:
        self._table = table
        self._ticks_left = 0

    def due(self, position_enu_m: Vec3 | None, now_ns: int) -> list[Follow]:
        """Return the change at this tick, if there is one."""
        self._ticks_left -= 1
        if self._ticks_left > 0:
            return []
        is_first, self._ticks_left = self._ticks_left < 0, SELECT_TICKS
        is_new = position_enu_m is not None and self._table.select_followed(position_enu_m, now_ns)
        return [Follow(self._table.followed)] if is_new or is_first else []
