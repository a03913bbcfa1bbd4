"""The other nodes of the bus: ground stations with their roles, and the followed neighbours."""

from __future__ import annotations

from onboard.agent.missed_events import MissedEvents
from onboard.agent_commands import Follow
from onboard.bus.control_token import CONTROL_CLAIMS, GROUND, ControlTokens
from onboard.config.fleet import FleetConfig
from onboard.neighbours.subscription import SELECT_TICKS
from onboard.neighbours.table import NeighbourTable
from onboard.preflight.preflight_inputs import EMULATOR, RECORDER
from onboard.tuples import Xyz

# prefixes of the names of all nodes that an agent needs to know
CONCERNS_AGENTS = (GROUND, RECORDER, EMULATOR, *CONTROL_CLAIMS)


class BusNodes:
    """Nodes that are on the bus now."""

    def __init__(self, fleet: FleetConfig, vehicle_name: str) -> None:
        self.roles = ControlTokens()
        self.missed_events = MissedEvents()
        self.has_ground = False  # whether a ground is on the bus

        # whether messages of another vehicle or of the mocap are expected
        is_alone = len(fleet.enabled_names) <= 1
        self._has_peers = not is_alone or fleet.vehicles[vehicle_name].mocap_required
        self._grounds: set[str] = set()

    def update(self, node: str, is_alive: bool, now_ns: int) -> None:
        """Note that a node has appeared or was lost."""
        # For a ground, its presence matters. All other nodes only show who has which role.
        first_word, _, _ = node.partition("-")
        if first_word != GROUND:
            self.roles.see(node, is_alive)
            return

        # if a ground appears twice, its link broke in between without being noticed
        if is_alive and node in self._grounds:
            self.missed_events.see(node, False, now_ns)
        self.missed_events.see(node, is_alive, now_ns)

        if is_alive:
            self._grounds.add(node)
        else:
            self._grounds.discard(node)
        self.has_ground = bool(self._grounds)

    def silence_s(self, last_heard_ns: int, now_ns: int) -> float:
        """Return the time [s] since the last message came over the bus.

        It is 0 before the first message, while no message is expected, and while a ground is
        present.
        """
        if not last_heard_ns or not self._has_peers or self.has_ground:
            return 0.0
        return (now_ns - last_heard_ns) * 1e-9


class NeighbourFollower:
    """Regularly chooses the neighbours whose states we receive at full rate.

    In a large fleet no neighbour is followed before the first choice.
    """

    def __init__(self, table: NeighbourTable) -> None:
        self._table = table
        self._has_chosen = False
        self._ticks_to_choice = 1

    def due(self, position_enu_m: Xyz | None, now_ns: int) -> list[Follow]:
        """Count one tick; return a command with the first choice and with each changed choice."""
        self._ticks_to_choice -= 1
        if self._ticks_to_choice > 0:
            return []
        is_first_choice = not self._has_chosen
        self._has_chosen = True
        self._ticks_to_choice = SELECT_TICKS

        has_changed = False
        if position_enu_m is not None:
            has_changed = self._table.select_followed(position_enu_m, now_ns)

        if is_first_choice or has_changed:
            return [Follow(self._table.followed)]
        return []
