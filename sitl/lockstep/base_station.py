"""The node that sends GNSS corrections in simulated time: an invented base station, and its faults.

It publishes frames once a second, like a real one, from its own node on the simulated bus.
"""

from __future__ import annotations

from onboard.bus.schema import Corrections
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from onboard.corrections.relay.mock_base import mock_base_of
from onboard.security.node_roles import NodeRole
from sitl.lockstep.bus import SimBus

NODE = NodeRole.CORRECTIONS.value
_NAME = "base"
_PERIOD_NS = 1_000_000_000
_BOOT_ID = 7


class BaseStation:
    """Sends the corrections of an invented base.

    Args:
        fleet: the fleet file, which says where the base stands.
        bus: the bus on which it becomes a node.
    """

    def __init__(self, fleet: FleetConfig, bus: SimBus) -> None:
        self.is_silent = False
        self._base = mock_base_of(fleet)
        self._reported_base = self._base  # base whose frames are sent; a fault moves its position
        self._node = bus.node(NODE)
        self._node.start()
        self._bus = bus
        self._second = 0
        self._sequence = 0
        bus.call_at(bus.now_ns(), self._send)

    def move(self, east_m: float) -> None:
        """From now on send a position that lies east of the true one; 0 sends the true one."""
        self._reported_base = self._base
        if east_m:
            self._reported_base = self._base.moved(east_m)

    def _send(self) -> None:
        now_ns = self._bus.now_ns()
        if not self.is_silent:
            for frame in self._reported_base.frames(self._second):
                self._sequence += 1
                message = Corrections(
                    source=NODE,
                    boot_id=_BOOT_ID,
                    sequence=self._sequence,
                    stamp_ns=now_ns,
                    frame=frame,
                )
                self._node.publish(Topic.CORRECTIONS, _NAME, message)
        self._second += 1
        self._bus.call_at(now_ns + _PERIOD_NS, self._send)
