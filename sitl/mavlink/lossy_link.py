"""A MAVLink link behind its two wires: what arrives and what leaves passes the link's faults; a
restart begins anew.
"""

from __future__ import annotations

from collections.abc import Mapping

from sitl.emulator.emulator import Emulator
from sitl.mavlink.link import Link

_LINK_IDS = ("ground", "companion", "simulator")


class LossyLink:
    """A link of one vehicle as its clients meet it.

    Args:
        emulator, index: the vehicle. rates_hz: see :class:`Link`.
        name: "companion" or "ground", as faults call it; or "simulator".
    """

    def __init__(
        self, emulator: Emulator, index: int, rates_hz: Mapping[int, float], name: str
    ) -> None:
        self._emulator, self._index, self._rates_hz = emulator, index, rates_hz
        self._link_id = _LINK_IDS.index(name)
        wires = emulator.disturbances.wires[index]
        self._in, self._out = wires[name, "in"], wires[name, "out"]
        self.link = Link(emulator, index, rates_hz, self._link_id)
        self.boot = emulator.disturbances.boots[index]

    def receive(self, datagram: bytes) -> list[bytes]:
        """Take one datagram; what leaves now."""
        if self._in.is_clear and self._out.is_clear:
            self._follow_restart()
            return self.link.receive(datagram)
        now_s = self._emulator.time_s
        self._in.push(now_s, datagram)
        return self._leave(now_s, self._arrived(now_s))

    def poll(self) -> list[bytes]:
        """Return the datagrams that leave at the emulator's present time."""
        self._follow_restart()
        now_s = self._emulator.time_s
        is_hung = self._emulator.disturbances.is_hung[self._index]
        out = [] if is_hung else self.link.poll()
        if self._in.is_clear and self._out.is_clear:
            return out
        return self._leave(now_s, self._arrived(now_s) + out)

    def _arrived(self, now_s: float) -> list[bytes]:
        self._follow_restart()
        return [
            answer for datagram in self._in.pop(now_s) for answer in self.link.receive(datagram)
        ]

    def _leave(self, now_s: float, datagrams: list[bytes]) -> list[bytes]:
        if self._out.is_clear:
            return datagrams
        for datagram in datagrams:
            self._out.push(now_s, datagram)
        return self._out.pop(now_s)

    def _follow_restart(self) -> None:
        boot = self._emulator.disturbances.boots[self._index]
        if boot != self.boot:
            # Rates, sequence numbers and what was asked for are gone with the process.
            self.boot = boot
            self.link = Link(self._emulator, self._index, self._rates_hz, self._link_id)
